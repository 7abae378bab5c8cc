"""ROS bags and ROS MCAP files are read as the scans that were written, damaged ones up to the damage."""

from __future__ import annotations

import math
import shutil
import sqlite3
import struct
import sys
from collections.abc import Callable, Iterable
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import zstandard
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from gridtrack.common.errors import RecordingError
from gridtrack.common.scan import MAX_RANGE_M, Scan
from gridtrack.recordings import CloudSlice, import_recording, open_recording, packaged_recording
from gridtrack.recordings.formats.ros1_bag import ROS1_MAGIC
from gridtrack.recordings.opening import recordings_at

from scenes.drive_bag import CLOUD, LASER, Message, Ros

ROS1, ROS2 = Ros(1), Ros(2)
STRING = "std_msgs/msg/String"


def ros1_mcap(path: Path, messages: Iterable[Message], before: Iterable[tuple[str, bytes]] = ()) -> Path:
    """A ROS 1 MCAP file; `before` are topics of JSON without a schema, each with a message."""
    with path.open("wb") as file:
        writer = McapWriter(file, chunk_size=1024)
        writer.start(profile="ros1")
        for topic, data in before:
            writer.add_message(writer.register_channel(topic, "json", 0), 0, data, 0)
        channels: dict[str, int] = {}
        for topic, kind, received_ns, message in messages:
            if topic not in channels:
                text, _ = ROS1.store.generate_msgdef(kind)
                schema = writer.register_schema(kind.replace("/msg/", "/"), "ros1msg", text.encode())
                channels[topic] = writer.register_channel(topic, "ros1", schema)
            data = bytes(ROS1.store.serialize_ros1(message, kind))
            writer.add_message(channels[topic], received_ns, data, received_ns)
        writer.finish()
    return path


@pytest.fixture
def scans(scan) -> list[Scan]:
    """Scans of two sensors with fields that are exact in the 32 bits of ROS."""
    made = []
    for k in range(20):
        for sensor, offset_ns in (("scan", 0), ("rear/scan", 40_000_000)):
            one = scan(k, sensor, offset_ns=offset_ns)
            names = ("angle_min", "angle_increment", "range_min", "range_max")
            exact = {name: float(np.float32(getattr(one, name))) for name in names}
            time_s = float(np.float32(1e-4)) if sensor == "scan" else 0.0
            made.append(replace(one, **exact, time_increment_s=time_s))
    return made


def messages_of(ros: Ros, scans: Iterable[Scan]) -> list[Message]:
    lasers = [(f"/{one.sensor}", LASER, one.stamp_ns + 10_000_000, ros.laser_scan(one)) for one in scans]
    chatter = ros.make(STRING, data="hello")
    return [m for one in lasers for m in (one, ("/chatter", STRING, one[2] + 1_000_000, chatter))]


def ros1_bag(folder: Path, scans: Iterable[Scan], compression: Writer1.CompressionFormat | None = None) -> Path:
    return ROS1.write(folder / "a.bag", messages_of(ROS1, scans), compression=compression, chunk_bytes=2048)


def ros2_bag(folder: Path, scans: Iterable[Scan], storage: StoragePlugin = StoragePlugin.SQLITE3) -> Path:
    return ROS2.write(folder / "a", messages_of(ROS2, scans), storage)


def unfinished(folder: Path, scans: Iterable[Scan]) -> Path:
    """A bag of a killed recorder: the second half of its messages in the side file, and no metadata."""
    (whole,) = ros2_bag(folder, scans).glob("*.db3")
    bag = folder / "killed"
    bag.mkdir()
    writing = shutil.copyfile(whole, folder / "writing.db3")
    with closing(sqlite3.connect(writing, isolation_level=None)) as database:
        rows = database.execute("SELECT * FROM messages ORDER BY timestamp").fetchall()
        late = rows[len(rows) // 2 :]
        database.execute("DELETE FROM messages WHERE timestamp >= ?", (min(row[2] for row in late),))
        database.execute("VACUUM")
        database.execute("PRAGMA journal_mode=WAL")
        database.execute("PRAGMA wal_autocheckpoint=0")
        database.executemany(f"INSERT INTO messages VALUES ({','.join('?' * len(rows[0]))})", late)
        for name in ("writing.db3", "writing.db3-wal"):
            shutil.copyfile(folder / name, bag / name.replace("writing", "killed_0"))
    return bag


def split_without_metadata(folder: Path, scans: Iterable[Scan]) -> Path:
    """Two files of one bag; their numbers sort otherwise than their names."""
    bag, every = folder / "split", list(scans)
    bag.mkdir()
    for number, part in ((2, every[:20]), (10, every[20:])):
        (folder / str(number)).mkdir()
        (file,) = ros2_bag(folder / str(number), part).glob("*.db3")
        file.rename(bag / f"split_{number}.db3")
    return bag


def packed_file(folder: Path, scans: Iterable[Scan], storage: StoragePlugin = StoragePlugin.SQLITE3) -> Path:
    (file,) = ros2_bag(folder, scans, storage).glob("a*")
    path = folder / f"a_0{file.suffix}.zstd"
    path.write_bytes(zstandard.compress(file.read_bytes()))
    return path


def folder_of_packed_mcap(folder: Path, scans: Iterable[Scan]) -> Path:
    """As `ros2 bag record --compression-mode file --storage mcap` writes it."""
    bag = ros2_bag(folder, scans, StoragePlugin.MCAP)
    (file,) = bag.glob("*.mcap")
    (bag / f"{file.name}.zstd").write_bytes(zstandard.compress(file.read_bytes()))
    file.unlink()
    return bag


def wrong_index(folder: Path, scans: Iterable[Scan]) -> Path:
    """A bag with sizes of indices that disagree with their entries."""
    path = ros1_bag(folder, scans)
    content, at = bytearray(path.read_bytes()), len(ROS1_MAGIC)
    while at < len(content):
        (header_bytes,) = struct.unpack_from("<I", content, at)
        data_at = at + 4 + header_bytes
        (data_bytes,) = struct.unpack_from("<I", content, data_at)
        if b"op=\x04" in content[at:data_at]:
            struct.pack_into("<I", content, data_at, data_bytes + 5)
        at = data_at + 4 + data_bytes
    path.write_bytes(content)
    return path


def packed_messages(folder: Path, scans: Iterable[Scan]) -> Path:
    bag = ROS2.write(folder / "a", messages_of(ROS2, scans), compression=CompressionMode.MESSAGE)
    return next(bag.glob("*.db3*"))


MAKERS: dict[str, Callable[[Path, list[Scan]], Path]] = {
    "ros1 bag": ros1_bag,
    "ros1 bag, bz2": lambda folder, scans: ros1_bag(folder, scans, Writer1.CompressionFormat.BZ2),
    "ros1 bag, lz4": lambda folder, scans: ros1_bag(folder, scans, Writer1.CompressionFormat.LZ4),
    "ros2 bag, sqlite": ros2_bag,
    "ros2 bag, one db3": lambda folder, scans: next(ros2_bag(folder, scans).glob("*.db3")),
    "ros2 bag, mcap": lambda folder, scans: ros2_bag(folder, scans, StoragePlugin.MCAP),
    "ros2 mcap": lambda folder, scans: next(ros2_bag(folder, scans, StoragePlugin.MCAP).glob("*.mcap")),
    "ros2 bag, packed messages, one db3": packed_messages,
    "ros2 bag, db3.zstd": packed_file,
    "ros2 mcap, mcap.zstd": lambda folder, scans: packed_file(folder, scans, StoragePlugin.MCAP),
    "ros2 bag, folder of mcap.zstd": folder_of_packed_mcap,
    "ros1 bag, wrong length of indices": wrong_index,
    "ros2 bag, side file of SQLite": unfinished,
    "ros2 bag, two db3 without metadata": split_without_metadata,
    "ros1 mcap": lambda folder, scans: ros1_mcap(folder / "a.mcap", messages_of(ROS1, scans)),
}


@pytest.mark.parametrize("kind", MAKERS)
def test_laser_scans_round_trip_all_and_of_one_topic(kind: str, tmp_path: Path, scans: list[Scan], same_scans) -> None:
    path = MAKERS[kind](tmp_path, scans)
    recording = open_recording(path)
    same_scans(recording.scans(), scans)
    assert recording.warnings == []
    assert recording.survey.topics["/chatter"] == (STRING, 40)
    same_scans(open_recording(path, topic="/rear/scan").scans(), [s for s in scans if s.sensor == "rear/scan"])
    with pytest.raises(RecordingError, match="no topic '/raer/scan'; did you mean '/rear/scan'"):
        list(open_recording(path, topic="/raer/scan").scans())
    with pytest.raises(RecordingError, match="'/chatter' is std_msgs/msg/String, not scans"):
        list(open_recording(path, topic="/chatter").scans())


def test_headers_without_a_stamp_get_the_time_of_reception_and_a_warning(tmp_path: Path, scans: list[Scan]) -> None:
    messages = [("/scan", LASER, 10**9 + k, ROS1.laser_scan(replace(s, stamp_ns=0))) for k, s in enumerate(scans[:3])]
    recording = open_recording(ROS1.write(tmp_path / "a.bag", messages))
    assert [s.stamp_ns for s in recording.scans()] == [10**9, 10**9 + 1, 10**9 + 2]
    assert len(recording.warnings) == 1
    assert "time of reception" in recording.warnings[0]


def test_many_equal_stamps_name_the_time_of_reception(tmp_path: Path, scans: list[Scan]) -> None:
    same = [
        ("/scan", LASER, 10**9 * (k + 1), ROS1.laser_scan(replace(s, stamp_ns=7))) for k, s in enumerate(scans[:20:2])
    ]
    path = ROS1.write(tmp_path / "a.bag", same)
    (warning,) = open_recording(path).overview().warnings
    assert (
        "90% of the stamps are alike or in disorder: take the times of reception, with `gridtrack recording import"
        in warning
    )
    assert [s.stamp_ns for s in open_recording(path, stamps="received").scans()] == [10**9 * (k + 1) for k in range(10)]
    with pytest.raises(RecordingError, match="messages have times of reception: use received"):
        open_recording(path, stamps="10hz")


def test_stamps_at_the_end_of_a_scan_are_moved_to_its_first_beam(tmp_path: Path, scans: list[Scan]) -> None:
    path = MAKERS["ros1 bag"](tmp_path, scans)
    sweep_ns = round(float(np.float32(1e-4)) * 35 * 1e9)
    found = open_recording(path, topic="/scan", stamps="end").scans()
    assert [s.stamp_ns for s in found] == [s.stamp_ns - sweep_ns for s in scans if s.sensor == "scan"]
    with pytest.raises(RecordingError, match="--stamps end: scans on /rear/scan have no time between beams"):
        list(open_recording(path, topic="/rear/scan", stamps="end").scans())


def test_stamps_in_bursts_are_a_warning_with_the_rate(tmp_path: Path, scans: list[Scan]) -> None:
    """A buffer that is read every half a second gives five scans nearly the same stamp."""
    stamps = [10**9 + 5 * 10**8 * (k // 5) + 2_000_000 * (k % 5) for k in range(40)]
    even = [10**9 + 10**8 * k for k in range(40)]
    for stamped, count in ((stamps, 1), (even, 0)):
        made = [replace(scans[0], stamp_ns=stamp) for stamp in stamped]
        received = [("/scan", LASER, 10**9 + 10**8 * k, ROS1.laser_scan(scan)) for k, scan in enumerate(made)]
        path = ROS1.write(tmp_path / f"{count}.bag", received)
        bursts = [line for line in open_recording(path).overview().warnings if "come in bursts" in line]
        assert len(bursts) == count
    reported = open_recording(tmp_path / "1.bag").overview().warnings[0]
    assert "half of them less than 2 ms after another" in reported
    assert "give --rate 11.1, or take the times of reception, with `gridtrack recording import" in reported


@pytest.mark.parametrize("increment_s", [-1e-4, 1.0, math.nan, math.inf])
def test_impossible_beam_times_are_unknown(tmp_path: Path, scans: list[Scan], increment_s: float) -> None:
    message = ROS1.laser_scan(replace(scans[0], time_increment_s=increment_s))
    (found,) = open_recording(ROS1.write(tmp_path / "a.bag", [("/scan", LASER, 10**9, message)])).scans()
    assert found.time_increment_s == 0.0


def test_the_error_for_a_bag_without_scans_lists_its_topics(tmp_path: Path) -> None:
    path = ROS1.write(tmp_path / "a.bag", [("/chatter", STRING, 5, ROS1.make(STRING, data="hello"))])
    with pytest.raises(RecordingError, match=r"no scans; topics: /chatter \(std_msgs/msg/String\)"):
        list(open_recording(path).scans())


@pytest.mark.parametrize("kind", ["ros1 bag", "ros1 bag, bz2", "ros1 mcap"])
def test_a_cut_file_gives_the_scans_before_the_cut(kind: str, tmp_path: Path, scans: list[Scan]) -> None:
    path = MAKERS[kind](tmp_path, scans)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) * 3 // 5])
    recording = open_recording(path)
    found = [s.stamp_ns for s in recording.scans()]
    assert found == [s.stamp_ns for s in scans][: len(found)]
    assert len(found) > len(scans) // 3
    assert len(recording.warnings) == 1
    assert "cut off" in recording.warnings[0]
    with pytest.raises(RecordingError, match="cut off"):
        list(open_recording(path, strict=True).scans())


def test_a_bag_cut_inside_a_chunk_gives_the_messages_before_the_cut(tmp_path: Path, scans: list[Scan]) -> None:
    path = ROS1.write(tmp_path / "a.bag", messages_of(ROS1, scans))
    content = path.read_bytes()
    path.write_bytes(content[: content.index(b"op=\x05") + 8000])
    recording = open_recording(path)
    found = [s.stamp_ns for s in recording.scans()]
    assert found == [s.stamp_ns for s in scans][: len(found)]
    assert len(found) > 10
    assert len(recording.warnings) == 1


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_an_mcap_file_cut_inside_its_only_chunk_gives_the_messages_before_the_cut(
    compression: str, tmp_path: Path, scans: list[Scan]
) -> None:
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = McapWriter(file, compression=CompressionType[compression.upper()])
        writer.start(profile="ros2")
        text, _ = ROS2.store.generate_msgdef(LASER)
        schema = writer.register_schema(LASER, "ros2msg", text.encode())
        channel = writer.register_channel("/scan", "cdr", schema)
        for one in scans * 20:
            random = np.random.default_rng(one.stamp_ns).uniform(0, 5, 36).astype(np.float32)
            data = bytes(ROS2.store.serialize_cdr(ROS2.laser_scan(replace(one, ranges=random)), LASER))
            writer.add_message(channel, one.stamp_ns, data, one.stamp_ns)
        writer.finish()
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    recording = open_recording(path)
    assert recording.survey.topics["/scan"][1] > 100
    assert any("cut off in the middle of a record; the rest is left out" in line for line in recording.warnings)
    with pytest.raises(RecordingError, match="cut off"):
        list(open_recording(path, strict=True).scans())


def test_a_packed_recording_of_gridtrack_is_named(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap.zstd"
    path.write_bytes(zstandard.compress(packaged_recording("leg_tracker").read_bytes()))
    with pytest.raises(RecordingError, match="a packed recording of gridtrack: unpack it with `zstd -d`"):
        list(open_recording(path).scans())


def test_a_bag_without_its_index_can_be_read(tmp_path: Path, scans: list[Scan], same_scans) -> None:
    path = MAKERS["ros1 bag"](tmp_path, scans)
    content = bytearray(path.read_bytes())
    at = content.index(b"index_pos=") + len(b"index_pos=")
    (index_pos,) = struct.unpack_from("<Q", content, at)
    content[at : at + 8] = bytes(8)
    path.write_bytes(content[:index_pos])
    same_scans(open_recording(path).scans(), scans)


def test_a_damaged_database_is_an_error_with_strict(tmp_path: Path, scans: list[Scan]) -> None:
    path = MAKERS["ros2 bag, one db3"](tmp_path, scans)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    with pytest.raises(RecordingError, match="damaged"):
        list(open_recording(path, strict=True).scans())


def test_a_height_slice_has_the_nearest_point_of_each_bearing(tmp_path: Path) -> None:
    points = np.array(
        [[2.0, 0.1, 0.5], [4.0, 0.2, 0.5], [1.0, 0.0, 1.5], [-0.1, 3.0, 0.6], [math.nan, 0.0, 0.5], [60.0, 0.1, 0.5]]
    )
    path = ROS2.write(tmp_path / "a", [("/points", CLOUD, 5, ROS2.point_cloud(points, 5))])
    cut = CloudSlice(low_m=0.0, high_m=1.0, beams=36)
    (scan,) = open_recording(path, topic="/points", cloud_slice=cut).scans()
    angles = scan.angle_min + scan.angle_increment * np.arange(36)
    returned = np.isfinite(scan.ranges)
    np.testing.assert_allclose(np.degrees(angles[returned]), [5.0, 95.0], atol=1e-6)
    np.testing.assert_allclose(scan.ranges[returned], [math.hypot(2.0, 0.1), math.hypot(0.1, 3.0)], rtol=1e-6)
    assert (scan.sensor, scan.stamp_ns, scan.range_max) == ("points", 5, 50.0)
    imported = import_recording(path, tmp_path / "cut.mcap", topic="/points", cloud_slice=cut)
    assert "--cloud-slice low_m=0,high_m=1,beams=36" in imported.info.command


def test_a_bearing_without_points_is_free_or_unknown(tmp_path: Path) -> None:
    path = ROS2.write(tmp_path / "a", [("/points", CLOUD, 5, ROS2.point_cloud(np.array([[2.0, 0.1, 0.5]]), 5))])
    seen = {}
    for empty in ("free", "unknown"):
        cut = CloudSlice(low_m=0.0, high_m=1.0, beams=36, range_max_m=6.0, empty=empty)
        (seen[empty],) = open_recording(path, topic="/points", cloud_slice=cut).scans()
    assert np.isposinf(seen["free"].ranges).sum() == np.isnan(seen["unknown"].ranges).sum() == 35
    assert seen["free"].range_max == 6.0
    imported = import_recording(path, tmp_path / "cut.mcap", topic="/points", cloud_slice=cut)
    assert "range_max_m=6,empty=unknown" in imported.info.command


def ring(beams: int, phase_rad: float, missing: int = 0) -> np.ndarray:
    """Points (N, 3) of a laser with `beams` in a revolution, on a circle of 3 m; some beams are missing."""
    angles = phase_rad + np.arange(beams)[missing:] * 2 * math.pi / beams
    return np.stack([3 * np.cos(angles), 3 * np.sin(angles), np.full(angles.size, 0.5)], axis=1)


TALL = np.random.default_rng(0).uniform(-2.0, 2.0, (99, 3))


@pytest.mark.parametrize(("beams", "phase_rad"), [(360, 0.0), (360, 0.004), (91, 0.01), (512, -math.pi)])
def test_a_scan_has_the_bearings_of_a_coarse_cloud(beams: int, phase_rad: float, tmp_path: Path) -> None:
    """Twice as many bearings would leave every other beam empty, and free through the walls."""
    messages = [
        ("/points", CLOUD, 10**8 * (k + 1), ROS2.point_cloud(ring(beams, phase_rad, 30 * k), 10**8 * (k + 1)))
        for k in range(3)
    ]
    path = ROS2.write(tmp_path / "a", messages)
    cut = CloudSlice(low_m=0.0, high_m=1.0)
    recording = open_recording(path, topic="/points", cloud_slice=cut)
    found = list(recording.scans())
    assert [np.isinf(scan.ranges).sum() for scan in found] == [0, 30, 60]
    assert {scan.ranges.size for scan in found} == {beams}
    first = found[0].angle_min
    assert -math.pi <= first < -math.pi + 2 * math.pi / beams + 1e-6
    np.testing.assert_allclose(math.remainder(first - phase_rad, 2 * math.pi / beams), 0.0, atol=1e-4)
    assert any(f"its clouds have {beams} bearings in a revolution" in line for line in recording.warnings)
    fine = CloudSlice(low_m=0.0, high_m=1.0, beams=720)
    assert {s.ranges.size for s in open_recording(path, topic="/points", cloud_slice=fine).scans()} == {720}


def test_a_dense_or_irregular_cloud_keeps_the_usual_bearings(tmp_path: Path) -> None:
    random = np.random.default_rng(3).uniform(-4, 4, (200, 3)) * [1, 1, 0.1] + [0, 0, 0.5]
    for name, points in (("dense", ring(1800, 0.0)), ("irregular", random)):
        path = ROS2.write(tmp_path / name, [("/points", CLOUD, 5, ROS2.point_cloud(points, 5))])
        (scan,) = open_recording(path, topic="/points", cloud_slice=CloudSlice(low_m=0.0, high_m=1.0)).scans()
        assert scan.ranges.size == 720


def test_the_first_echo_of_a_beam_is_read(tmp_path: Path, scans: list[Scan]) -> None:
    kind = "sensor_msgs/msg/MultiEchoLaserScan"
    one = ROS2.laser_scan(scans[0])
    echoes = [np.array([r, 9.0], np.float32) if np.isfinite(r) else np.empty(0, np.float32) for r in scans[0].ranges]
    fields = {name: getattr(one, name) for name in one.__dataclass_fields__ if not name.startswith("_")}
    ranges = [ROS2.make("sensor_msgs/msg/LaserEcho", echoes=echo) for echo in echoes]
    message = ROS2.make(kind, **{**fields, "ranges": ranges, "intensities": []})
    recording = open_recording(ROS2.write(tmp_path / "a", [("/echoes", kind, scans[0].stamp_ns, message)]))
    (scan,) = recording.scans()
    np.testing.assert_array_equal(scan.ranges, np.where(np.isfinite(scans[0].ranges), scans[0].ranges, np.inf))
    assert any("of several echoes of a beam the first is read" in line for line in recording.warnings)


@pytest.mark.parametrize("fields", [True, False])
def test_an_empty_cloud_is_a_scan_without_information(fields: bool, tmp_path: Path) -> None:
    """As written by a filter that passes no point; some drivers write no row_step."""
    whole = replace(ROS2.point_cloud(np.array([[2.0, 0.1, 0.5]]), 5), row_step=0)
    empty = replace(whole, width=0, data=np.empty(0, np.uint8), fields=whole.fields if fields else [])
    messages = [
        ("/points", CLOUD, at, replace(empty if k == 2 else whole, header=ROS2.stamped(at, "laser")))
        for k in range(5)
        for at in (10**8 * (k + 1),)
    ]
    cut = CloudSlice(low_m=0.0, high_m=1.0, beams=36)
    found = list(open_recording(ROS2.write(tmp_path / "a", messages), topic="/points", cloud_slice=cut).scans())
    assert len(found) == 5
    assert [bool(np.isnan(scan.ranges).all()) for scan in found] == [False, False, True, False, False]


def test_an_infinite_maximum_range_is_a_warning(tmp_path: Path, scans: list[Scan]) -> None:
    """`pointcloud_to_laserscan` writes the largest double by default, which is infinite in a message."""
    path = MAKERS["ros2 bag, sqlite"](tmp_path, [replace(scan, range_max=math.inf) for scan in scans])
    recording = open_recording(path)
    assert {scan.range_max for scan in recording.scans()} == {MAX_RANGE_M}
    assert any("with an infinite range_max, taken as 1e+06 m: 20 of them" in line for line in recording.warnings)


@pytest.mark.parametrize("factor", [0.0, 0.5, 2.0, 0.01, -1.0])
def test_a_header_that_contradicts_itself_is_refused_and_read_with_the_angles_given(
    factor: float, tmp_path: Path, scans: list[Scan]
) -> None:
    first = next(scan for scan in scans if scan.sensor == "scan")
    last = first.angle_min + first.angle_increment * (first.ranges.size - 1)
    wrong = [
        replace(s, angle_increment=factor * s.angle_increment, last_angle=last) for s in scans if s.sensor == "scan"
    ]
    path = MAKERS["ros1 bag"](tmp_path, wrong)
    with pytest.raises(RecordingError, match=r"contradicts itself: \d+ beams every .* deg from angle_min: .*--angles"):
        list(open_recording(path).scans())
    angles = f"{math.degrees(first.angle_min)}deg,{math.degrees(last)}deg"
    read = next(open_recording(path, angles=angles).scans())
    assert (read.angle_min, read.angle_increment) == pytest.approx((first.angle_min, first.angle_increment))


@pytest.mark.parametrize("beams", [-1, 1])
def test_a_driver_may_count_one_beam_more_or_less(beams: int, tmp_path: Path, scans: list[Scan]) -> None:
    ends = [s.angle_min + s.angle_increment * (s.ranges.size - 1 + beams) for s in scans]
    given = [replace(scan, last_angle=end) for scan, end in zip(scans, ends, strict=True)]
    path = MAKERS["ros1 bag"](tmp_path, given)
    assert open_recording(path, topic="/scan").overview().warnings == ()


@pytest.mark.parametrize("limits", [(0.0, 0.0), (10.0, 0.1), (math.nan, math.nan)])
def test_wrong_range_limits_are_refused_and_replaced(
    limits: tuple[float, float], tmp_path: Path, scans: list[Scan]
) -> None:
    path = MAKERS["ros1 bag"](tmp_path, [replace(s, range_min=limits[0], range_max=limits[1]) for s in scans])
    with pytest.raises(RecordingError, match="import the recording with those of the laser, --range-limits MIN,MAX"):
        list(open_recording(path).scans())
    assert {(s.range_min, s.range_max) for s in open_recording(path, range_limits="0.1,20").scans()} == {(0.1, 20.0)}


def test_reading_a_bag_with_a_side_file_changes_no_file(tmp_path: Path, scans: list[Scan]) -> None:
    bag = unfinished(tmp_path, scans)
    before = {file.name: file.read_bytes() for file in bag.iterdir()}
    assert len(list(open_recording(bag).scans())) == len(scans)
    assert {file.name: file.read_bytes() for file in bag.iterdir()} == before


def test_a_folder_of_single_databases_is_no_bag(tmp_path: Path, scans: list[Scan]) -> None:
    for name in ("one", "other"):
        (tmp_path / name).mkdir()
        (file,) = ros2_bag(tmp_path / name, scans).glob("*.db3")
        file.rename(tmp_path / f"{name}.db3")
        shutil.rmtree(tmp_path / name)
    assert recordings_at(tmp_path) == [tmp_path / "one.db3", tmp_path / "other.db3"]
    with pytest.raises(RecordingError, match="a folder, but not a recording"):
        open_recording(tmp_path)


@pytest.mark.parametrize("name", ["a.mcap", "out.mcap"])
def test_an_import_into_the_folder_of_its_source_is_refused(name: str, tmp_path: Path, scans: list[Scan]) -> None:
    """A bag of ROS 2 is a folder: its own file would be overwritten, and one more would be a part of the bag."""
    bag = MAKERS["ros2 bag, mcap"](tmp_path, scans)
    before = {path.name: path.read_bytes() for path in bag.iterdir()}
    with pytest.raises(RecordingError, match="is the source itself, or in its folder"):
        import_recording(bag, bag / name, topic="/scan")
    assert {path.name: path.read_bytes() for path in bag.iterdir()} == before


def test_a_channel_without_a_schema_is_ignored(tmp_path: Path, scans: list[Scan], same_scans) -> None:
    """MCAP allows schema 0 for JSON; a ROS file may have such a channel before its first scan."""
    path = tmp_path / "a.mcap"
    ros1_mcap(path, messages_of(ROS1, scans), before=[("/diagnostics", b"{}")])
    same_scans(open_recording(path).scans(), scans)


@pytest.mark.parametrize(
    ("points", "heights"), [(ring(90, 0.0), "low_m=0.4,high_m=0.6"), (TALL, "low_m=0.2,high_m=1.0")]
)
def test_a_recording_of_clouds_alone_gives_the_command_with_topic_and_heights(
    points: np.ndarray, heights: str, tmp_path: Path
) -> None:
    """The slice of a flat cloud contains it: an empty slice would be free everywhere."""
    path = ROS1.write(tmp_path / "a.bag", [("/points", CLOUD, 5, ROS1.point_cloud(points, 5))])
    command = f"a.bag --out a-one.mcap --topic /points --cloud-slice {heights}`"
    with pytest.raises(RecordingError, match=f"no laser scans: take them from a slice of the point cloud.*{command}"):
        list(open_recording(path).scans())
    with pytest.raises(RecordingError, match="point cloud: give its slice"):
        list(open_recording(path, topic="/points").scans())


def test_a_cloud_that_declares_more_points_than_it_has_is_refused(tmp_path: Path) -> None:
    message = replace(ROS1.point_cloud(np.ones((3, 3)), 5), width=1000)
    path = ROS1.write(tmp_path / "a.bag", [("/points", CLOUD, 5, message)])
    with pytest.raises(RecordingError, match="1 x 1000 points in 96 bytes"):
        list(open_recording(path, topic="/points", cloud_slice=CloudSlice(low_m=0, high_m=2)).scans())


def test_without_rosbags_the_extra_is_named(tmp_path: Path, scans: list[Scan], monkeypatch: pytest.MonkeyPatch) -> None:
    path = MAKERS["ros1 bag"](tmp_path, scans)
    monkeypatch.setitem(sys.modules, "rosbags.typesys", None)
    with pytest.raises(RecordingError, match=r"pip install 'gridtrack\[ros\]'"):
        open_recording(path)
