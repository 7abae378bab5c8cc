"""The files that the commands of the pages need: recordings under the names that the pages use."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable, Iterator
from functools import partial
from itertools import takewhile
from pathlib import Path

import numpy as np
from rosbags.rosbag2 import StoragePlugin

from gridtrack.common.geometry import SE2
from gridtrack.common.scan import Scan
from gridtrack.recordings import open_recording, packaged_recording, write_native

from docs.pages import ROOT
from scenes import drive_bag as drive
from scenes.drive_bag import MS, START_NS, Laser, Message, Ros
from scenes.output_bag import Outputs, standing_scans
from scenes.own_forecasts import own_forecasts
from studies.support.plugins import write_distribution

ROS1 = Ros(1)
DRIVE_MS = 8000
FRONT = Laser("front_laser", SE2(0.4, 0.2, 0.8))
REAR = Laser("rear_laser", SE2(-0.4, 0.0, 3.1), mirrored=True, offset_ms=40)
LASER = Laser("laser", SE2(-0.14, 0.0, 0.0))
JUNCTION = {
    "test-101.tracks": ("test-101.tracks", 7.0),
    "validation.tracks": ("test-102.tracks", 6.0),
    "train.tracks": ("test-103.tracks", 12.0),
}
"""Recordings of the junction: the beginnings of these files."""


def hall_scans(seconds: float) -> Iterator[Scan]:
    """The first scans of the recording that ships."""
    scans = open_recording(packaged_recording("leg_tracker")).scans()
    first = next(scans)
    yield first
    yield from takewhile(lambda scan: scan.stamp_ns < first.stamp_ns + 1e9 * seconds, scans)


def hall_bag(path: Path, seconds: float = 30.0) -> None:
    """A ROS 1 bag of a laser that stands in a hall."""

    def messages() -> Iterator[Message]:
        for scan in hall_scans(seconds):
            laser = Laser("hall", SE2(0.0, 0.0, 0.0), False, scan.ranges.size, scan.angle_min, scan.angle_increment)
            yield ROS1.laser((scan.stamp_ns - START_NS) / MS, scan.ranges, laser)

    ROS1.write(path, messages())


def recorded_drive(folder: Path) -> None:
    """`drive/drive_0.mcap`, as `ros2 bag record --storage mcap` leaves it."""
    ros = Ros(2)
    ros.write(folder / "drive", drive.two_scanner_drive(ros, DRIVE_MS), StoragePlugin.MCAP)
    (written,) = (folder / "drive").glob("*.mcap")
    written.rename(folder / "drive" / "drive_0.mcap")


def drive_bag(path: Path, *lasers: Laser, pose_of: Callable[[float, SE2], Message] | None = None) -> None:
    """A ROS 1 bag of a drive; where the lasers are on the robot is not recorded.

    `pose_of`: the message of the pose of the robot at a time in milliseconds.
    """

    def messages() -> Iterator[Message]:
        for at_ms in range(0, DRIVE_MS, 20) if pose_of else ():
            yield pose_of(at_ms, drive.robot_at(at_ms))
        for at_ms in range(0, DRIVE_MS, 100):
            for laser in lasers:
                stamp_ms = at_ms + laser.offset_ms
                ranges = drive.ranges_at(laser, drive.robot_at(stamp_ms), (-5.0 + stamp_ms / 1000.0, 3.0))
                yield ROS1.laser(stamp_ms, ranges, laser, frame=laser.name)

    ROS1.write(path, messages())


def carmen_log(path: Path) -> None:
    """A CARMEN log of a drive: a laser of 181 beams, and the odometry of the robot."""
    laser = Laser("laser", SE2(0.0, 0.0, 0.0), angle_min=-np.pi / 2, angle_increment=np.pi / 180)
    lines = []
    for at_ms in range(0, DRIVE_MS, 100):
        pose = drive.robot_at(at_ms)
        ranges = " ".join(f"{r:.3f}" for r in drive.ranges_at(laser, pose, (0.0, 3.0)))
        x, y, theta = pose.x, pose.y, pose.theta
        stamp = 100 + at_ms / 1000
        lines.append(
            f"FLASER 181 {ranges} {x:.4f} {y:.4f} {theta:.5f} {x:.4f} {y:.4f} {theta:.5f} {stamp} host {stamp}"
        )
    path.write_text("\n".join(lines) + "\n")


def cloud_bag(path: Path) -> None:
    """The hall, as the topic `/points` of a lidar with several rings."""
    ROS1.write(path, [ROS1.cloud((scan.stamp_ns - START_NS) / MS, _points(scan)) for scan in hall_scans(5.0)])


def _points(scan: Scan) -> np.ndarray:
    """The returns of a scan at three heights, (N, 3)."""
    at = scan.angle_min + scan.angle_increment * np.arange(scan.ranges.size)
    returned = np.isfinite(scan.ranges)
    flat = np.stack([np.cos(at), np.sin(at)], axis=1)[returned] * scan.ranges[returned, None]
    return np.concatenate([np.column_stack([flat, np.full(len(flat), z)]) for z in (0.0, 0.5, 1.5)])


def data(folder: Path, *, own_weights: bool = False) -> None:
    """`data` of a clone, with the recordings JUNCTION; `own_weights` may be written to."""
    (folder / "data" / "junction").mkdir(parents=True)
    for name, (source, seconds) in JUNCTION.items():
        part(ROOT / "data" / "junction" / source, folder / "data" / "junction" / name, 0.0, seconds)
    (folder / "data" / "leg_tracker").symlink_to(ROOT / "data" / "leg_tracker")
    if own_weights:
        shutil.copytree(ROOT / "data" / "weights", folder / "data" / "weights")
    else:
        (folder / "data" / "weights").symlink_to(ROOT / "data" / "weights")


def part(source: Path, path: Path, start_s: float, end_s: float) -> None:
    """Write a stretch of a recording as a native recording."""
    recording = open_recording(source)
    with path.open("wb") as file:
        write_native(file, recording.info.model_copy(update={"stretches": {}}), recording.scans(start_s, end_s))


def hall_recordings(folder: Path, *names: str) -> None:
    """Native recordings of ten seconds of the hall each, one after the other, none of them in `hall_bag`."""
    for k, name in enumerate(names):
        (folder / name).parent.mkdir(exist_ok=True)
        part(packaged_recording("leg_tracker"), folder / name, 40.0 + 10.0 * k, 50.0 + 10.0 * k)


def annotations(path: Path) -> None:
    """Two annotated walkers, in the format of the Stanford Drone Dataset."""
    rows = [
        f'{track} {300 + 6 * frame} {y} {320 + 6 * frame} {y + 20} {frame} 0 0 0 "Pedestrian"'
        for track, y in ((0, 300), (1, 500))
        for frame in range(300)
    ]
    path.write_text("\n".join(rows) + "\n")


def hall(folder: Path) -> None:
    data(folder)
    hall_bag(folder / "my.bag")
    own_forecasts(folder / "mine.npz", folder / "my.bag")
    recorded_drive(folder)


def formats(folder: Path) -> None:
    drive_bag(folder / "drive.bag", FRONT, REAR, pose_of=ROS1.odometry)
    drive_bag(folder / "poses.bag", LASER, pose_of=partial(ROS1.pose, topic="/ego_pose"))
    drive_bag(folder / "no-poses.bag", LASER)
    carmen_log(folder / "log.clf")
    hall_bag(folder / "hall.bag", 5.0)
    cloud_bag(folder / "clouds.bag")
    annotations(folder / "annotations.txt")
    hall_bag(folder / "demo_stationary_simple_environment.bag")


def own_tracker(folder: Path) -> None:
    data(folder)
    hall_bag(folder / "my.bag", 14.0)
    hall_recordings(folder, "train.mcap", "validation.mcap", "test-1.mcap")
    example = ROOT / "examples"
    for name in ("Makefile", "fading_tracker.cpp"):
        shutil.copyfile(example / "cpp_tracker" / name, folder / name)
    subprocess.run(["make", "--silent"], cwd=folder, check=True)
    module = example / "example_tracker" / "example_tracker.py"
    points, files = {"fading": "example_tracker:FadingTracker"}, {module.name: module.read_text("utf-8")}
    (folder / "site").mkdir()
    write_distribution(folder / "site", "example-tracker", points, files, group="gridtrack.trackers")


def training(folder: Path) -> None:
    data(folder, own_weights=True)
    hall_bag(folder / "my.bag", 14.0)
    hall_recordings(folder, "places/one.mcap", "places/two.mcap", "other_places/hall.mcap")


def outputs(folder: Path) -> None:
    ros = Ros(2)
    out = Outputs(ros)
    grids = [out.grid(topic, 1000, np.zeros((3, 4)), SE2()) for topic in ("/pred_05", "/pred_10")]
    tracks = ("/tracks", *out.objects(1000, out.car(SE2(3.0, 1.0), (1.0, 0.0)))[1:])
    ros.write(folder / "my.bag", [*standing_scans(ros), *grids, tracks])


PLACES: dict[str, Callable[[Path], None]] = {
    "hall": hall,
    "formats": formats,
    "own tracker": own_tracker,
    "training": training,
    "outputs": outputs,
    "simulation": lambda _: None,
}
"""The files that the commands of a theme need, by theme."""
