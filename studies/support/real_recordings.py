"""Recordings of real robots: how each is read, and its import as a native recording.

They do not ship: DATA is a folder with leg_tracker, datmo, radish and ual (docs/results/real).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gridtrack.common.files import atomic_write, sha256_of
from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridSpec
from gridtrack.common.scan import Scan
from gridtrack.recordings import open_recording
from gridtrack.recordings.ego_motion import MatchingSettings, matched_trajectory, with_matched_poses
from gridtrack.recordings.formats.native import write_native
from gridtrack.recordings.read_options import Mount, PoseSource, parse_mount
from gridtrack.recordings.recording_info import RecordingInfo

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
        trajectory = matched_trajectory(scans, poses, MatchingSettings())
        described["poses"] = trajectory.describe(poses)
        print(f"{recording.name}: {described['poses']}", flush=True)
        posed = with_matched_poses(scans, trajectory)
    info = RecordingInfo(site=recording.name, grid=recording.grid, rate_hz=recording.rate_hz, **described)
    out.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(out) as file:
        write_native(file, info, posed, lambda: ())
    return out
