"""Degraded scans: each kind has its stated effect, the same for every reading of a scan."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from gridtrack.common.errors import ConfigurationError
from gridtrack.common.geometry import SE2
from gridtrack.common.scan import Scan
from gridtrack.recordings.degradation import JITTER_LEVER_M, Degradation, degrader, parse_degradation
from gridtrack.recordings.stream import open_stream

BEAMS = 4000
SCAN = Scan(
    10**9, np.full(BEAMS, 3.0, np.float32), -math.pi, 2 * math.pi / BEAMS, 0.05, 8.0, world_T_sensor=SE2(1.0, 2.0, 0.3)
)


def scans(count: int) -> list[Scan]:
    return [replace(SCAN, stamp_ns=10**9 + k * 10**8) for k in range(count)]


def test_a_dropped_beam_is_invalid() -> None:
    lost = np.isnan(degrader(Degradation(beam_dropout=0.2), seed=1)(SCAN).ranges)
    assert lost.mean() == pytest.approx(0.2, abs=4 * math.sqrt(0.2 * 0.8 / BEAMS))


def test_a_dropped_sector_has_ten_degrees_and_is_dropped_for_two_seconds() -> None:
    ranges = np.full(3600, 3.0, np.float32)
    turn = [replace(scan, ranges=ranges, angle_increment=math.tau / 3600) for scan in scans(200)]
    lost = [np.isnan(degrader(Degradation(sector_dropout=0.5), seed=1)(scan).ranges) for scan in turn]
    sectors = np.array([np.unique(one.reshape(36, -1)[:, 1:-1], axis=1).ravel() for one in lost])
    assert sectors.shape == (200, 36), "all beams of a sector share its fate"
    assert sectors.mean() == pytest.approx(0.5, abs=0.1)
    changes = np.flatnonzero((np.diff(sectors, axis=0)).any(axis=1))
    assert (np.diff(changes) % 20 == 0).all(), "scans are a tenth of a second apart"


def test_range_noise_is_in_metres_and_changes_returns_only() -> None:
    scan = replace(SCAN, ranges=SCAN.ranges.copy())
    scan.ranges[:4] = math.inf, math.nan, 9.0, 0.01
    noisy = degrader(Degradation(range_noise=0.05), seed=1)(scan).ranges
    np.testing.assert_array_equal(noisy[:4], scan.ranges[:4])
    off = noisy[4:] - 3.0
    assert off.mean() == pytest.approx(0.0, abs=4 * 0.05 / math.sqrt(BEAMS))
    assert off.std() == pytest.approx(0.05, rel=0.05)
    close = replace(SCAN, ranges=np.full(BEAMS, 0.06, np.float32))
    assert degrader(Degradation(range_noise=0.5), seed=1)(close).ranges.min() == np.float32(0.05)
    far = replace(SCAN, ranges=np.full(BEAMS, 7.99, np.float32))
    assert degrader(Degradation(range_noise=0.5), seed=1)(far).ranges.max() == np.float32(8.0)


def test_a_dropped_frame_is_empty() -> None:
    seen = [degrader(Degradation(frame_drop=0.3), seed=1)(scan) for scan in scans(1000)]
    dropped = np.array([np.isnan(scan.ranges).all() for scan in seen])
    assert dropped.mean() == pytest.approx(0.3, abs=4 * math.sqrt(0.3 * 0.7 / 1000))
    assert all((scan.ranges == 3.0).all() for scan, gone in zip(seen, dropped, strict=True) if not gone)


def test_pose_jitter_shifts_and_rotates_the_pose() -> None:
    poses = [degrader(Degradation(pose_jitter=0.05), seed=1)(scan).world_T_sensor for scan in scans(2000)]
    off = np.array([(p.x - 1.0, p.y - 2.0, (p.theta - 0.3) * JITTER_LEVER_M) for p in poses])
    np.testing.assert_allclose(off.std(axis=0), 0.05, rtol=0.08)
    np.testing.assert_allclose(off.mean(axis=0), 0.0, atol=4 * 0.05 / math.sqrt(2000))


def test_the_degradation_depends_on_the_seed_and_the_scan_only() -> None:
    everything = Degradation(beam_dropout=0.2, range_noise=0.05, frame_drop=0.1, pose_jitter=0.05)
    one, again, other = (degrader(everything, seed)(SCAN) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one.ranges, again.ranges)
    assert one.world_T_sensor == again.world_T_sensor
    assert not np.array_equal(one.ranges, other.ranges, equal_nan=True)
    another_sensor = degrader(everything, 1)(replace(SCAN, sensor="rear"))
    assert not np.array_equal(one.ranges, another_sensor.ranges, equal_nan=True)


def test_a_weaker_degradation_is_part_of_a_stronger_one() -> None:
    """The same beams and frames are lost first: a curve over the strength has no random jumps."""
    strong = Degradation(beam_dropout=0.4, range_noise=0.1, sector_dropout=0.4)
    at = {share: degrader(strong.scaled(share), seed=1)(SCAN).ranges for share in (0.25, 0.5, 1.0)}
    assert np.isnan(at[0.5])[np.isnan(at[0.25])].all()
    assert np.isnan(at[1.0])[np.isnan(at[0.5])].all()
    both = ~np.isnan(at[1.0])
    np.testing.assert_allclose((at[1.0] - 3.0)[both], 2 * (at[0.5] - 3.0)[both], atol=1e-5)


def test_truth_and_stamp_are_not_changed() -> None:
    labels = np.zeros(BEAMS, np.uint8)
    degraded = degrader(Degradation(beam_dropout=0.5, frame_drop=1.0), seed=1)(replace(SCAN, labels=labels))
    assert degraded.labels is labels
    assert degraded.stamp_ns == SCAN.stamp_ns


def test_a_degradation_is_read_from_text_and_unknown_kinds_are_refused() -> None:
    given = parse_degradation("beam-dropout=0.2,range-noise=0.05,frame-drop=0.1,pose-jitter=0.05")
    assert given == Degradation(beam_dropout=0.2, range_noise=0.05, frame_drop=0.1, pose_jitter=0.05)
    assert given.kinds == ("beam_dropout", "range_noise", "frame_drop", "pose_jitter")
    assert parse_degradation("frame-drop=0.1").kinds == ("frame_drop",)
    assert given.only("range_noise") == Degradation(range_noise=0.05)
    with pytest.raises(ConfigurationError, match=r"--degrade: .*beam-dropuot.*did you mean 'beam-dropout'"):
        parse_degradation("beam-dropuot=0.2")
    with pytest.raises(
        ConfigurationError, match="'foo'; known: beam-dropout, frame-drop, pose-jitter, range-noise, sector-dropout"
    ):
        parse_degradation("foo=1")
    with pytest.raises(ConfigurationError, match=r"'beam-dropout' = 20: .*less than or equal to 1"):
        parse_degradation("beam-dropout=20")
    for nothing in ("", "beam-dropout=0"):
        with pytest.raises(ConfigurationError, match="degrades nothing"):
            parse_degradation(nothing)


def test_a_degraded_stream_has_the_ticks_and_the_grid_of_the_original(write, scan) -> None:
    """Of a sensor that moves: its window follows the recorded poses."""
    path = write([scan(k, beams=360, pose=SE2(0.07 * k)) for k in range(40)], grid="40x0.25", rate_hz=10.0)
    stream = open_stream(path)
    plain = list(stream)
    lost = list(stream.degraded(degrader(Degradation(frame_drop=1.0), seed=0)))
    shaken = list(stream.degraded(degrader(Degradation(pose_jitter=0.3), seed=0)))
    assert [f.stamp_ns for f in lost] == [f.stamp_ns for f in shaken] == [f.stamp_ns for f in plain]
    assert not any(f.visible.any() or len(f.points) for f in lost)
    for frame, other in zip(plain, shaken, strict=True):
        assert other.world_T_grid == frame.world_T_grid
        assert np.abs(other.origins - frame.origins).max() > 1e-3
    assert any((a.occupied != b.occupied).any() for a, b in zip(plain, shaken, strict=True))
    np.testing.assert_array_equal([f.occupied for f in stream], [f.occupied for f in plain])
