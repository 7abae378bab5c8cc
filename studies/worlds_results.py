"""Trackers with general weights on the twenty test worlds: places that none of them has learned.

`python -m studies.worlds_results` compares every tracker that has general weights, with its further trainings, on the
worlds of data/worlds/test, all in one run, and writes the numbers of docs/results/worlds and its drawing. Thresholds
are those of the cards, chosen on the validation worlds. A tracker without general weights is left out and named. An
interrupted comparison is continued with the same rows; `--out` takes another folder for others. Duration: a minute a
world for a network on one idle core, half of that for the pipeline, seconds for the floors.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from studies.support.place_command import collect_places, compare_places, place_parser, worlds_called
from studies.support.results_file import ResultSection, ResultTable, measured_table
from studies.support.score_text import score_text
from studies.support.unseen_places import (
    REFERENCE,
    STRATA,
    PlaceScores,
    not_measured,
)

RESULTS = Path("docs/results/worlds/worlds.json")
COMMAND = "python -m studies.worlds_results"
PARTS = ("indoors", "outdoors")
AIM_TRACKERS, AIM_HORIZONS_S, AIM_F1 = ("dilated-convgru", "kalman"), (0.5, 1.0), 0.10
"""The aim: these trackers are above the reference by AIM_F1 on dynamic cells at these horizons, interval apart."""


def aim_met(difference: float | None, low: float | None) -> str:
    """What a difference and the lower end of its interval say of the aim: at least AIM_F1, and the interval above 0."""
    if difference is None or low is None:
        return "no interval"
    return "met" if difference >= AIM_F1 and low > 0 else "not met"


def aim_table(scores: PlaceScores) -> ResultTable:
    """The aim by tracker and horizon: the difference, and whether it is met."""
    rows = []
    for tracker in AIM_TRACKERS:
        for horizon_s in AIM_HORIZONS_S:
            name = f"{tracker} less {REFERENCE}, {horizon_s:g} s"
            if tracker not in scores.differences:
                rows.append([name, "", "not measured"])
                continue
            value, low, high = scores.difference(tracker, "dynamic", horizon_s)
            text = "" if value is None else score_text(value, low, high, signed=True)
            rows.append([name, text, aim_met(value, low)])
    return measured_table(("F1, dynamic", "difference", "at least 0.10"), rows)


def part_table(parts: Mapping[str, PlaceScores], labels: list[str]) -> ResultTable:
    """F1 a second ahead indoors and outdoors, each of ten worlds: too few for intervals."""
    strata = ("in-motion", "dynamic", "visible", "occluded")
    rows = [
        [label, *(part.text(label, stratum, "f1", 1.0) for part in parts.values() for stratum in strata)]
        for label in labels
    ]
    columns = (f"{part}, {STRATA[stratum]}" for part in parts for stratum in strata)
    return measured_table(("F1, 1 s", *columns), rows)


def sections_of(scores: PlaceScores) -> dict[str, ResultSection]:
    """The sections of the results file."""
    several = [part for part in PARTS if sum(name.startswith(part) for name in scores.described) > 1]
    parts = {part: scores.of(part) for part in several}
    near = [(f"{h:g} s, {scale} cells", "dynamic", f"fss_{scale}", h) for h in (0.5, 1.0) for scale in (1, 3, 5, 9)]
    along = [
        (f"{h:g} s, {name}", stratum, score, h)
        for h in (0.5, 1.0)
        for name, stratum, score in (("soft IoU", "dynamic", "soft_iou"), ("beam error, m", "in-motion", "beam_error"))
    ]
    return {
        "scores": ResultSection(
            command=COMMAND,
            tables={
                **{name: scores.over_horizons(f"F1, {name}", stratum, "f1") for stratum, name in STRATA.items()},
                "PR-AUC": scores.over_horizons("PR-AUC, dynamic", "dynamic", "pr_auc"),
                "indoors and outdoors": part_table(parts, scores.labels),
                "fractions skill": scores.table("FSS, dynamic", near),
                "along beams": scores.table("", along),
                "trainings": scores.training_table(),
            },
            values={
                "forecasts": str(sum(scores.forecasts.values())),
                "not measured": not_measured(scores.labels),
            },
        ),
        "differences": ResultSection(
            command=COMMAND,
            tables={
                **{name: scores.difference_table(stratum) for stratum, name in STRATA.items()},
                "aim": aim_table(scores),
            },
        ),
    }


def main() -> None:
    parser = place_parser(__doc__, Path("runs/worlds-results"), RESULTS)
    parser.add_argument("--world", action="append", help="such as indoors-room-1008; default: all twenty")
    given = parser.parse_args()
    if not given.collect:
        compare_places(given, worlds_called(given.world))
    collect_places(given, sections_of)


if __name__ == "__main__":
    main()
