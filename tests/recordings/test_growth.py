"""Recordings that are read while they are written, by a writer that its reader drives."""

from __future__ import annotations

import contextlib
from pathlib import Path

import pytest
from rosbags.rosbag2 import StoragePlugin

from gridtrack.common.errors import RecordingError
from gridtrack.common.geometry import SE2
from gridtrack.recordings import open_recording
from gridtrack.recordings.file_reading import Growth
from gridtrack.recordings.formats import native
from gridtrack.recordings.mcap_file import MCAP_MAGIC, McapFile
from gridtrack.recordings.recording import NoScansError
from gridtrack.recordings.stream import GridStream
from tests.recordings.conftest import copied, digests

from scenes import drive_bag as made


class Written:
    """A file that grows by a piece of a finished one whenever its reader waits for more."""

    def __init__(self, finished: Path, path: Path, first: int, piece: int) -> None:
        self.content, self.path, self.piece, self.at = finished.read_bytes(), path, piece, 0
        path.write_bytes(b"")
        self._append(first)

    def more(self) -> bool:
        return self._append(self.piece)

    def _append(self, size: int) -> bool:
        part = self.content[self.at : self.at + size]
        with self.path.open("ab") as file:
            file.write(part)
        self.at += len(part)
        return bool(part)


def in_small_chunks(path: Path, out: Path) -> Path:
    """The messages of an MCAP file in chunks of a fraction of a second, as a recorder flushes them."""
    return copied(path, out, lambda topic, number, data: data, chunk_bytes=4000)


def arriving(written: Written, first_s: float) -> tuple[GridStream, list[bytes]]:
    """The stream of a recording that is opened when it has `first_s`, and the digests of its frames as they arrive."""
    while True:
        growth = Growth()
        recording = open_recording(written.path, growth=growth)
        with contextlib.suppress(NoScansError):
            if recording.survey.duration_s >= first_s:
                break
        assert written.more()
    assert not recording.damage
    growth.sensors = frozenset(recording.survey.sensors)
    stream = GridStream(recording, grid=None)
    growth.more = written.more
    found = digests(observation.frame for observation in stream.arriving())
    growth.more = Growth().more
    assert not recording.damage
    return stream, found


@pytest.fixture
def drive(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A ROS 2 MCAP file of a robot with two scanners that drives after three seconds."""
    robot_at = made.robot_at
    monkeypatch.setattr(made, "robot_at", lambda at_ms: robot_at(max(0.0, at_ms - 3000.0)))
    ros = made.Ros(2)
    (path,) = ros.write(tmp_path / "drive", made.two_scanner_drive(ros, 5000), StoragePlugin.MCAP).glob("*.mcap")
    return in_small_chunks(path, tmp_path / "finished.mcap")


@pytest.mark.parametrize("piece", [1999, 12_000])
def test_a_robot_that_starts_to_drive_has_the_finished_files_frames(drive: Path, tmp_path: Path, piece: int) -> None:
    written = Written(drive, tmp_path / "drive.mcap", 20_000, piece)
    stream, found = arriving(written, 2.0)
    assert not stream.recording.survey.moves
    finished = GridStream(open_recording(drive), rate_hz=1e9 / stream.period_ns)
    assert finished.recording.survey.moves
    assert found == digests(finished)
    stream.recording.survey_again()
    assert stream.recording.sha256 == finished.recording.sha256
    assert stream.recording.info.poses.split(";")[0] == finished.recording.info.poses.split(";")[0]


def test_transforms_that_come_later_are_a_warning(tmp_path: Path) -> None:
    ros = made.Ros(2)
    messages = made.two_scanner_drive(ros, 5000)
    late = [m for m in messages if m[0] != "/tf" or m[2] > made.START_NS + 4 * 10**9]
    (path,) = ros.write(tmp_path / "drive", late, StoragePlugin.MCAP).glob("*.mcap")
    path = in_small_chunks(path, tmp_path / "finished.mcap")
    stream, found = arriving(Written(path, tmp_path / "drive.mcap", 20_000, 10_000), 2.0)
    recording = stream.recording
    recording.survey_again()
    assert "sensor 'front_scan': its transforms in the whole file are odom -> " in recording.warnings[0]
    assert "used those at the beginning of the file, base_footprint -> base_link -> " in recording.warnings[0]
    assert found == digests(GridStream(recording, rate_hz=1e9 / stream.period_ns))


def test_native_frames_come_when_their_scans_are_written(
    write, scan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(native, "CHUNK_BYTES", 2000)
    finished = write(scan(k) for k in range(60))
    written = Written(finished, tmp_path / "growing.mcap", len(MCAP_MAGIC) + 1500, 150)
    while next(McapFile(written.path, Growth()).messages(), None) is None:
        assert written.more()
    stream, found = arriving(written, 3.0)
    assert found == digests(GridStream(open_recording(finished), rate_hz=1e9 / stream.period_ns))


def test_the_present_content_is_no_damage_and_a_limit_ends_the_file(write, scan, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(native, "CHUNK_BYTES", 2000)
    finished = write(scan(k) for k in range(100))
    content = finished.read_bytes()
    part = tmp_path / "part.mcap"
    part.write_bytes(content[: len(content) // 2])
    growing = open_recording(part, growth=Growth())
    assert 0 < len(list(growing.scans())) < 100
    assert (growing.damage, growing.warnings) == ("", [])
    assert open_recording(part).survey.duration_s == growing.survey.duration_s
    limited = open_recording(finished, growth=Growth(limit=len(content) // 2))
    assert limited.survey.duration_s == growing.survey.duration_s
    assert limited.sha256 == growing.sha256 == open_recording(part).sha256


def test_corrupt_content_is_damage_while_it_grows(write, scan) -> None:
    path = write(scan(k) for k in range(50))
    content = bytearray(path.read_bytes())
    content[len(content) // 3] ^= 0xFF
    path.write_bytes(content)
    recording = open_recording(path, growth=Growth())
    with pytest.raises(RecordingError, match="no scans before the damage"):
        list(recording.scans())


def test_a_sensor_that_comes_later_is_left_out_with_a_warning(write, scan) -> None:
    late = (scan(k, "late", SE2(1.0, 0.0, 0.0)) for k in range(30, 60))
    path = write([*(scan(k) for k in range(60)), *late])
    recording = open_recording(path, growth=Growth(sensors=frozenset({"scan"})))
    assert {one.sensor for one in recording.scans()} == {"scan"}
    (warning,) = recording.warnings
    assert "sensor 'late' has its first scan after the comparison began: it is left out" in warning


def test_formats_that_cannot_grow_are_refused_with_advice(drive: Path, tmp_path: Path) -> None:
    ros = made.Ros(1)
    bag = ros.write(tmp_path / "old.bag", made.two_scanner_drive(ros, 500))
    database = made.Ros(2).write(tmp_path / "db", made.two_scanner_drive(made.Ros(2), 500))
    for path, message in (
        (bag, "a ROS 1 bag cannot be followed while it is written: record MCAP"),
        (tmp_path / "drive", "name the MCAP file in it that is being written"),
        (database, "name the MCAP file in it"),
        (next(database.glob("*.db3")), "cannot be followed while it is written: record MCAP"),
    ):
        with pytest.raises(RecordingError, match=message):
            open_recording(path, growth=Growth())
