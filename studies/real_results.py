"""Trackers with general weights on recordings of real robots: places that they have not learned.

`python -m studies.real_results DATA` compares every tracker with general weights on each of the recordings `REAL`
(studies/support/real_recordings.py), and writes the numbers and the chart of docs/results/real; DATA has the folders
leg_tracker, datmo, radish and ual. A sensor that moves gets refined poses (docs/importing.md), in recordings that are
written once beside the folder of the run. Thresholds come from the cards. An interrupted comparison resumes with the
same rows. On one idle core the poses need ten minutes, each network twenty.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from studies.support.place_command import SKILL, compare_places, place_parser, write_places
from studies.support.real_recordings import REAL, RealRecording, import_real
from studies.support.results_file import ResultSection, ResultTable, measured_table
from studies.support.unseen_places import STRATA, PlaceScores, not_measured

RESULTS = Path("docs/results/real/real.json")
COMMAND = "python -m studies.real_results DATA"
SHOWN_STRATA = ("in-motion", "dynamic", "visible")
MIDDLE_S = 1.0
"""The horizon of the tables by recording."""


def imported(recordings: Sequence[RealRecording], data: Path, folder: Path) -> list[Path]:
    """The recordings to compare on, below `folder`; with refined poses if the sensor moves."""
    return [
        import_real(one, one.scans(data), "refined" if one.moves else "recorded", data, folder / f"{one.name}.mcap")
        for one in recordings
    ]


def contents(scores: PlaceScores) -> ResultTable:
    """Each recording: sensor, frames, forecasts, and occupied cells per forecast in the strata, MIDDLE_S ahead."""
    known = {one.name: one for one in REAL}
    occupied = [scores.occupied(stratum, MIDDLE_S) for stratum in SHOWN_STRATA]
    rows = []
    for name, described in scores.described.items():
        one, cells = known[name], [f"{of_stratum[name]:.1f}" for of_stratum in occupied]
        read = ["moves" if one.moves else "stands", f"{one.rate_hz:g}", f"{one.cell_m:g}", str(described.frames)]
        rows.append([name, *read, str(scores.forecasts[name]), *cells])
    columns = ("recording", "sensor", "Hz", "cell, m", "frames", "forecasts", *(STRATA[one] for one in SHOWN_STRATA))
    return measured_table(columns, rows)


def by_recording(scores: PlaceScores) -> ResultTable:
    """PR-AUC and F1 of dynamic cells on each recording, MIDDLE_S ahead."""
    rows = [
        [
            f"{name}, {label}",
            *(scores.text(label, "dynamic", one, MIDDLE_S, name) for one in ("pr_auc", "f1", "fss.5_cells")),
        ]
        for name in scores.described
        for label in scores.labels
        if any(trial.record.recording == name for trial in scores.trials_of(label))
    ]
    return measured_table((f"dynamic, {MIDDLE_S:g} s", "PR-AUC", "F1", "FSS, 5 cells"), rows)


def sections_of(scores: PlaceScores) -> dict[str, ResultSection]:
    """The sections of the results file."""
    pooled = [
        (f"{title} {STRATA[stratum]}, {h:g} s", stratum, score, h)
        for title, score in (("PR-AUC", "pr_auc"), ("F1", "f1"))
        for stratum in ("in-motion", "dynamic")
        for h in (0.5, 1.0)
    ]
    near = [
        (f"{h:g} s, {scale} cells", "dynamic", f"fss.{scale}_cells", h) for h in (0.5, 1.0) for scale in (1, 3, 5, 9)
    ]
    tables = {
        "pooled": scores.table("together", pooled),
        "visible": scores.over_horizons("F1, visible", "visible", "f1"),
        SKILL: scores.table("FSS, dynamic", near),
        "recordings": contents(scores),
        "by recording": by_recording(scores),
        "trainings": scores.training_table(),
        **{f"difference, {STRATA[one]}": scores.difference_table(one) for one in SHOWN_STRATA},
    }
    measured = [one.name for one in REAL if one.name in scores.described]
    values = {
        "forecasts": str(sum(scores.forecasts.values())),
        "not measured": not_measured(scores.labels),
        "recordings not measured": ", ".join(one.name for one in REAL if one.name not in measured) or "none",
        "intervals": scores.why_no_interval or "95 % intervals over blocks of time",
    }
    return {"scores": ResultSection(command=COMMAND, tables=tables, values=values)}


def main(arguments: Sequence[str] | None = None) -> None:
    parser = place_parser(__doc__, Path("runs/real-results"), RESULTS)
    parser.add_argument("data", type=Path)
    parser.add_argument("--recording", action="append", help="such as aces; default: all of them")
    given = parser.parse_args(arguments)
    if not given.collect:
        recordings = [one for one in REAL if given.recording is None or one.name in given.recording]
        folder = given.out.with_name(f"{given.out.name}-recordings")
        compare_places(given, imported(recordings, given.data, folder), given.out)
    write_places(given.results, sections_of(PlaceScores.read(given.out)))


if __name__ == "__main__":
    main()
