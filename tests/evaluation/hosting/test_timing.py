"""Which clock counts for the durations of a tracker's calls."""

from __future__ import annotations

from gridtrack.evaluation.hosting.timing import Call, Timings


def test_the_round_trip_counts_where_updates_or_forecasts_take_far_longer_than_reported() -> None:
    honest, dishonest = Call(10.0, 12.0), Call(0.0, 12.0)
    assert (
        Timings().clock
        == Timings([honest], []).clock
        == Timings([dishonest, honest, honest], [honest]).clock
        == "tracker"
    )
    mixed = Timings([honest, Call(11.0, 13.0)], [dishonest])
    assert mixed.clock == "host"
    assert [ms.tolist() for ms in mixed.counted_ms()] == [[12.0, 13.0], [12.0]]


def test_calls_that_were_not_made_have_no_duration() -> None:
    updates_ms, forecasts_ms = Timings([Call(1.0, 2.0)], []).counted_ms()
    assert (updates_ms.tolist(), forecasts_ms.shape) == ([1.0], (0,))
