"""The readers of recordings of each format, and of labels."""

from __future__ import annotations

import bz2
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
from rosbags.rosbag2 import StoragePlugin

from fuzz.containers import damage_parquet, damage_sqlite, damaged_bag, damaged_mcap
from fuzz.damage import Choices, damaged_bytes, damaged_text, one_of
from fuzz.reader import CLASSES, GRID, Reader, on_file
from gridtrack.common.errors import RecordingError
from gridtrack.common.geometry import SE2
from gridtrack.common.scan import PoseQuality, Scan
from gridtrack.common.scene import Scene, SceneObject
from gridtrack.recordings import RecordingInfo, import_recording, open_recording, write_native
from gridtrack.recordings.frames.transform import SE3
from gridtrack.recordings.outputs.conversion import write_outputs
from gridtrack.recordings.stream import open_stream
from gridtrack.simulation.laser import Laser
from gridtrack.simulation.tracks import ONLY_LASER, Tracks, TracksInfo
from gridtrack.simulation.tracks_file import METADATA_KEY, write_tracks

from scenes.drive_bag import FRONT, REAR, Ros, mounts, odometry_transforms, scans_of
from scenes.output_bag import Outputs, standing_scans

SCANS, BEAMS, FRAMES_READ = 6, 24, 3
BOX = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], np.float32)


def scans() -> Iterator[Scan]:
    """A few scans with everything that a native recording can hold."""
    for k in range(SCANS):
        ranges = np.random.default_rng(k).uniform(0.5, 4.5, BEAMS).astype(np.float32)
        scene = Scene((BOX,), 1, (SceneObject(7, 0, SE2(2.0, 0.1 * k), BOX),))
        yield Scan(
            1_000_000_000_000 + k * 100_000_000,
            ranges,
            -1.5,
            0.1,
            0.05,
            5.0,
            world_T_sensor=SE2(0.1 * k, 0.0, 0.01 * k),
            reference_T_sensor=SE2(0.1 * k, 0.01, 0.0),
            labels=np.full(BEAMS, k % 2, np.uint8),
            scene=scene,
            time_increment_s=1e-4,
            pose_quality=PoseQuality("matched", 0.9, 0.01),
        )


def native(folder: Path) -> Path:
    path = folder / "a.mcap"
    with path.open("wb") as file:
        info = RecordingInfo(site="here", classes=CLASSES, grid=str(GRID), rate_hz=10.0, stretches={"test": (0.0, 0.4)})
        write_native(file, info, scans())
    return path


def read_recording(path: Path) -> str:
    """Every scan, the overview, the first frames, and a native copy."""
    recording = open_recording(path)
    count = sum(1 for _ in recording.scans())
    reported = [*recording.warnings, *str(open_recording(path).overview()).split("\n")]
    assert all(line.isprintable() for line in reported), reported
    frames = sum(1 for _ in islice(open_stream(path, grid=GRID), FRAMES_READ))
    import_recording(path, path.parent / "imported.mcap")
    return f"{count} scans, {frames} frames, {len(recording.warnings)} warnings"


def ros_bag(version: int, name: str, storage: StoragePlugin = StoragePlugin.SQLITE3) -> Callable[[Path], object]:
    def make(folder: Path) -> Path:
        ros = Ros(version)
        body = ("base_footprint", "base_link", SE3())
        still = ros.transforms(0, body, *mounts(FRONT, REAR), topic="/tf_static")
        moving = list(odometry_transforms(ros, 300))
        return ros.write(folder / name, [still, *moving, *scans_of(ros, 300, FRONT, REAR)], storage)

    return make


def damage_ros2(choices: Choices, folder: Path) -> None:
    if choices.below(4):
        damage_sqlite(choices, one_of(choices, list(folder.glob("bag/*.db3"))))
    else:
        on_file("bag/metadata.yaml", damaged_text)(choices, folder)


def carmen(name: str) -> Callable[[Path], object]:
    lines = ["# a log", "PARAM robot nohost 0"]
    for k in range(SCANS):
        lines.append(f"FLASER 4 1.5 2.5 3.5 81.83 {k} 1 0.5 9 9 9 {100 + k}.25 host {k}.0")
        lines.append(
            f"ROBOTLASER1 0 -0.3 0.6 0.2 30.0 0.01 0 4 1 2 3 4 1 7 1 {k} 0 9 9 9 0 0 0 0 1e6 {100 + k}.5 host {k}.0"
        )
    text = ("\n".join(lines) + "\n").encode()
    return lambda folder: (folder / name).write_bytes(bz2.compress(text) if name.endswith("bz2") else text)


def damaged_bz2(choices: Choices, content: bytes) -> bytes:
    if choices.below(4):
        return bz2.compress(damaged_text(choices, bz2.decompress(content)))
    return damaged_bytes(choices, content)


def tracks(folder: Path) -> None:
    laser = Laser(angle_min=-np.pi, angle_increment=np.radians(15.0), beams=BEAMS)
    info = TracksInfo(
        recording=RecordingInfo(site="yard", classes=CLASSES, grid=str(GRID), rate_hz=8.0),
        lasers={ONLY_LASER: laser},
        frames=SCANS,
        rate_hz=8.0,
        static=(((2.0, 2.0), (3.0, 2.0), (3.0, 3.0)),),
        static_class="wall",
    )
    zeros, frame = np.zeros(SCANS, np.int64), np.arange(SCANS)
    pose = np.column_stack([frame / 8.0, np.full(SCANS, 3.0), np.zeros(SCANS)])
    with (folder / "a.tracks").open("wb") as file:
        write_tracks(file, Tracks(info, frame, zeros, zeros, pose, np.full((SCANS, 2), 0.5)))


def labels(folder: Path) -> None:
    with (folder / "a.mcap").open("wb") as file:
        write_native(file, RecordingInfo(site="here"), (replace(scan, labels=None, scene=None) for scan in scans()))
    rows = [f"{scan.stamp_ns},{beam},person,scan" for scan in scans() for beam in (0, 5)]
    (folder / "labels.csv").write_text("\n".join(["stamp_ns,beam,class,sensor", *rows]) + "\n")


def read_labels(folder: Path) -> str:
    import_recording(folder / "a.mcap", folder / "labelled.mcap", labels=folder / "labels.csv")
    return "labelled"


def outputs(folder: Path) -> None:
    out = Outputs(Ros(2))
    car = out.car(SE2(1.0, 2.0, 0.5), (1.0, 0.0), paths=((0.5, [SE2(), SE2(1.0)]), (0.2, [SE2(), SE2(0.0, 1.0)])))
    messages = [
        *standing_scans(out.ros, 300),
        out.grid("/pred", 100, np.array([[0, 50, -1], [100, 3, 4]]), SE2(0.5, 0.0, 0.3)),
        out.grid_map(100, np.full((3, 4), 0.5, np.float32), (1, 2), SE2()),
        out.objects(100, car, car),
    ]
    out.ros.write(folder / "bag", messages, StoragePlugin.MCAP)


def read_outputs(folder: Path) -> str:
    """Each of the outputs, even if the one before it was refused."""
    errors, words = [], []
    for given in ({"grid": ("/pred=0.5s",)}, {"grid": ("/map:p=0.5s",)}, {"objects": "/objects", "horizon_s": 0.3}):
        try:
            forecasts, _ = write_outputs(folder / "bag", folder / "a.npz", overwrite=True, **given)
            words.append(str(np.nansum(forecasts.occupancy(0, 0))))
        except RecordingError as error:
            errors.append(error)
    if errors:
        raise errors[0]
    return " ".join(words)


def object_table(folder: Path) -> None:
    native(folder)
    rows = [f"{scan.stamp_ns},a,{k},1,0,1,0,4,2,0.9,car,,," for k, scan in enumerate(scans())]
    rows += [f"{1_000_000_000_000},a,{k},2,0,,,,,,,{k / 10},p,0.5" for k in (1, 2, 3)]
    header = "stamp_ns,track,x,y,yaw,vx,vy,length,width,existence,label,lead_s,path,probability"
    (folder / "objects.csv").write_text("\n".join([header, *rows]) + "\n")


def read_object_table(folder: Path) -> str:
    forecasts, _ = write_outputs(
        folder / "a.mcap", folder / "a.npz", objects=str(folder / "objects.csv"), horizon_s=0.3
    )
    return f"{len(forecasts)} forecasts"


READERS: dict[str, Reader] = {
    "native MCAP": Reader(native, on_file("a.mcap", damaged_mcap), lambda f: read_recording(f / "a.mcap")),
    "native MCAP, raw": Reader(native, on_file("a.mcap", damaged_bytes), lambda f: read_recording(f / "a.mcap")),
    "ROS MCAP": Reader(
        ros_bag(2, "bag", StoragePlugin.MCAP), on_file("bag/*.mcap", damaged_mcap), lambda f: read_recording(f / "bag")
    ),
    "ROS 1 bag": Reader(ros_bag(1, "a.bag"), on_file("a.bag", damaged_bag), lambda f: read_recording(f / "a.bag")),
    "ROS 2 bag": Reader(ros_bag(2, "bag"), damage_ros2, lambda f: read_recording(f / "bag")),
    "CARMEN log": Reader(carmen("a.clf"), on_file("a.clf", damaged_text), lambda f: read_recording(f / "a.clf")),
    "CARMEN log, bzip2": Reader(
        carmen("a.clf.bz2"), on_file("a.clf.bz2", damaged_bz2), lambda f: read_recording(f / "a.clf.bz2")
    ),
    "tracks": Reader(
        tracks,
        lambda choices, folder: damage_parquet(choices, folder / "a.tracks", METADATA_KEY),
        lambda f: read_recording(f / "a.tracks"),
    ),
    "outputs": Reader(outputs, on_file("bag/*.mcap", damaged_mcap), read_outputs),
    "object table": Reader(object_table, on_file("objects.csv", damaged_text), read_object_table),
    "labels": Reader(labels, on_file("labels.csv", damaged_text), read_labels),
}
