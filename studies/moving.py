"""Drives with perfect poses, wheel odometry, kiss-icp and ignored ego-motion, beside a laser that stands.

`python -m studies.moving` (hours) compares the trackers on the twenty drives of data/drives, with each kind of poses in
a folder below `--out`, and writes `--results`. An interrupted comparison resumes. Thresholds are chosen on the
validation drives of `python -m studies.drive_recordings`, with poses of the same kind. The weights are those in
studies/trainings/drives; a tracker without weights there is left out and named. `--pictures TRACKER` (some seconds)
draws forecasts of the finished comparisons, with perfect and with ignored poses.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.geometry import SE2, wrap_angle
from gridtrack.evaluation.referee.samples import SAMPLES, Sample, read_samples
from gridtrack.evaluation.referee.splits import ORACLE
from gridtrack.evaluation.runs.sums import ScoredFrames
from gridtrack.evaluation.scores.definition import Ratio, Sums
from gridtrack.evaluation.scores.f1 import F1
from gridtrack.evaluation.statistics.jackknife import IntervalEstimate, Replicates, difference, ratio_replicates
from gridtrack.recordings import open_recording
from gridtrack.recordings.observation import reference_pose
from gridtrack.simulation.junction.drives import CARRIERS

from studies.drive_recordings import KINDS, drives_in, joined_recording, recording_of
from studies.support.comparison import compare
from studies.support.drawings import draw_pictures, forecast_pictures
from studies.support.results_file import (
    ResultSection,
    ResultTable,
    measured_table,
    score_text,
    study_parser,
    write_section,
)
from studies.support.unseen_places import HORIZONS_S, STRATA, PlaceScores, pair_text

DRIVES, VALIDATION = Path("data/drives"), Path("runs/drives/validation")
WEIGHTS = Path("studies/trainings/drives")
OUT = Path("runs/moving")
RESULTS, PICTURES = Path("docs/results/moving/drives.json"), Path("docs/results/moving/drives.svg")
FLOOR = "persistence"
TRACKERS = ("kalman", "factor-graph", "dogma", "dilated-convgru", "deep-tracking-rnn")
EVERY_S = 2.0
"""Between two scored forecasts: twice as long as usual, because there are five comparisons."""
TABLE_S = 1.0
"""The horizon of the scores by carrier, of the differences between trackers, and of the pictures."""
APART = 20
"""Scans between two poses with a measured relative error: 2.5 s, the longest forecast."""
COMMAND = "python -m studies.moving"
MOMENTS = (("car-202", 46.0), ("robot-201", 30.0))
"""A drive, and seconds since its beginning; the nearest of the kept forecasts is drawn."""
DRAWN_KINDS = ("perfect", "ignored")


@dataclass(frozen=True)
class Comparison:
    """The comparison of all trackers on all drives with one kind of poses."""

    kind: str
    scores: PlaceScores

    @classmethod
    def read(cls, kind: str, folder: Path) -> Comparison:
        """The comparison in `folder`. Raises SystemExit if it is not complete."""
        return cls(kind, PlaceScores.read(folder))

    def less(self, other: Comparison, tracker: str) -> dict[str, IntervalEstimate]:
        """F1 of a tracker less its F1 with `other` poses, by stratum and step; a drive is a statistical unit.

        Both have the same scored stamps but other frames, in windows about other poses: drives are paired, cells are
        not.
        """
        own, others = self._by_drive((self, tracker), (other, tracker))
        return {stratum: difference(own[stratum], others[stratum]) for stratum in STRATA}

    def less_beyond_floor(self, other: Comparison, tracker: str) -> dict[str, IntervalEstimate]:
        """The same, less the loss of FLOOR, which knows nothing but the view."""
        rows = self._by_drive(*((kind, row) for kind in (self, other) for row in (tracker, FLOOR)))
        own, floor, others, others_floor = rows
        return {
            stratum: difference(own[stratum].minus(floor[stratum]), others[stratum].minus(others_floor[stratum]))
            for stratum in STRATA
        }

    def _by_drive(self, *rows: tuple[Comparison, str]) -> list[dict[str, Replicates]]:
        """F1 (S,) of each row, a tracker in a comparison, by stratum; its units are drives."""
        frames: list[list[ScoredFrames]] = []
        found = []
        for kind, tracker in rows:
            run = kind.scores.run
            trials = sorted(kind.scores.trials_of(tracker), key=lambda trial: trial.record.recording)
            frames.append([run.frames(trial) for trial in trials])
            paired = zip(frames[-1], frames[0], strict=True)
            if not all(np.array_equal(one.stamps_ns, first.stamps_ns) for one, first in paired):
                raise SystemExit(f"{tracker}: {kind.kind} and {self.kind} are scored at different times: run it again")
            by_drive = [run.sums(trial).by_frame("f1", trial.steps, tuple(STRATA), ()) for trial in trials]
            sums = Sums(np.stack([one.values.sum(axis=0) for one in by_drive]), by_drive[0].parts)
            f1 = F1.value(sums)["f1"]
            assert isinstance(f1, Ratio)
            found.append(
                {
                    stratum: ratio_replicates(Ratio(f1.part[..., k], f1.whole[..., k], counted=True))
                    for k, stratum in enumerate(STRATA)
                }
            )
        return found


def selections() -> dict[str, str]:
    """The trackers that can run, as values of `--tracker` by label."""
    trained = [name for name in TRACKERS if list((WEIGHTS / name).glob("*.toml"))]
    return {FLOOR: FLOOR} | {name: f"{name}={name}:weights={WEIGHTS}" for name in trained}


def run(drives: Sequence[str], trackers: Sequence[str], out: Path, jobs: str) -> None:
    """Compare on all drives with each kind of poses."""
    made = out / "recordings"
    chosen = [selections()[tracker] for tracker in trackers]
    options = ("--every", f"{EVERY_S:g}s", "--resume", "--jobs", jobs)
    for kind in KINDS:
        recordings = [recording_of(kind, drive, DRIVES, made) for drive in drives]
        compare(recordings, joined_recording(kind, VALIDATION, made), chosen, out / kind, *options)


def pose_errors(drives: Sequence[str], made: Path) -> ResultTable:
    """Errors of the poses under test by carrier: between scans APART, and after the whole drive."""
    rows = []
    for kind in ("odometry", "kiss-icp"):
        for carrier in CARRIERS:
            found = [errors_of(recording_of(kind, drive, DRIVES, made)) for drive in drives if carrier in drive]
            position_m, heading_deg = np.concatenate([apart for apart, _ in found]).T
            ends_m = [end_m for _, end_m in found]
            last = f"{np.percentile(heading_deg, 95):.2f}", f"{np.median(ends_m):.1f}", f"{max(ends_m):.1f}"
            rows.append([f"{kind}, {carrier}", *(f"{one:.3f}" for one in np.percentile(position_m, [50, 95])), *last])
    columns = ("poses", "median, m", "95 %, m", "heading 95 %, deg", "after 60 s, median, m", "after 60 s, largest, m")
    return measured_table(columns, rows)


def errors_of(path: Path) -> tuple[NDArray[np.float64], float]:
    """Errors (n, 2) between scans APART, metres and degrees, and the distance from the true position at the end."""
    scans = list(open_recording(path).scans())
    poses, true = ([scan.world_T_sensor for scan in scans], [reference_pose(scan) for scan in scans])
    off = [right.inverse() @ found for found, right in zip(motions(poses), motions(true), strict=True)]
    apart = np.array([(math.hypot(one.x, one.y), abs(math.degrees(wrap_angle(one.theta)))) for one in off])
    return apart, math.hypot(poses[-1].x - true[-1].x, poses[-1].y - true[-1].y)


def motions(poses: Sequence[SE2]) -> list[SE2]:
    """The motion from each pose to the one APART later."""
    return [one.inverse() @ later for one, later in zip(poses[:-APART], poses[APART:], strict=True)]


def score_tables(compared: Sequence[Comparison], trackers: Sequence[str]) -> dict[str, ResultTable]:
    """F1 by stratum: a row for each tracker and kind of poses, after the oracle's."""
    return {
        name: f1_table(
            name,
            [
                [f"{row}, {one.kind}", *(one.scores.text(row, stratum, "f1", horizon_s) for horizon_s in HORIZONS_S)]
                for row in (ORACLE, *trackers)
                for one in compared
            ],
        )
        for stratum, name in STRATA.items()
    }


def f1_table(stratum: str, rows: Sequence[Sequence[str]]) -> ResultTable:
    return measured_table((f"F1, {stratum}", *(f"{horizon_s:g} s" for horizon_s in HORIZONS_S)), rows)


def carrier_table(compared: Sequence[Comparison], trackers: Sequence[str]) -> ResultTable:
    """F1 by carrier; half of the drives each are too few for intervals."""
    strata = ("dynamic", "occluded")
    texts: dict[str, list[str]] = {}
    for one in compared:
        for carrier in CARRIERS:
            of_carrier = one.scores.of([name for name in one.scores.described if carrier in name])
            for tracker in trackers:
                cells = (of_carrier.text(tracker, stratum, "f1", TABLE_S) for stratum in strata)
                texts.setdefault(f"{tracker}, {one.kind}", []).extend(cells)
    rows = [f"{tracker}, {one.kind}" for tracker in trackers for one in compared]
    columns = [f"{carrier}, {STRATA[stratum]}" for carrier in CARRIERS for stratum in strata]
    return measured_table((f"F1, {TABLE_S:g} s", *columns), [[row, *texts[row]] for row in rows])


def difference_section(compared: Sequence[Comparison], trackers: Sequence[str]) -> ResultSection:
    """The loss of each tracker with other poses than perfect ones, and against standing."""
    perfect, *others = compared
    found = {
        f"{tracker}, {perfect.kind} less {other.kind}": perfect.less(other, tracker)
        for tracker in trackers
        for other in others
    }
    return _differences(found, perfect)


def view_section(compared: Sequence[Comparison], trackers: Sequence[str]) -> ResultSection:
    """The loss of each tracker against standing beyond the loss of FLOOR."""
    perfect, *_, standing = compared
    lost = {tracker: perfect.less_beyond_floor(standing, tracker) for tracker in trackers if tracker != FLOOR}
    return _differences(lost, perfect)


def _differences(found: Mapping[str, Mapping[str, IntervalEstimate]], perfect: Comparison) -> ResultSection:
    """A table for each stratum with a row for each of `found`, and each cell as a value."""
    steps = perfect.scores.horizons
    texts = {
        name: [[row, *(difference_text(of[stratum].at(step)) for step in steps.values())] for row, of in found.items()]
        for stratum, name in STRATA.items()
    }
    values = {
        f"{row}, {name}, {horizon_s:g} s": text
        for name, rows in texts.items()
        for row, *cells in rows
        for horizon_s, text in zip(steps, cells, strict=True)
    }
    tables = {name: f1_table(name, rows) for name, rows in texts.items()}
    return ResultSection(command=COMMAND, tables=tables, values=values)


def difference_text(found: IntervalEstimate) -> str:
    """One difference with its interval."""
    return score_text(*map(float, (found.value, found.low, found.high)), signed=True)


def pair_section(perfect: Comparison) -> ResultSection:
    """Differences in F1 between trackers with perfect poses, by stratum, TABLE_S ahead."""
    step = perfect.scores.horizons[TABLE_S]
    chosen = {
        one.stratum: one
        for one in perfect.scores.pair_families
        if (one.score, one.output, one.step) == ("f1", "f1", step)
    }
    rows: dict[str, list[str]] = {}
    for family in chosen.values():
        for one in family.pairs:
            rows.setdefault(f"{one.tracker} less {one.other}", []).append(pair_text(one))
    columns = (f"F1, {TABLE_S:g} s", *(STRATA[stratum] for stratum in chosen))
    table = measured_table(columns, [[pair, *texts] for pair, texts in rows.items()])
    return ResultSection(command=COMMAND, tables={"pairs": table})


def collect(drives: Sequence[str], trackers: Sequence[str], out: Path, results: Path) -> None:
    """Write the results of the comparisons in `out`."""
    compared = [Comparison.read(kind, out / kind) for kind in KINDS]
    missing = ", ".join(f"`{name}`" for name in TRACKERS if name not in trackers) or "none"
    sections = {
        "poses": ResultSection(command=COMMAND, tables={"errors": pose_errors(drives, out / "recordings")}),
        "scores": ResultSection(
            command=COMMAND,
            tables={**score_tables(compared, trackers), "by carrier": carrier_table(compared, trackers)},
            values={"drives": str(len(drives)), "not measured": missing},
        ),
        "differences": difference_section(compared, trackers),
        "beyond the view": view_section(compared, trackers),
        "tracker pairs": pair_section(compared[0]),
    }
    for name, section in sections.items():
        write_section(results, name, section)
        print(section.text(), end="\n\n")


def draw_moments(tracker: str, out: Path, picture: Path) -> None:
    """Draw forecasts of a tracker at MOMENTS with each of DRAWN_KINDS of poses."""
    rows = []
    for drive, at_s in MOMENTS:
        for kind in DRAWN_KINDS:
            sample = min(read_samples(out / kind / f"{tracker}@{drive}" / SAMPLES), key=_distance_from(at_s))
            title = f"{drive}, {sample.stamp_ns / 1e9:.1f} s, {kind}"
            rows.append(forecast_pictures(title, {tracker: sample}, TABLE_S))
    draw_pictures(rows, picture)


def _distance_from(at_s: float) -> Callable[[Sample], float]:
    return lambda sample: abs(sample.stamp_ns / 1e9 - at_s)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = study_parser(__doc__)
    parser.add_argument("--tracker", action="append", help="such as kalman; default: all trackers that can run")
    parser.add_argument("--drive", action="append", help="such as car-202; default: all twenty")
    parser.add_argument("--out", type=Path, default=OUT, help="folder of the comparisons, default: %(default)s")
    parser.add_argument("--results", type=Path, default=RESULTS, help="results file, default: %(default)s")
    parser.add_argument("--jobs", default="1", help="trials at the same time")
    parser.add_argument("--collect", action="store_true", help="run nothing; write the results of finished comparisons")
    parser.add_argument("--pictures", metavar="TRACKER", help=f"run nothing; draw {PICTURES}")
    given = parser.parse_args(arguments)
    if given.pictures:
        draw_moments(given.pictures, given.out, PICTURES)
        return
    drives, trackers = given.drive or drives_in(DRIVES), given.tracker or list(selections())
    if not given.collect:
        run(drives, trackers, given.out, given.jobs)
    collect(drives, trackers, given.out, given.results)


if __name__ == "__main__":
    main()
