"""Drives with perfect poses, wheel odometry, kiss-icp and ego-motion ignored, beside a laser that stands.

`python -m studies.moving` (hours) compares the trackers on the twenty drives of data/drives, with each kind of poses in
a folder below `--out`, and writes `--results`. An interrupted comparison is continued. Thresholds are chosen on the
validation drives of `python -m studies.support.drive_training`, with poses of the same kind. The weights are those in
studies/trainings/drives; a tracker that has none there is left out and named.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.referee.splits import ORACLE
from gridtrack.evaluation.runs.finished import FinishedTrial
from gridtrack.evaluation.runs.summary import RunSummary, read_summary
from gridtrack.evaluation.statistics.frame_counts import FrameCounts
from gridtrack.evaluation.statistics.jackknife import PairedDifferences, jackknifed, pooled
from gridtrack.evaluation.statistics.run_statistics import RunStatistics
from gridtrack.evaluation.statistics.score_intervals import summed_by_unit
from gridtrack.recordings import open_recording
from gridtrack.recordings.observation import reference_pose
from gridtrack.reports import differences
from gridtrack.simulation.junction.drives import CARRIERS

from studies.ego_motion import Pairs, errors
from studies.support.comparison import compare, finished_trials
from studies.support.drive_recordings import KINDS, joined_recording, minutes_in, recording_of
from studies.support.results_file import ResultSection, ResultTable, measured_table, write_section
from studies.support.score_text import pair_text, score_text
from studies.support.unseen_places import HORIZONS_S, STRATA

DRIVES, VALIDATION = Path("data/drives"), Path("runs/drives/validation")
WEIGHTS = Path("studies/trainings/drives")
FLOOR = "persistence"
TRACKERS = ("kalman", "factor-graph", "dogma", "dilated-convgru", "deep-tracking-rnn")
CARRIER_S = 1.0
"""The horizon of the scores by carrier."""
EVERY_S = 2.0
"""Between two scored forecasts: half as many as usual, for there are five comparisons."""
PAIRS_S = 1.0
"""The horizon at which trackers are told apart."""
APART = 20
"""Scans between two poses whose relative error is measured: 2.5 s, the longest forecast."""
COMMAND = "python -m studies.moving"


@dataclass(frozen=True)
class Comparison:
    """The comparison of all trackers on all drives with one kind of poses."""

    kind: str
    summary: RunSummary
    finished: tuple[FinishedTrial, ...]
    statistics: RunStatistics

    @classmethod
    def read(cls, kind: str, folder: Path) -> Comparison:
        """The comparison in `folder`. Raises SystemExit where a row is partial: no score is of some drives only."""
        summary = read_summary(folder)
        for label, row in summary.trackers.items():
            if row.pooled is None or row.pooled.outcome != "ok":
                why = row.pooled.reason if row.pooled else "a single drive"
                raise SystemExit(f"{folder}: {label} is not complete ({why}): run it again with two drives or more")
        finished = finished_trials(folder, summary)
        return cls(kind, summary, tuple(finished), RunStatistics(summary.recordings, finished))

    def trials(self, tracker: str) -> list[FinishedTrial]:
        """Those of a tracker on all drives, in the order of their names."""
        own = (trial for trial in self.finished if trial.record.label == tracker)
        return sorted(own, key=lambda trial: trial.record.recording)

    def scores(self, row: str, stratum: str) -> list[str]:
        """F1 of a tracker or of the oracle at HORIZONS_S with intervals, all drives pooled."""
        together = self.summary.trackers[row].pooled
        assert together is not None
        found = together.strata[stratum]
        return [f1_text(found.f1[step], found.at("f1_low", step), found.at("f1_high", step)) for step in self.steps]

    @property
    def steps(self) -> list[int]:
        """The steps of HORIZONS_S."""
        horizons_s = next(iter(self.summary.recordings.values())).horizons_s
        return [horizons_s.index(horizon_s) for horizon_s in HORIZONS_S]

    def less(self, other: Comparison, tracker: str) -> dict[str, PairedDifferences]:
        """F1 of a tracker less that with `other` poses, by stratum and step: a drive is a statistical unit.

        Both have the same scored stamps, but other frames, in windows about other poses: drives are paired, cells are
        not.
        """
        (own, others), strata = self._by_minute((self, tracker), (other, tracker))
        found = differences(own, others)
        return {stratum: found.column(strata.index(stratum)) for stratum in STRATA}

    def less_beyond_floor(self, other: Comparison, tracker: str) -> dict[str, PairedDifferences]:
        """What a tracker loses with `other` poses beyond what FLOOR loses, as `less`: what is not the view's."""
        rows = [(kind, row) for kind in (self, other) for row in (tracker, FLOOR)]
        counts, strata = self._by_minute(*rows)
        own, floor, others, others_floor = map(jackknifed, counts)
        found = own.minus(floor).less(others.minus(others_floor))
        return {stratum: found.column(strata.index(stratum)) for stratum in STRATA}

    def _by_minute(self, *rows: tuple[Comparison, str]) -> tuple[list[NDArray[np.float64]], tuple[str, ...]]:
        """Counts (U, S, K, C) of each row, a tracker in a comparison, summed by minute; the names of the K strata."""
        frames: list[list[FrameCounts]] = []
        for kind, tracker in rows:
            own = [kind.statistics.frames_of(trial) for trial in kind.trials(tracker)]
            frames.append(own)
            paired = zip(own, frames[0], strict=True)
            if not all(np.array_equal(one.stamps_ns, first.stamps_ns) for one, first in paired):
                raise SystemExit(f"{tracker}: {kind.kind} and {self.kind} are scored at other times: run it again")
        counts, _ = summed_by_unit(frames, self.statistics.unit_rule(sorted(self.summary.recordings)))
        return counts, self.trials(rows[0][1])[0].strata


def selections() -> dict[str, str]:
    """The trackers that can run, as `--tracker` names them, by label."""
    trained = [name for name in TRACKERS if list((WEIGHTS / name).glob("*.toml"))]
    return {FLOOR: FLOOR} | {name: f"{name}={name}:weights={WEIGHTS}" for name in trained}


def run(minutes: Sequence[str], trackers: Sequence[str], out: Path, options: Sequence[str]) -> None:
    """Compare on all drives with each kind of poses."""
    made = out / "recordings"
    chosen = [selections()[tracker] for tracker in trackers]
    for kind in KINDS:
        recordings = [recording_of(kind, minute, DRIVES, made) for minute in minutes]
        validation, every = joined_recording(kind, VALIDATION, made), ("--every", f"{EVERY_S:g}s")
        compare(recordings, validation, chosen, out / kind, *every, "--resume", *options)


def pose_errors(minutes: Sequence[str], made: Path) -> ResultTable:
    """Errors of the poses under test by carrier: between scans APART, and after the whole drive."""
    rows = []
    for kind in ("odometry", "kiss-icp"):
        for carrier in CARRIERS:
            found = [errors_of(recording_of(kind, minute, DRIVES, made)) for minute in minutes if carrier in minute]
            position_m, heading_deg = np.concatenate([apart for apart, _ in found]).T
            ends_m = [end_m for _, end_m in found]
            last = f"{np.percentile(heading_deg, 95):.2f}", f"{np.median(ends_m):.1f}", f"{max(ends_m):.1f}"
            rows.append([f"{kind}, {carrier}", *(f"{one:.3f}" for one in np.percentile(position_m, [50, 95])), *last])
    columns = ("poses", "median, m", "95 %, m", "heading 95 %, deg", "after 60 s, median, m", "after 60 s, largest, m")
    return measured_table(columns, rows)


def errors_of(path: Path) -> tuple[NDArray[np.float64], float]:
    """(n, 2) errors between scans APART, metres and degrees, and the distance from the true position at the end."""
    scans = list(open_recording(path).scans())
    poses, true = ([scan.world_T_sensor for scan in scans], [reference_pose(scan) for scan in scans])
    first = np.arange(len(scans) - APART)
    relative = [true[i].inverse() @ true[i + APART] for i in first]
    seconds = np.array([scans[i].stamp_ns / 1e9 for i in first])
    apart = errors(poses, Pairs(np.stack([first, first + APART], axis=1), seconds, relative))
    return apart, math.hypot(poses[-1].x - true[-1].x, poses[-1].y - true[-1].y)


def score_tables(compared: Sequence[Comparison], trackers: Sequence[str]) -> dict[str, ResultTable]:
    """F1 by stratum: a row for each tracker and kind of poses, after the oracle's."""
    return {
        name: f1_table(
            name,
            [[f"{row}, {one.kind}", *one.scores(row, stratum)] for row in (ORACLE, *trackers) for one in compared],
        )
        for stratum, name in STRATA.items()
    }


def f1_table(stratum: str, rows: Sequence[Sequence[str]]) -> ResultTable:
    return measured_table((f"F1, {stratum}", *(f"{horizon_s:g} s" for horizon_s in HORIZONS_S)), rows)


def carrier_table(compared: Sequence[Comparison], trackers: Sequence[str]) -> ResultTable:
    """F1 at CARRIER_S by carrier, each of half of the drives: too few for intervals."""
    strata = ("dynamic", "occluded")
    rows = []
    for tracker in trackers:
        for one in compared:
            step = one.steps[HORIZONS_S.index(CARRIER_S)]
            texts = []
            for carrier in CARRIERS:
                trials = [trial for trial in one.trials(tracker) if carrier in trial.record.recording]
                f1 = pooled(np.concatenate([one.statistics.frames_of(trial).counts for trial in trials]), "f1")[step]
                texts += [f"{f1[trials[0].strata.index(stratum)]:.3f}" for stratum in strata]
            rows.append([f"{tracker}, {one.kind}", *texts])
    columns = [f"{carrier}, {STRATA[stratum]}" for carrier in CARRIERS for stratum in strata]
    return measured_table((f"F1, {CARRIER_S:g} s", *columns), rows)


def difference_section(compared: Sequence[Comparison], trackers: Sequence[str]) -> ResultSection:
    """What each tracker loses with other poses than perfect ones, and against standing."""
    perfect, *others = compared
    found = {
        f"{tracker}, {perfect.kind} less {other.kind}": perfect.less(other, tracker)
        for tracker in trackers
        for other in others
    }
    return _differences(found, perfect.steps)


def view_section(compared: Sequence[Comparison], trackers: Sequence[str]) -> ResultSection:
    """What each tracker loses against standing beyond what FLOOR loses, which knows nothing but the view."""
    perfect, *_, standing = compared
    lost = {tracker: perfect.less_beyond_floor(standing, tracker) for tracker in trackers if tracker != FLOOR}
    return _differences(lost, perfect.steps)


def pair_section(perfect: Comparison) -> ResultSection:
    """F1 of one tracker less that of another with perfect poses, by stratum: PAIRS_S ahead, with Holm's correction."""
    chosen = {one.stratum: one for one in perfect.summary.pairs if one.score == "f1" and one.horizon_s == PAIRS_S}
    rows: dict[str, list[str]] = {}
    for family in chosen.values():
        for one in family.pairs:
            rows.setdefault(f"{one.tracker} less {one.other}", []).append(pair_text(one))
    columns = (f"F1, {PAIRS_S:g} s", *(STRATA[stratum] for stratum in chosen))
    table = measured_table(columns, [[pair, *texts] for pair, texts in rows.items()])
    return ResultSection(command=COMMAND, tables={"pairs": table})


def _differences(found: Mapping[str, Mapping[str, PairedDifferences]], steps: Sequence[int]) -> ResultSection:
    """A table for each stratum with a row for each of `found`, and each cell as a value."""
    texts = {
        name: [[row, *(difference_text(of[stratum].at(step)) for step in steps)] for row, of in found.items()]
        for stratum, name in STRATA.items()
    }
    values = {
        f"{row}, {name}, {horizon_s:g} s": text
        for name, rows in texts.items()
        for row, *cells in rows
        for horizon_s, text in zip(HORIZONS_S, cells, strict=True)
    }
    tables = {name: f1_table(name, rows) for name, rows in texts.items()}
    return ResultSection(command=COMMAND, tables=tables, values=values)


def f1_text(value: float | None, low: float | None, high: float | None) -> str:
    """F1 with its interval, or a dash where no cell of the stratum is occupied."""
    return "–" if value is None else score_text(value, low, high)


def difference_text(found: PairedDifferences) -> str:
    value, low, high = (float(one) for one in (found.value, found.low, found.high))
    return score_text(value, *(() if math.isnan(low) else (low, high)), signed=True)


def collect(minutes: Sequence[str], trackers: Sequence[str], out: Path, results: Path) -> None:
    """Write the results of the comparisons in `out`."""
    compared = [Comparison.read(kind, out / kind) for kind in KINDS]
    missing = ", ".join(f"`{name}`" for name in TRACKERS if name not in trackers) or "none"
    sections = {
        "poses": ResultSection(command=COMMAND, tables={"errors": pose_errors(minutes, out / "recordings")}),
        "scores": ResultSection(
            command=COMMAND,
            tables={**score_tables(compared, trackers), "by carrier": carrier_table(compared, trackers)},
            values={"drives": str(len(minutes)), "not measured": missing},
        ),
        "differences": difference_section(compared, trackers),
        "beyond the view": view_section(compared, trackers),
        "told apart": pair_section(compared[0]),
    }
    for name, section in sections.items():
        write_section(results, name, section)
        print("\n\n".join(table.markdown() for table in section.tables.values()), end="\n\n")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--tracker", action="append", help="one of those that can run; default: all of them")
    parser.add_argument("--minute", action="append", help="a drive, such as car-202; default: all twenty")
    parser.add_argument("--out", type=Path, default=Path("runs/moving"))
    parser.add_argument("--results", type=Path, default=Path("docs/results/moving/drives.json"))
    parser.add_argument("--jobs", default="1", help="trials at the same time")
    parser.add_argument("--collect", action="store_true", help="run nothing; write the results of what has run")
    given = parser.parse_args()
    minutes, trackers = given.minute or minutes_in(DRIVES), given.tracker or list(selections())
    if not given.collect:
        run(minutes, trackers, given.out, ["--jobs", given.jobs])
    collect(minutes, trackers, given.out, given.results)


if __name__ == "__main__":
    main()
