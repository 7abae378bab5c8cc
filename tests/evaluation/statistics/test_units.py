"""Statistical units: blocks longer than the autocorrelation, never over two recordings."""

import numpy as np

from gridtrack.evaluation.statistics.units import UnitRule, autocorrelation_time


def test_autocorrelation_time_of_an_autoregressive_series_is_the_textbooks():
    rng = np.random.default_rng(0)
    series = np.zeros((20_000, 2))
    for t in range(1, len(series)):
        series[t] = [0.8, 0.0] * series[t - 1] + rng.standard_normal(2)
    limits = [(1 + 0.8) / (1 - 0.8), 1.0]
    assert limits[0] < autocorrelation_time(series[:, :1]) < 1.4 * limits[0]
    assert limits[1] < autocorrelation_time(series[:, 1:]) < 1.1 * limits[1]
    assert autocorrelation_time(series) == autocorrelation_time(series[:, :1])
    assert autocorrelation_time(np.ones((50, 1))) == 1.0


def every_second(frames, start_s=0):
    return (start_s + np.arange(frames)) * 1_000_000_000


def test_blocks_are_equal_long_enough_and_never_reach_over_two_recordings():
    stamps = [every_second(100), every_second(30), every_second(5)]
    units = UnitRule(("a", "b", "c"), 10.0).units_of(stamps)
    assert [np.unique(unit, return_counts=True)[1].tolist() for unit in units] == [[10] * 10, [10] * 3, [5]]
    assert np.concatenate(units).tolist() == sorted(np.concatenate(units).tolist())
    assert [unit[0] for unit in units] == [0, 10, 13]
    twenty = UnitRule(tuple(map(str, range(20))), None).units_of([stamps[0]] * 20)
    assert [set(unit.tolist()) for unit in twenty] == [{i} for i in range(20)]


def test_stretches_of_one_source_are_divided_into_blocks_together_in_the_order_of_time():
    stamps = [every_second(30, start_s=100), every_second(10), every_second(20), every_second(5)]
    late, other, early, nothing = UnitRule(("one", "two", "one", "three"), 25.0).units_of([*stamps[:3], stamps[3][:0]])
    assert early.tolist() == [0] * 20
    assert late.tolist() == [0] * 5 + [1] * 25
    assert other.tolist() == [2] * 10
    assert nothing.tolist() == []
