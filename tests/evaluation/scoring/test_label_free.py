"""Thresholds without labels: the best expected F1 of the forecasts so far, from probabilities alone."""

from __future__ import annotations

import numpy as np

from gridtrack.evaluation.results.columns import CALIBRATION_EDGES, PROBABILITY_BINS, PROBABILITY_EDGES
from gridtrack.evaluation.scoring import metrics
from gridtrack.evaluation.scoring.counting import HALF, Tally
from gridtrack.evaluation.scoring.label_free import LabelFreeThresholds
from gridtrack.evaluation.referee.strata import STRATA
from gridtrack.evaluation.scoring.thresholds import best_thresholds

DYNAMIC = STRATA.index("dynamic")


def tally_of(p, occupied):
    """A tally of step 0 with these cells (N,) in the dynamic stratum."""
    tally = Tally.empty(0)
    bins = PROBABILITY_EDGES[1:-1].searchsorted(p, side="right")
    tally.cells[0, DYNAMIC] = np.bincount(bins, minlength=PROBABILITY_BINS)
    tally.positives[0, DYNAMIC] = np.bincount(bins[occupied], minlength=PROBABILITY_BINS)
    coarse = CALIBRATION_EDGES[1:-1].searchsorted(p, side="right")
    tally.p_sum[0, DYNAMIC] = np.bincount(coarse, weights=p, minlength=len(CALIBRATION_EDGES) - 1)
    return tally


def drawn(seed, cells=20_000):
    rng = np.random.default_rng(seed)
    p = rng.beta(0.1, 3.0, cells).astype(np.float32)
    return p, rng.random(cells) < p


def test_the_expected_f1_is_maximised_over_the_edges_by_brute_force():
    p, occupied = drawn(0)
    thresholds = LabelFreeThresholds(0, STRATA)
    thresholds.add(10, tally_of(p, occupied))
    chosen = PROBABILITY_EDGES[thresholds.bins(10)[0, DYNAMIC]]

    def expected(edge):
        called = p >= edge
        return 2 * p[called].sum() / (called.sum() + p.sum())

    assert chosen in CALIBRATION_EDGES
    assert expected(chosen) >= max(expected(edge) for edge in CALIBRATION_EDGES[1:-1]) - 1e-6


def test_the_threshold_of_a_calibrated_forecast_is_nearly_as_good_as_the_best_one():
    before, now = tally_of(*drawn(1)), tally_of(*drawn(2))
    thresholds = LabelFreeThresholds(0, STRATA)
    thresholds.add(10, before)
    f1, best, at_half = (
        metrics.f1_score(now.confusion(bins))[0, DYNAMIC]
        for bins in (thresholds.bins(10), best_thresholds(now, "").bins, np.full((1, len(STRATA)), HALF))
    )
    assert f1 > best - 0.02
    assert f1 > at_half + 0.05


def test_what_was_observed_in_the_cells_does_not_matter():
    p, occupied = drawn(3)
    found = []
    for labels in (occupied, ~occupied):
        thresholds = LabelFreeThresholds(0, STRATA)
        thresholds.add(10, tally_of(p, labels))
        found.append(thresholds.bins(10).tolist())
    assert found[0] == found[1]


def test_a_forecast_is_not_used_before_its_last_frame_is_observed():
    thresholds = LabelFreeThresholds(0, STRATA)
    thresholds.add(10, tally_of(*drawn(4)))
    assert thresholds.bins(9)[0].tolist() == [HALF] * len(STRATA)
    later = thresholds.bins(10)[0]
    assert later[DYNAMIC] < HALF
    assert later[STRATA.index("static")] == HALF
