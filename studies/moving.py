"""Drives with perfect poses, wheel odometry, kiss-icp and ignored ego-motion, beside a laser that stands.

`python -m studies.moving` (two hours on an idle core) compares trackers with general weights on the twenty drives of
data/drives, with each kind of poses in a folder below `--out`, and writes `--results`. An interrupted comparison
resumes. Forecasts are always scored by the true poses, at the thresholds of the cards. `--pictures TRACKER` (some
seconds) draws forecasts of the finished comparisons, with perfect and with ignored poses.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.files import atomic_write
from gridtrack.common.geometry import SE2, wrap_angle
from gridtrack.common.scan import Scan
from gridtrack.evaluation.referee.samples import SAMPLES, Sample, read_samples
from gridtrack.evaluation.referee.splits import ORACLE
from gridtrack.evaluation.runs.finished import FinishedTrial
from gridtrack.evaluation.scores.definition import Sums
from gridtrack.evaluation.scores.registry import built_in, find_output
from gridtrack.evaluation.statistics.jackknife import IntervalEstimate, Replicates, difference, replicates
from gridtrack.recordings import import_recording, open_recording
from gridtrack.recordings.formats.native import write_native
from gridtrack.recordings.observation import reference_pose
from gridtrack.simulation.junction.drives import CARRIERS

from studies.support.drawings import draw_pictures, forecast_pictures
from studies.support.results_file import (
    ResultSection,
    ResultTable,
    measured_table,
    score_text,
    write_section,
)
from studies.support.unseen_places import (
    CONTACTS,
    CONTACTS_FORESEEN,
    REFERENCE,
    PlaceScores,
    compare_places,
    place_parser,
)

DRIVES = Path("data/drives")
RESULTS, PICTURES = Path("docs/results/moving/drives.json"), Path("docs/results/moving/drives.svg")
RECORDED = {"perfect": "", "odometry": "-odometry", "beside": "-beside"}
"""Suffix of the file name, by kind of poses, of the drives that are simulated with them."""
KINDS = ("perfect", "odometry", "kiss-icp", "ignored", "beside")
"""Kinds of poses; beside: of a laser that stands beside the drive in the same minute."""
TRACKERS = (REFERENCE, "stationary", "kalman", "dogma", "dilated-convgru")
SCORES = {CONTACTS: CONTACTS_FORESEEN, "f1": "F1"}
"""The scores, and their headings."""
STRATUM, AHEAD_S = "dynamic", 1.0
"""The scored cells, and the horizon of the tables and pictures."""
APART = 20
"""Scans between two poses with a measured relative error: 2.5 s, the longest forecast."""
COMMAND = "python -m studies.moving"
MOMENTS = (("car-202", 46.0), ("robot-201", 30.0))
"""A drive, and seconds since its beginning; the nearest of the kept forecasts is drawn."""
DRAWN_KINDS = ("perfect", "ignored")


def drives_in(folder: Path) -> list[str]:
    """The names of the drives in a folder, such as `car-202`."""
    return sorted(path.stem for path in folder.glob("*.tracks") if path.stem.count("-") == 1)


def recording_of(kind: str, drive: str, out: Path) -> Path:
    """The recording of a drive with one of KINDS of poses; derived ones are written below `out`."""
    if kind in RECORDED:
        return DRIVES / f"{drive}{RECORDED[kind]}.tracks"
    path, source = out / kind / f"{drive}.mcap", DRIVES / f"{drive}.tracks"
    if not path.exists() and kind == "kiss-icp":
        import_recording(source, path, ego_motion="kiss-icp")
    elif not path.exists():
        recording = open_recording(source)
        described = {"poses": "ignored", "source": recording.name, "source_sha256": recording.sha256}
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(path) as file:
            write_native(file, recording.info.model_copy(update=described), standing(recording.scans()))
    return path


def standing(scans: Iterable[Scan]) -> Iterator[Scan]:
    """`scans` as if the sensor stood at its first pose; the recorded poses become the reference poses."""
    first: SE2 | None = None
    for scan in scans:
        first = scan.world_T_sensor if first is None else first
        yield replace(scan, world_T_sensor=first, reference_T_sensor=scan.reference_T_sensor or scan.world_T_sensor)


@dataclass(frozen=True)
class Comparison:
    """The comparison of all trackers on all drives with one kind of poses."""

    kind: str
    scores: PlaceScores

    def less(self, other: Comparison, tracker: str, score: str) -> IntervalEstimate:
        """A score of a tracker less the same with `other` poses; a drive is a statistical unit.

        Both have the same scored stamps but other frames, in windows about other poses: drives are paired, cells are
        not. Raises SystemExit for other stamps.
        """
        return difference(*self._paired(other, tracker, score))

    def less_beyond(self, floor: str, other: Comparison, tracker: str, score: str) -> IntervalEstimate:
        """The same, less the loss of `floor`, which knows nothing but the view."""
        (own, others), (lost, others_lost) = (self._paired(other, row, score) for row in (tracker, floor))
        return difference(own.minus(lost), others.minus(others_lost))

    def _paired(self, other: Comparison, tracker: str, score: str) -> tuple[Replicates, Replicates]:
        if self._stamps(tracker) != other._stamps(tracker):
            raise SystemExit(f"{tracker}: {self.kind} and {other.kind} are scored at different times: run it again")
        return self._by_drive(tracker, score), other._by_drive(tracker, score)

    def _trials(self, tracker: str) -> list[FinishedTrial]:
        return sorted(self.scores.trials_of(tracker), key=lambda trial: trial.record.recording)

    def _stamps(self, tracker: str) -> list[list[int]]:
        return [self.scores.run.frames(trial).stamps_ns.tolist() for trial in self._trials(tracker)]

    def _by_drive(self, tracker: str, score: str) -> Replicates:
        """The score AHEAD_S ahead in STRATUM; its units are drives."""
        definition, output = find_output(score, built_in())
        at, found = self.scores.horizons[AHEAD_S], []
        for trial in self._trials(tracker):
            of_frames = self.scores.run.sums(trial).by_frame(definition.name, [trial.steps[at]], [STRATUM], ())
            found.append(Sums(of_frames.values.sum(axis=0), of_frames.parts))
        drives = Sums(np.stack([one.values for one in found])[:, 0, 0], found[0].parts)
        total = Sums(drives.values.sum(axis=0), drives.parts)
        return replicates(definition.value, lambda: iter([drives]), total)[output.name]


def pose_errors(drives: Sequence[str], made: Path) -> ResultTable:
    """Errors of the poses under test by carrier: between scans APART, and after the whole drive."""
    rows = []
    for kind in ("odometry", "kiss-icp"):
        for carrier in CARRIERS:
            found = [errors_of(recording_of(kind, drive, made)) for drive in drives if carrier in drive]
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


def score_table(compared: Sequence[Comparison], score: str) -> ResultTable:
    """A score in STRATUM, AHEAD_S ahead: a row for each tracker and the oracle, a column for each kind of poses."""
    rows = [
        [label, *(one.scores.text(label, STRATUM, score, AHEAD_S) for one in compared)]
        for label in compared[0].scores.labels
    ]
    return measured_table((heading_of(score), *(one.kind for one in compared)), rows)


def difference_table(compared: Sequence[Comparison], score: str) -> ResultTable:
    """The gain of each tracker with perfect poses, the first of `compared`, over each other kind."""
    perfect, *others = compared
    rows = [
        [label, *(difference_text(perfect.less(other, label, score)) for other in others)]
        for label in trackers_of(perfect)
    ]
    return measured_table((heading_of(score), *(f"perfect less {one.kind}" for one in others)), rows)


def view_table(compared: Sequence[Comparison]) -> ResultTable:
    """The gain of each tracker over standing, the last of `compared`, beyond the gain of REFERENCE."""
    perfect, *_, beside = compared
    rows = [
        [label, *(difference_text(perfect.less_beyond(REFERENCE, beside, label, score)) for score in SCORES)]
        for label in trackers_of(perfect)
        if label != REFERENCE
    ]
    return measured_table(("perfect less beside", *map(heading_of, SCORES)), rows)


def heading_of(score: str) -> str:
    """The heading of a table of a score."""
    return f"{SCORES[score]}, {STRATUM}, {AHEAD_S:g} s"


def trackers_of(comparison: Comparison) -> list[str]:
    """The rows of a comparison that have differences: the oracle has none."""
    return [label for label in comparison.scores.labels if label != ORACLE]


def difference_text(found: IntervalEstimate) -> str:
    """One difference with its interval."""
    return score_text(*map(float, (found.value, found.low, found.high)), signed=True)


def sections_of(compared: Sequence[Comparison], poses: ResultTable) -> Mapping[str, ResultSection]:
    """The sections of the results file."""
    return {
        "poses": ResultSection(command=COMMAND, tables={"errors": poses}),
        "scores": ResultSection(
            command=COMMAND,
            tables={heading: score_table(compared, score) for score, heading in SCORES.items()},
            values={"drives": str(len(compared[0].scores.described))},
        ),
        "differences": ResultSection(
            command=COMMAND,
            tables={heading: difference_table(compared, score) for score, heading in SCORES.items()},
        ),
        "beyond the view": ResultSection(command=COMMAND, tables={"differences": view_table(compared)}),
    }


def draw_moments(tracker: str, out: Path, picture: Path) -> None:
    """Draw forecasts of a tracker at MOMENTS with each of DRAWN_KINDS of poses."""
    rows = []
    for drive, at_s in MOMENTS:
        for kind in DRAWN_KINDS:
            sample = min(read_samples(out / kind / f"{tracker}@{drive}" / SAMPLES), key=_distance_from(at_s))
            title = f"{drive}, {sample.stamp_ns / 1e9:.1f} s, {kind}"
            rows.append(forecast_pictures(title, {tracker: sample}, AHEAD_S))
    draw_pictures(rows, picture)


def _distance_from(at_s: float) -> Callable[[Sample], float]:
    return lambda sample: abs(sample.stamp_ns / 1e9 - at_s)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = place_parser(__doc__, Path("runs/moving"), RESULTS)
    parser.set_defaults(every="2s")
    parser.add_argument("--drive", action="append", help="such as car-202; default: all twenty")
    parser.add_argument("--pictures", metavar="TRACKER", help=f"run nothing; draw {PICTURES}")
    given = parser.parse_args(arguments)
    if given.pictures:
        draw_moments(given.pictures, given.out, PICTURES)
        return
    drives, given.tracker = given.drive or drives_in(DRIVES), given.tracker or TRACKERS
    for kind in () if given.collect else KINDS:
        recordings = [recording_of(kind, drive, given.out / "recordings") for drive in drives]
        compare_places(given, recordings, given.out / kind)
    compared = [Comparison(kind, PlaceScores.read(given.out / kind)) for kind in KINDS]
    for name, section in sections_of(compared, pose_errors(drives, given.out / "recordings")).items():
        write_section(given.results, name, section)
        print(section.text(), end="\n\n")


if __name__ == "__main__":
    main()
