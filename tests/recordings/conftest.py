"""Scans and recordings for the tests of recordings and streams."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame
from gridtrack.common.scan import Scan
from gridtrack.recordings import RecordingInfo, write_native
from gridtrack.recordings.stream import frame_digest

START_NS = 1_700_000_000_123_456_789
PERIOD_NS = 100_000_000


def make_scan(k: int, sensor: str = "scan", pose: SE2 | None = None, offset_ns: int = 0, beams: int = 36) -> Scan:
    """Scan k of a 10 Hz sensor, with ranges seeded by k; the first three beams are +inf, NaN and -inf."""
    ranges = np.random.default_rng(k).uniform(0.5, 4.5, beams).astype(np.float32)
    ranges[:3] = np.inf, np.nan, -np.inf
    return Scan(START_NS + k * PERIOD_NS + offset_ns, ranges, -1.5, 3.0 / (beams - 1), 0.05, 5.0, sensor, pose or SE2())


def one_beam(scan: Scan, distance: float, **changes: object) -> Scan:
    """A scan with one return, straight ahead."""
    return replace(scan, ranges=np.array([distance], np.float32), angle_min=0.0, angle_increment=0.0, **changes)


def digests(frames: Iterable[GridFrame]) -> list[bytes]:
    return [frame_digest(frame) for frame in frames]


def copied(path: Path, out: Path, change: Callable[[str, int, bytes], bytes], chunk_bytes: int = 1 << 20) -> Path:
    """An MCAP file with other messages, in chunks; `change` gets the topic, the number on it, and the content."""
    counts: Counter[str] = Counter()
    channels: dict[int, int] = {}
    with path.open("rb") as source, out.open("wb") as target:
        reader, writer = make_reader(source), Writer(target, chunk_size=chunk_bytes)
        writer.start("gridtrack")
        for entry in reader.iter_metadata():
            writer.add_metadata(entry.name, entry.metadata)
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            if channel.id not in channels:
                of_schema = writer.register_schema(schema.name, schema.encoding, schema.data)
                about = (channel.topic, channel.message_encoding, of_schema, channel.metadata)
                channels[channel.id] = writer.register_channel(*about)
            data = change(channel.topic, counts[channel.topic], message.data)
            writer.add_message(channels[channel.id], message.log_time, data, message.publish_time)
            counts[channel.topic] += 1
        writer.finish()
    return out


@pytest.fixture
def scan() -> Callable[..., Scan]:
    return make_scan


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    """Writes scans as a native recording and returns its path."""

    def write_recording(scans: Iterable[Scan], name: str = "made.mcap", **info: object) -> Path:
        path = tmp_path / name
        with path.open("wb") as file:
            write_native(file, RecordingInfo.model_validate({"site": "here"} | info), scans)
        return path

    return write_recording


@pytest.fixture
def same_scans() -> Callable[[Iterator[Scan], Iterable[Scan]], None]:
    """Asserts that two sequences of scans are equal to the last bit, their headings to rounding."""

    def assert_same(found: Iterator[Scan], expected: Iterable[Scan]) -> None:
        for a, b in zip(found, expected, strict=True):
            assert (a.stamp_ns, a.sensor, a.range_min, a.range_max) == (b.stamp_ns, b.sensor, b.range_min, b.range_max)
            assert a.time_increment_s == b.time_increment_s
            np.testing.assert_array_equal(a.ranges, b.ranges)
            np.testing.assert_array_equal(a.labels, b.labels)
            assert a.ranges.dtype == np.float32
            np.testing.assert_allclose(
                [a.angle_min, a.angle_increment], [b.angle_min, b.angle_increment], rtol=1e-15, atol=0.0
            )
            assert (a.world_T_sensor.x, a.world_T_sensor.y) == (b.world_T_sensor.x, b.world_T_sensor.y)
            assert abs(a.world_T_sensor.theta - b.world_T_sensor.theta) < 1e-12

    return assert_same
