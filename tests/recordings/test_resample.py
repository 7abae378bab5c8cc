"""Every tick has the nearest scan of each sensor, a missing scan is bridged, and a longer gap stays empty."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from gridtrack.common.scan import Scan
from gridtrack.recordings.resample import resample_scans

PERIOD = 100


def scans_at(stamps: list[int], sensor: str = "scan") -> list[Scan]:
    return [Scan(stamp, np.zeros(1, np.float32), 0.0, 0.1, 0.0, 1.0, sensor) for stamp in stamps]


def chosen(stamps: list[int], ticks: range, origin: int = 1000) -> list[int | None]:
    """The stamp of the scan of each tick, relative to the origin."""
    return [
        tick.scans["scan"].stamp_ns - origin if "scan" in tick.scans else None
        for tick in resample_scans(scans_at([origin + s for s in stamps]), PERIOD, origin_ns=origin, ticks=ticks)
    ]


def test_one_missing_scan_is_bridged_by_its_neighbour() -> None:
    assert chosen([0, 100, 300, 400], range(5)) == [0, 100, 100, 300, 400]


def test_a_gap_of_more_than_two_periods_is_empty_except_at_its_edges() -> None:
    assert chosen([0, 100, 520, 600], range(7)) == [0, 100, None, None, None, 520, 600]
    assert chosen([0, 100, 301], range(4)) == [0, 100, None, 301]


def test_the_stamps_of_the_ticks_are_regular() -> None:
    stamps = [tick.stamp_ns for tick in resample_scans(scans_at([7, 111, 193]), PERIOD, origin_ns=7, ticks=range(5, 8))]
    assert stamps == [507, 607, 707]


def test_each_sensor_has_its_own_scans() -> None:
    merged = sorted(scans_at([0, 100, 200], "a") + scans_at([30, 430], "b"), key=lambda s: s.stamp_ns)
    ticks = [
        {n: s.stamp_ns for n, s in tick.scans.items()}
        for tick in resample_scans(merged, PERIOD, origin_ns=0, ticks=range(5))
    ]
    assert ticks == [{"a": 0, "b": 30}, {"a": 100}, {"a": 200}, {}, {"b": 430}]


def rule(stamps: list[int], tick: int) -> int | None:
    """The expected scan of a tick, by a search over all stamps."""
    nearest = min(stamps, key=lambda s: (abs(s - tick), s), default=None)
    if nearest is None or abs(nearest - tick) > PERIOD:
        return None
    before, after = [s for s in stamps if s <= tick], [s for s in stamps if s > tick]
    bridged = bool(before and after) and min(after) - max(before) <= 2 * PERIOD
    return nearest if abs(nearest - tick) <= PERIOD / 2 or bridged else None


@given(st.sets(st.integers(0, 3000), max_size=40), st.integers(0, 10), st.integers(0, 25))
def test_agrees_with_a_search_over_all_scans(stamps: set[int], first: int, count: int) -> None:
    ticks = range(first, first + count)
    assert chosen(sorted(stamps), ticks) == [rule(sorted(stamps), k * PERIOD) for k in ticks]
