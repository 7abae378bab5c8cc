"""A scan with a damaged stamp is left out with a warning, the other scans stay, and a gap stays a gap."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gridtrack.common.errors import RecordingError
from gridtrack.common.geometry import SE2
from gridtrack.common.scan import Scan
from gridtrack.recordings import open_recording
from gridtrack.recordings.stamp_order import CONFIRMING_SCANS, StampOrder
from gridtrack.recordings.stream import MAX_EMPTY_FRAMES, open_stream

START_NS, PERIOD_NS, DAY_NS = 10**15, 10**8, 86_400 * 10**9
RANGES = np.ones(1, np.float32)


def scans_at(stamps_ns: Iterable[int], sensor: str = "scan") -> list[Scan]:
    return [Scan(START_NS + stamp, RANGES, 0.0, 0.1, 0.0, 5.0, sensor) for stamp in stamps_ns]


def ordered(scans: Iterable[Scan]) -> tuple[list[int], list[str]]:
    """The stamps of the scans that stay, relative to START_NS, and the warnings."""
    warnings: list[str] = []
    order = StampOrder(warnings.append)
    kept = [found for scan in scans for found in order.push(scan)] + list(order.flush())
    return [scan.stamp_ns - START_NS for scan in kept], warnings


def regular(scans: int) -> list[int]:
    return [k * PERIOD_NS for k in range(scans)]


@pytest.mark.parametrize("at", [0, 1, 2, 100, 397, 398, 399])
@pytest.mark.parametrize("by_ns", [-DAY_NS, DAY_NS, 5 * 10**9, 30 * 10**9])
def test_a_scan_with_a_damaged_stamp_is_left_out(at: int, by_ns: int) -> None:
    stamps = regular(400)
    stamps[at] += by_ns
    kept, warnings = ordered(scans_at(stamps))
    whole = regular(400)
    if by_ns == 5 * 10**9 and at == 399:
        assert (len(kept), warnings) == (400, []), "a last scan five seconds later is a gap"
        return
    assert kept == whole[:at] + whole[at + 1 :]
    (warning,) = warnings
    assert "left out: 1 of them" in warning
    assert "-" not in warning.rpartition("the first")[2], "the time is within the recording"


@given(
    st.lists(
        st.one_of(st.integers(PERIOD_NS // 2, PERIOD_NS * 2), st.integers(1, 5 * 10**9)), min_size=12, max_size=60
    ),
    st.integers(0, 59),
    st.one_of(st.integers(-(10**14), -(10**11)), st.integers(10**11, 10**17)),
)
def test_only_the_scan_with_a_stamp_far_off_is_left_out(steps: list[int], position: int, by_ns: int) -> None:
    at = position % len(steps)
    whole = np.cumsum(steps).tolist()
    stamps = [stamp + by_ns * (k == at) for k, stamp in enumerate(whole)]
    kept, warnings = ordered(scans_at(stamps))
    assert kept == whole[:at] + whole[at + 1 :]
    assert len(warnings) == 1


@pytest.mark.parametrize("at", [27, 28, 29])
def test_a_damaged_stamp_after_an_irregular_one_leaves_out_one_scan(at: int) -> None:
    whole = np.cumsum([PERIOD_NS * (4 if k == 27 else 1) for k in range(30)]).tolist()
    kept, _ = ordered(scans_at([stamp + DAY_NS * (k == at) for k, stamp in enumerate(whole)]))
    assert kept == whole[:at] + whole[at + 1 :]


@given(
    st.lists(st.integers(PERIOD_NS // 2, PERIOD_NS * 2), min_size=2 * CONFIRMING_SCANS, max_size=40),
    st.integers(0, 39),
    st.integers(PERIOD_NS, 10**16),
)
def test_a_gap_stays_a_gap(steps: list[int], position: int, gap_ns: int) -> None:
    at = CONFIRMING_SCANS + position % (len(steps) - 2 * CONFIRMING_SCANS + 1)
    stamps = np.cumsum([step + gap_ns * (k == at) for k, step in enumerate(steps)]).tolist()
    assert ordered(scans_at(stamps)) == (stamps, [])


@given(st.data())
def test_the_kept_scans_are_in_order_for_any_stamps(data: st.DataObject) -> None:
    stamp = st.one_of(st.integers(-5, 5 * 10**9), st.integers(-(10**15), 10**18))
    scans = [
        scan
        for _ in range(data.draw(st.integers(1, 30)))
        for scan in scans_at([data.draw(stamp)], data.draw(st.sampled_from(["front", "rear"])))
    ]
    kept, warnings = ordered(scans)
    assert kept == sorted(kept)
    assert kept
    assert len(kept) == len(scans) or warnings


def test_a_slow_sensor_beside_a_fast_one_loses_no_scan() -> None:
    fast, slow = scans_at(regular(200), "fast"), scans_at(range(0, 200 * PERIOD_NS, 40 * PERIOD_NS), "slow")
    kept, warnings = ordered(sorted(fast + slow, key=lambda scan: scan.stamp_ns))
    assert (len(kept), warnings) == (205, [])


def test_two_clocks_that_start_a_day_apart_keep_the_first_sensor() -> None:
    front, rear = scans_at(regular(50), "front"), scans_at([stamp - DAY_NS for stamp in regular(50)], "rear")
    kept, _ = ordered(scan for pair in zip(front, rear, strict=True) for scan in pair)
    assert kept == sorted(kept)


def test_a_recording_with_impossible_stamps_only_is_refused() -> None:
    with pytest.raises(RecordingError, match="no scan can be used: scans of sensor 'scan' stamped outside 0 to 2"):
        ordered(scans_at([-START_NS - 5, 2**63]))


def test_a_last_scan_a_day_late_adds_no_frames(write, scan) -> None:
    path = write([*(scan(k) for k in range(400)), scan(864_000)])
    stream = open_stream(path)
    assert (len(stream), stream.gaps) == (400, 0)
    far = "with a stamp far from the neighbouring ones, left out: 1 of them, the first 39.900 s after"
    assert [far in warning for warning in stream.recording.warnings].count(True) == 1
    with pytest.raises(RecordingError, match="far from the neighbouring ones"):
        list(open_recording(path, strict=True).scans())


def test_a_gap_of_too_many_frames_is_refused_with_the_stretches_around_it(write, scan) -> None:
    later = MAX_EMPTY_FRAMES + 200
    path = write(scan(k, pose=SE2()) for k in [*range(100), *range(later, later + 100)])
    around = r"name a stretch before or after it \(.*\.mcap@0s-9\.9s, .*\.mcap@620s-\)"
    with pytest.raises(RecordingError, match=r"no scans from 9\.9 s to 620\.0 s, 6101 empty frames .*" + around):
        open_stream(path)
    before, after = open_stream(f"{path}@0s-9.9s"), open_stream(f"{path}@620s-")
    assert (len(before), len(after)) == (99, 100)
    found = [one.frame for one in before.all_observations() if one.frame.visible.any()]
    assert len(found) == 200
    assert len(list(before.all_observations())) == 201


def test_a_long_gap_within_the_limit_stays_empty_frames(write, scan) -> None:
    stream = open_stream(write(scan(k) for k in [*range(30), *range(330, 360)]))
    assert (len(stream), stream.gaps) == (360, 1)
