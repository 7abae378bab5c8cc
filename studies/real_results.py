"""Trackers with general weights on recordings of real robots: places that they have not learned.

`python -m studies.real_results DATA` compares every tracker with general weights on each of the recordings `REAL`, and
writes the numbers and the chart of docs/results/real. The recordings do not ship: DATA has the folders leg_tracker,
datmo, radish and ual. A sensor that moves gets refined poses (docs/importing.md), in recordings that are written once
beside the folder of the run. Thresholds come from the cards. An interrupted comparison resumes with the same rows. On
one idle core the poses need ten minutes, each network twenty.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gridtrack.common.files import atomic_write, sha256_of
from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridSpec
from gridtrack.common.scan import Scan
from gridtrack.recordings import open_recording
from gridtrack.recordings.ego_motion import matched_trajectory, with_matched_poses
from gridtrack.recordings.formats.native import write_native
from gridtrack.recordings.read_options import Mount, PoseSource, parse_mount
from gridtrack.recordings.recording_info import RecordingInfo

from studies.support.results_file import ResultSection, ResultTable, measured_table
from studies.support.unseen_places import (
    CONTACTS,
    CONTACTS_FORESEEN,
    STRATA,
    PlaceScores,
    compare_places,
    not_measured,
    place_parser,
    write_places,
)

CELLS = 100
"""Cells along a side of the window."""
NPZ_RANGE_MAX_M = 81.0


@dataclass(frozen=True)
class RealRecording:
    """A file, how it is read, and its grid and rate in comparisons."""

    name: str
    path: str
    rate_hz: float
    cell_m: float = 0.1
    window_from: tuple[float, float] | None = None
    """Lower left corner of the window, metres from the sensor; None: the sensor is in the middle.

    Windows do not turn, so only a standing sensor has one direction to face.
    """
    moves: bool = True
    topic: str | None = None
    pose_topic: str | None = None
    mounts: tuple[Mount, ...] = ()

    @property
    def grid(self) -> str:
        """A value of `--grid`."""
        return str(GridSpec(CELLS, self.cell_m, self.window_from))

    def scans(self, data: Path) -> Iterator[Scan]:
        """The scans, with the recorded poses."""
        path = data / self.path
        if path.suffix == ".npz":
            return npz_scans(path)
        return open_recording(path, topic=self.topic, pose_topic=self.pose_topic, mounts=self.mounts).scans()


EGO = (parse_mount("scan=0,0,0deg"),)
REAL = (
    RealRecording(
        "corridor", "leg_tracker/demo_stationary_simple_environment.bag", 10, window_from=(-2, -4.5), moves=False
    ),
    *(
        RealRecording(
            f"walker-{n}", f"leg_tracker/positive_{n}_extracted.bag", 7.5, moves=False, topic="/training_scan"
        )
        for n in (1, 3, 4)
    ),
    RealRecording("overtakes", "datmo/overtakes.bag", 12.5, pose_topic="/ego_pose", mounts=EGO),
    RealRecording("intersection", "datmo/intersection.bag", 12.5, pose_topic="/ego_pose", mounts=EGO),
    RealRecording("two_robots", "datmo/two_robots.bag", 12.5, pose_topic="/mocap_pose"),
    RealRecording("aces", "radish/aces.clf.bz2", 6.25),
    RealRecording("intel", "radish/intel.clf.bz2", 5),
    RealRecording("ual", "ual/ual.npz", 8, cell_m=0.2),
)


def npz_scans(path: Path) -> Iterator[Scan]:
    """The scans of an outdoor laser in an .npz file: t (s), r (m) over 180 degrees, and pose (x, y, heading)."""
    with np.load(path) as arrays:
        for t, r, pose in zip(*(arrays[name] for name in ("t", "r", "pose")), strict=True):
            ranges, step = np.asarray(r, np.float32), math.pi / (len(r) - 1)
            where = SE2(*pose.tolist())
            yield Scan(round(t * 1e9), ranges, -math.pi / 2, step, 0.1, NPZ_RANGE_MAX_M, world_T_sensor=where)


def import_real(recording: RealRecording, scans: Iterable[Scan], poses: PoseSource, data: Path, out: Path) -> Path:
    """Write `scans` of a recording with these poses as `gridtrack recording import` does; an existing `out` is kept."""
    if out.exists():
        return out
    described = {"source": Path(recording.path).name, "source_sha256": sha256_of(data / recording.path)}
    posed = scans
    if poses != "recorded":
        scans = list(scans)
        trajectory = matched_trajectory(scans, poses)
        described["poses"] = trajectory.describe(poses)
        print(f"{recording.name}: {described['poses']}", flush=True)
        posed = with_matched_poses(scans, trajectory)
    info = RecordingInfo(site=recording.name, grid=recording.grid, rate_hz=recording.rate_hz, **described)
    out.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(out) as file:
        write_native(file, info, posed, lambda: ())
    return out


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


def by_recording(scores: PlaceScores, heading: str, stratum: str, score: str) -> ResultTable:
    """A score MIDDLE_S ahead on each recording, and on all of them: a column each."""
    rows = [
        [label, *(scores.text(label, stratum, score, MIDDLE_S, name) for name in (*scores.described, ""))]
        for label in scores.labels
    ]
    return measured_table((f"{heading}, {MIDDLE_S:g} s", *scores.described, "all"), rows)


def sections_of(scores: PlaceScores) -> dict[str, ResultSection]:
    """The sections of the results file."""
    near_s = (0.5, 1.0)
    pooled = [
        (f"{title} {STRATA[stratum]}, {h:g} s", stratum, score, h)
        for title, score in (("PR-AUC", "pr_auc"), ("F1", "f1"))
        for stratum in ("in-motion", "dynamic")
        for h in near_s
    ]
    contacts = [(f"{STRATA[one]}, {h:g} s", one, CONTACTS, h) for one in ("dynamic", "in-motion") for h in near_s]
    tables = {
        "contacts": scores.table(CONTACTS_FORESEEN, contacts),
        "contacts by recording": by_recording(scores, CONTACTS_FORESEEN, "dynamic", CONTACTS),
        "PR-AUC by recording": by_recording(scores, "PR-AUC in motion", "in-motion", "pr_auc"),
        "pooled": scores.table("together", pooled),
        "visible": scores.over_horizons("F1, visible", "visible", "f1"),
        "recordings": contents(scores),
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
    parser.set_defaults(every="2s")
    parser.add_argument("--recording", action="append", help="such as aces; default: all of them")
    given = parser.parse_args(arguments)
    if not given.collect:
        recordings = [one for one in REAL if given.recording is None or one.name in given.recording]
        folder = given.out.with_name(f"{given.out.name}-recordings")
        compare_places(given, imported(recordings, given.data, folder), given.out)
    scores = PlaceScores.read(given.out)
    write_places(given.results, sections_of(scores), scores)


if __name__ == "__main__":
    main()
