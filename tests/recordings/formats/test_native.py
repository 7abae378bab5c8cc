"""A native recording round-trips exactly, with its metadata, in messages that Foxglove reads."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from foxglove_schemas_protobuf.LaserScan_pb2 import LaserScan
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from gridtrack.common.errors import ConfigurationError, RecordingError
from gridtrack.common.geometry import SE2, same_pose
from gridtrack.common.scan import PoseQuality, Scan
from gridtrack.recordings import RecordingInfo, open_recording
from gridtrack.recordings.file_reading import DamageError
from gridtrack.recordings.native_messages import read_beam_times, read_pose_quality
from tests.recordings.conftest import copied


def test_scans_round_trip_bit_for_bit(write, scan, same_scans) -> None:
    """Ordinary ones, changing range limits, extreme values, one beam, no beam."""
    smallest, largest = np.finfo(np.float32).smallest_subnormal, np.finfo(np.float32).max
    extreme = np.array([np.inf, -np.inf, np.nan, 0.0, -0.0, smallest, largest, 1 / 3], np.float32)
    scans = [replace(scan(k), range_max=5.0 + k // 10) for k in range(50)]
    scans.append(replace(scan(50), ranges=extreme, angle_min=-1.5707963705062866, angle_increment=0.006135923322290182))
    scans += [replace(scan(51 + n), ranges=np.ones(n, np.float32), angle_increment=0.0) for n in (0, 1)]
    same_scans(open_recording(write(scans)).scans(), scans)


def test_sensors_are_merged_by_stamp_with_their_own_poses_and_labels(write, scan, same_scans) -> None:
    labels = np.arange(36, dtype=np.uint8) % 3
    labels[5] = 255
    scans = []
    for k in range(20):
        scans.append(replace(scan(k, "front", SE2(0.1 * k, -k, 0.3 * k - 3.0)), labels=labels if k % 4 == 0 else None))
        scans.append(scan(k, "rear/left", SE2(-1.0, 0.0, math.pi), offset_ns=3_000_001))
    path = write(scans, classes=["person", "car", "bike"])
    recording = open_recording(path)
    same_scans(recording.scans(), scans)
    assert recording.survey.moves
    assert {name: s.moved for name, s in recording.survey.sensors.items()} == {"front": True, "rear/left": False}
    assert {s.sensor for s in open_recording(path, topic="/scan/front").scans()} == {"front"}


def test_the_optional_parts_of_scans_round_trip(write, scan) -> None:
    """Reference poses, which a sensor has or lacks as a whole, beam times, and the quality of poses."""
    qualities = [None, PoseQuality("start"), PoseQuality("matched", 0.875, 0.0125), PoseQuality("few-returns")]
    scans = []
    for k, (time_s, quality) in enumerate(zip((1e-4, 1e-4, 2e-4, 0.0), qualities, strict=True)):
        parts = {"time_increment_s": time_s, "pose_quality": quality}
        drifts = scan(k, "front/left", SE2(0.1 * k, 0.0, 0.5))
        scans.append(replace(drifts, reference_T_sensor=SE2(0.11 * k, 7.0, -3.0), **parts))
        scans.append(replace(scan(k, "rear", SE2(-1.0, 0.0, 3.0), offset_ns=3_000_001), **parts))
    scans.append(scan(4, "front/left", SE2(0.7, 0.0, 0.5)))
    recording = open_recording(write(scans))
    topics = {name: recording.survey.topics[f"/{name}"][1] for name in ("reference_pose/front/left", "beam_times/rear")}
    assert topics == {"reference_pose/front/left": 5, "beam_times/rear": 3}
    assert recording.survey.topics["/pose_quality/rear"] == ("gridtrack.PoseQuality", 3)
    for found, expected in zip(recording.scans(), scans, strict=True):
        assert same_pose(found.world_T_sensor, expected.world_T_sensor)
        assert (found.time_increment_s, found.pose_quality) == (expected.time_increment_s, expected.pose_quality)
        assert (found.reference_T_sensor is None) == (expected.sensor == "rear")
        reference = expected.reference_T_sensor or expected.world_T_sensor
        assert expected.sensor == "rear" or same_pose(found.reference_T_sensor, reference)


@pytest.mark.parametrize(
    ("read", "message"),
    [
        (read_pose_quality, b"[1]"),
        (read_pose_quality, b"{}"),
        (read_pose_quality, b'{"outcome": "good", "inlier_share": 1, "residual_m": 0}'),
        (read_pose_quality, b"\xff" * 2000),
        (read_pose_quality, b'{"outcome": "matched", "inlier_share": NaN, "residual_m": 0}'),
        (read_beam_times, b'{"time_increment_s": -1}'),
        (read_beam_times, b'{"time_increment_s": "fast"}'),
        (read_beam_times, b""),
        (read_beam_times, b"[" * 900),
    ],
)
def test_a_damaged_quality_or_beam_time_is_damage(read: Callable[[bytes], object], message: bytes) -> None:
    with pytest.raises(DamageError, match="corrupt"):
        read(message)


def test_a_stretch_is_read_by_seconds_from_the_first_scan(write, scan) -> None:
    recording = open_recording(write(scan(k) for k in range(50)))
    stamps = [s.stamp_ns for s in recording.scans()]
    assert [s.stamp_ns for s in recording.scans(1.0, 2.0)] == stamps[10:20]
    assert [s.stamp_ns for s in recording.scans(start_s=4.5)] == stamps[45:]
    assert [s.stamp_ns for s in recording.scans(end_s=0.1)] == stamps[:1]


def test_foxglove_reads_standard_messages(write, scan) -> None:
    path = write([replace(scan(0, pose=SE2(1.0, 2.0, math.pi / 2)), labels=np.zeros(36, np.uint8))])
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        found = {m.channel.topic: (m.schema.name, m.decoded_message) for m in reader.iter_decoded_messages()}
    assert {topic: name for topic, (name, _) in found.items()} == {
        "/pose": "foxglove.FrameTransform",
        "/labels": "foxglove.LaserScan",
        "/scan": "foxglove.LaserScan",
    }
    message, transform = found["/scan"][1], found["/pose"][1]
    assert (transform.parent_frame_id, transform.child_frame_id) == ("world", message.frame_id)
    assert message.end_angle == pytest.approx(1.5)
    assert message.timestamp.seconds * 10**9 + message.timestamp.nanos == scan(0).stamp_ns
    assert transform.rotation.z == pytest.approx(math.sqrt(0.5))


def test_metadata_round_trip(write, scan) -> None:
    stretches = {"train": (0.0, 3.0), "test": (3.0, None)}
    path = write([scan(0)], site="hall", grid="100x0.1@-2,-4.5", rate_hz=10.0, stretches=stretches, classes=["car"])
    info = open_recording(path).info
    assert info == RecordingInfo(
        site="hall", grid="100x0.1@-2,-4.5", rate_hz=10.0, stretches=stretches, classes=("car",)
    )


@pytest.mark.parametrize(
    "values",
    [
        {},
        {"site": ""},
        {"site": "a", "grid": "big"},
        {"site": "a", "rate_hz": 0},
        {"site": "a", "rate_hz": 1e-300},
        {"site": "a", "grid": "100x0.2@1e300,0"},
        {"site": "a", "grid": f"{'9' * 5000}x0.2"},
        {"site": "a", "stretches": {"t": (5, 3)}},
    ],
)
def test_invalid_metadata_are_refused(values: dict[str, object]) -> None:
    with pytest.raises((ValueError, ConfigurationError)):
        RecordingInfo.model_validate(values)


def test_the_overview_describes_the_content(write, scan) -> None:
    path = write([scan(k) for k in range(50) if not 20 <= k < 30], site="hall")
    summary = open_recording(path).overview()
    sensor = summary.sensors["scan"]
    assert (sensor.scans, sensor.rate_hz, sensor.gaps, sensor.longest_gap_s) == (40, 10.0, 1, 1.1)
    assert (sensor.beams, sensor.range_min, sensor.range_max, sensor.moves) == ((36, 36), 0.05, 5.0, False)
    assert sensor.no_return_share == pytest.approx(1 / 36, abs=1e-4)
    assert sensor.invalid_share == pytest.approx(2 / 36, abs=1e-4)
    assert sensor.field_of_view_deg == pytest.approx(math.degrees(3.0), abs=0.01)
    assert summary.topics == {"/pose": "foxglove.FrameTransform, 1", "/scan": "foxglove.LaserScan, 40"}
    assert "40 scans, 10 Hz, jitter 0 ms, gaps: 1, the longest 1.1 s" in str(summary)
    assert type(summary).model_validate_json(summary.model_dump_json()) == summary


def test_the_rate_is_the_slowest_sensors_to_a_tenth(write, scan) -> None:
    front = [scan(k, "front", offset_ns=31_000 * (k % 3)) for k in range(40)]
    rear = [scan(k, "rear", offset_ns=1) for k in range(0, 40, 2)]
    merged = sorted(front + rear, key=lambda s: s.stamp_ns)
    assert open_recording(write(merged)).survey.rate_hz == 5.0


@pytest.mark.parametrize(
    ("topic", "message"),
    [
        ("/scan/frnt", "no topic '/scan/frnt'; did you mean '/scan/front'"),
        ("/pose", r"'/pose' is foxglove.FrameTransform, not scans; .*: /scan/front, /scan/rear"),
    ],
)
def test_the_error_for_a_wrong_topic_names_the_topics_in_one_line(write, scan, topic: str, message: str) -> None:
    path = write([scan(0, "front"), scan(1, "rear")])
    with pytest.raises(RecordingError, match=message):
        list(open_recording(path, topic=topic).scans())


def test_a_recording_without_scans_is_refused(write) -> None:
    with pytest.raises(RecordingError, match=r"made\.mcap: no scans; topics: none"):
        list(open_recording(write([])).scans())


def test_scans_with_decreasing_stamps_are_left_out_with_one_warning(write, scan) -> None:
    path = write(scan(k) for k in [0, 1, 3, 2, 4, 5, 7, 6, 8, 8, 9])
    recording = open_recording(path)
    for _ in range(2):
        assert [s.stamp_ns for s in recording.scans()] == [scan(k).stamp_ns for k in [0, 1, 3, 4, 5, 7, 8, 9]]
    assert len(recording.warnings) == 1
    assert "not stamped after the one before, left out: 3 of them, the first 0.200 s after" in recording.warnings[0]
    with pytest.raises(RecordingError, match="not stamped after the one before"):
        list(open_recording(path, strict=True).scans())


def test_sensors_written_late_are_merged_up_to_a_second(write, scan) -> None:
    def late(by: int) -> list[Scan]:
        front, rear = ([scan(k, sensor) for k in range(40)] for sensor in ("front", "rear"))
        return [s for pair in zip(front[by:], rear, strict=False) for s in pair] + rear[40 - by :]

    recording = open_recording(write(late(9)))
    stamps = [s.stamp_ns for s in recording.scans()]
    assert stamps == sorted(stamps)
    assert len(stamps) == 31 + 40
    assert recording.warnings == []
    recording = open_recording(write(late(15)))
    stamps = [s.stamp_ns for s in recording.scans()]
    assert stamps == sorted(stamps)
    assert "sensor 'rear' stamped more than a second before those of other sensors" in recording.warnings[0]


def test_a_changing_number_of_beams_is_a_warning(write, scan) -> None:
    recording = open_recording(write(scan(k, beams=30 + 6 * (k // 5)) for k in range(15)))
    assert len(list(recording.scans())) == 15
    assert "with another number of beams than the one before: 2 of them" in recording.warnings[0]
    assert recording.overview().sensors["scan"].beams == (30, 42)


@pytest.mark.parametrize("limits", [(3.0, 1.0), (-1.0, 2.0), (0.0, math.nan), (0.0, 1e300)])
def test_invalid_range_limits_are_refused(write, scan, limits: tuple[float, float]) -> None:
    path = write([replace(scan(0), range_min=limits[0], range_max=limits[1])])
    with pytest.raises(RecordingError, match="range limits"):
        list(open_recording(path).scans())


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"angle_min": -135.0}, r"beams from -135 rad .*; expected radians, and at most two turns"),
        ({"angle_increment": 1e300}, "every 1e[+]300 rad"),
        ({"angle_increment": math.nan}, "every nan rad"),
        ({"angle_min": math.inf}, "expected radians"),
        ({"angle_increment": 1e-6, "ranges": np.ones(100_001, np.float32)}, "100001 beams; at most 100000"),
    ],
)
def test_impossible_beams_are_an_error_in_the_first_scan_and_leave_out_a_later_one(
    write, scan, changes: dict[str, object], message: str
) -> None:
    with pytest.raises(RecordingError, match=message):
        list(open_recording(write([replace(scan(2), **changes)])).scans())
    recording = open_recording(write([scan(0), scan(1), replace(scan(2), **changes), scan(3)]))
    assert [s.stamp_ns for s in recording.scans()] == [scan(k).stamp_ns for k in (0, 1, 3)]
    assert "with impossible range limits, angles or number of beams, left out: 1 of them" in recording.warnings[0]


@pytest.mark.parametrize("pose", ["world_T_sensor", "reference_T_sensor"])
def test_an_infinite_pose_is_an_error_in_the_first_scan_and_leaves_out_a_later_one(write, scan, pose: str) -> None:
    nowhere = {pose: SE2(math.nan, 0.0, 0.0)}
    recording = open_recording(write([scan(0), replace(scan(1), **nowhere), scan(2)]))
    assert [s.stamp_ns for s in recording.scans()] == [scan(0).stamp_ns, scan(2).stamp_ns]
    assert "with a pose that is not finite, left out: 1 of them" in recording.warnings[0]
    with pytest.raises(RecordingError, match="a pose of nan, 0, 0; expected finite numbers"):
        list(open_recording(write([replace(scan(0), **nowhere)])).scans())


@pytest.mark.parametrize("label", [math.nan, math.inf, -1.0, 2.5, 256.0, 1e300])
def test_a_label_that_is_not_the_number_of_a_class_is_damage(write, scan, label: float) -> None:
    labelled = [replace(scan(k), labels=np.zeros(36, np.uint8)) for k in range(3)]
    path = altered(write(labelled, classes=["person"]), "/labels", 1, {"intensities": label})
    recording = open_recording(path)
    assert [s.stamp_ns for s in recording.scans()] == [scan(0).stamp_ns]
    assert f"a label {label:g} is not the number of a class" in recording.warnings[0]


def test_a_range_beyond_float32_is_no_return(write, scan) -> None:
    path = altered(write([scan(0)]), "/scan", 0, {"ranges": 1e300})
    (found,) = open_recording(path).scans()
    assert found.ranges[0] == np.inf
    np.testing.assert_array_equal(found.ranges[1:], scan(0).ranges[1:])


def altered(path: Path, topic: str, number: int, values: dict[str, float]) -> Path:
    """A copy of a recording; message `number` of `topic` has these values first in its fields."""

    def change(own_topic: str, own_number: int, data: bytes) -> bytes:
        if (own_topic, own_number) != (topic, number):
            return data
        decoded = LaserScan.FromString(data)
        for name, value in values.items():
            getattr(decoded, name)[0] = value
        return bytes(decoded.SerializeToString())

    return copied(path, path.with_name("altered.mcap"), change)
