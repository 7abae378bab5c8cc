"""Scores of cells: against hand-computed cases and scikit-learn."""

import numpy as np
import pytest
from sklearn.metrics import average_precision_score, brier_score_loss, f1_score, log_loss, precision_score, recall_score

from gridtrack.evaluation.referee.strata import STRATA, STRATA_WITH_TRUTH
from gridtrack.evaluation.referee.targets import Target
from gridtrack.evaluation.scores.brier import BRIER
from gridtrack.evaluation.scores.calibration import CALIBRATION, POSSIBLY_OCCUPIED
from gridtrack.evaluation.scores.cells import (
    CALIBRATION_EDGES,
    HALF,
    PROBABILITY_BINS,
    PROBABILITY_EDGES,
    count_cells,
)
from gridtrack.evaluation.scores.f1 import F1, f1_of
from gridtrack.evaluation.scores.log_loss import LOG_LOSS
from gridtrack.evaluation.scores.pr_auc import PR_AUC
from gridtrack.evaluation.scores.thresholds import Thresholds, half

from scenes.scored_cells import (
    DYNAMIC_CELL,
    STATIC_CELL,
    counted,
    frame,
    members_of,
    random_forecast,
    region_maps,
    scored,
    values,
)

VISIBLE, DYNAMIC, STATIC = (STRATA.index(name) for name in ("visible", "dynamic", "static"))


def binned_by(edges, p):
    """The bin of each probability; the last one has all from its lower edge on."""
    return (np.digitize(p, edges) - 1).clip(0, len(edges) - 2)


def count(occupancy, frames, cell_kinds):
    return count_cells(occupancy, [Target.of_frame(observed) for observed in frames], region_maps(cell_kinds))


def scores_of(occupancy, frames, cell_kinds):
    """Every output of the scores of cells (S, K), by score and output."""
    return all_scores(scored(occupancy, [Target.of_frame(one) for one in frames], region_maps(cell_kinds)))


def all_scores(forecast, **known):
    of_cells = (F1, PR_AUC, LOG_LOSS, BRIER, CALIBRATION)
    return {one.name: values(one, counted(one, forecast, **known)[1]) for one in of_cells}


def test_a_hand_computed_forecast():
    occupancy = np.array([[[0.9, 0.4], [0.6, 0.8]]], np.float32)
    observed = frame([[1, 1], [1, 0]], [[1, 1], [0, 0]])
    cell_kinds = [[STATIC_CELL, DYNAMIC_CELL], [DYNAMIC_CELL, DYNAMIC_CELL]]
    tally = count(occupancy, [observed], cell_kinds)
    at_half = tally.confusion(half(0).bins)
    assert at_half[0, VISIBLE].tolist() == [1, 1, 1, 0]
    assert at_half[0, STATIC].tolist() == [1, 0, 0, 0]
    assert at_half[0, DYNAMIC].tolist() == [0, 1, 1, 0]
    assert tally.squared_error[0, :3] == pytest.approx([0.01 + 0.36 + 0.36, 0.36 + 0.36, 0.01], abs=1e-6)
    assert tally.log_loss[0, STATIC] == pytest.approx(-np.log(0.9))
    assert tally.log_loss[0, DYNAMIC] == pytest.approx(-2 * np.log(0.4))


@pytest.mark.parametrize("seed", range(4))
def test_every_score_of_every_stratum_agrees_with_scikit_learn(seed):
    rng = np.random.default_rng(seed)
    size, steps = 30, 2
    occupancy, cell_kinds = random_forecast(rng, size, steps), rng.integers(0, 3, (size, size)).astype(np.uint8)
    states = rng.integers(0, 5, occupancy.shape).astype(np.uint8)
    ages = rng.integers(0, 5, (size, size)).astype(np.uint8)
    motions = rng.integers(0, 3, occupancy.shape).astype(np.uint8) * (cell_kinds == DYNAMIC_CELL)
    targets = [
        Target(frame(state < 2, state == 1), state, motion) for state, motion in zip(states, motions, strict=True)
    ]
    bins = rng.choice([5, 250, HALF + 15, PROBABILITY_BINS - 1], (steps + 1, len(STRATA_WITH_TRUTH)))
    forecast = scored(occupancy, targets, region_maps(cell_kinds, STRATA_WITH_TRUTH), ages)
    found = all_scores(forecast, thresholds=Thresholds(bins, strata=STRATA_WITH_TRUTH))
    for step, state in enumerate(states):
        members = members_of(cell_kinds, state, motions[step], ages)
        assert tuple(members) == STRATA_WITH_TRUTH
        for k, chosen in enumerate(members.values()):
            truth, p = state[chosen] % 2 == 1, occupancy[step][chosen]
            binned, coarse = binned_by(PROBABILITY_EDGES, p), binned_by(CALIBRATION_EDGES, p)
            called, possible = binned >= bins[step, k], p >= np.float32(POSSIBLY_OCCUPIED)
            clipped = np.clip(p.astype(float), 0.001, 0.999)
            expected = {
                "f1.f1": f1_score(truth, called),
                "f1.precision": precision_score(truth, called, zero_division=np.nan),
                "f1.recall": recall_score(truth, called),
                "f1.at_half": f1_score(truth, p >= 0.5),
                "f1.at_visible": f1_score(truth, binned >= bins[step, VISIBLE]),
                "brier.mean": pytest.approx(brier_score_loss(truth, p), rel=1e-6),
                "log_loss.mean": pytest.approx(log_loss(truth, clipped), rel=1e-6),
                "pr_auc.area": average_precision_score(truth, binned),
                "calibration.error": calibration_error(truth, p, coarse),
                "calibration.above_1_percent": calibration_error(truth[possible], p[possible], coarse[possible]),
            }
            for name, value in expected.items():
                score, output = name.split(".")
                wanted = value if hasattr(value, "expected") else pytest.approx(value, nan_ok=True)
                assert found[score][output][step, k] == wanted, (name, step, k)


def calibration_error(truth, p, binned):
    gaps = [abs(p[binned == b].mean() - truth[binned == b].mean()) * (binned == b).mean() for b in np.unique(binned)]
    return pytest.approx(sum(gaps), rel=1e-5)


def area_and_exact(p, occupied):
    """PR-AUC of a forecast (M, M) in which all cells are visible, and scikit-learn's of its probabilities unbinned."""
    found = scores_of(p[None], [frame(np.ones(p.shape), occupied)], np.full(p.shape, DYNAMIC_CELL))
    return found["pr_auc"]["area"][0, VISIBLE], average_precision_score(occupied.ravel(), p.ravel())


SHAPES = {"mostly near 0": (0.02, 2.0), "spread": (0.3, 3.0), "even": (1.0, 1.0), "mostly near 1": (5.0, 0.3)}


@pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)
@pytest.mark.parametrize("strength", [1.0, 0.7], ids=["calibrated", "too timid"])
def test_pr_auc_is_within_a_few_thousandths_of_the_exact_value(shape, strength):
    rng = np.random.default_rng(9)
    p = rng.beta(*shape, (300, 300)).astype(np.float32)
    found, exact = area_and_exact(p, rng.random(p.shape) < p**strength)
    assert found == pytest.approx(exact, abs=0.002)


@pytest.mark.parametrize("masses", [(0.0, 1.0), (0.5,), (0.0, 0.5, 1.0)], ids=str)
def test_pr_auc_with_masses_at_some_probabilities_is_within_a_few_thousandths_of_the_exact_value(masses):
    rng = np.random.default_rng(4)
    p = rng.beta(0.2, 0.4, (300, 300)).astype(np.float32)
    placed = rng.random(p.shape) < 0.3
    p[placed] = rng.choice(np.array(masses, np.float32), np.count_nonzero(placed))
    found, exact = area_and_exact(p, rng.random(p.shape) < np.where(placed, 0.2 + 0.6 * p**2, p))
    assert found == pytest.approx(exact, abs=0.002)


@pytest.mark.parametrize("mass", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("rate", [0.05, 0.99])
def test_a_mass_at_one_probability_is_not_mixed_with_the_probabilities_beside_it(mass, rate):
    """Cells with a mass are occupied at another rate than cells with nearly the same probability, which are a bin."""
    rng = np.random.default_rng(3)
    is_mass = rng.random((100, 100)) < 0.3
    p = np.where(is_mass, mass, 0.99999 if mass == 1.0 else mass + 1e-5).astype(np.float32)
    found, exact = area_and_exact(p, rng.random(p.shape) < np.where(is_mass, rate, 0.3))
    assert found == pytest.approx(exact)


@pytest.mark.parametrize("levels", [2, 5, 30])
def test_pr_auc_of_a_forecast_with_few_levels_is_exact(levels):
    rng = np.random.default_rng(levels)
    p = rng.choice(PROBABILITY_EDGES[rng.choice(PROBABILITY_BINS, levels, replace=False)], (100, 100)).astype(
        np.float32
    )
    found, exact = area_and_exact(p, rng.random(p.shape) < p)
    assert found == pytest.approx(exact)


def test_the_brier_decomposition_agrees_with_its_definition_and_adds_up():
    rng = np.random.default_rng(4)
    occupancy = random_forecast(rng, 30, 0)
    observed = frame(rng.random((30, 30)) < 0.7, rng.random((30, 30)) < occupancy[0])
    outputs = scores_of(occupancy, [observed], np.full((30, 30), DYNAMIC_CELL))["brier"]
    found = {name: values[0, VISIBLE] for name, values in outputs.items()}
    truth, own = observed.occupied[observed.visible].astype(float), occupancy[0][observed.visible]
    p, binned = own.astype(float), binned_by(CALIBRATION_EDGES, own)
    bins = [(p[binned == b], truth[binned == b]) for b in np.unique(binned)]
    reliability = sum(q.size * (q.mean() - t.mean()) ** 2 for q, t in bins) / p.size
    murphys_resolution = sum(q.size * (t.mean() - truth.mean()) ** 2 for q, t in bins) / p.size
    variance = sum(((q - q.mean()) ** 2).sum() for q, _ in bins) / p.size
    covariance = 2 * sum(((q - q.mean()) * (t - t.mean())).sum() for q, t in bins) / p.size
    assert found["reliability"] == pytest.approx(reliability, abs=1e-9)
    assert found["uncertainty"] == pytest.approx(truth.var())
    assert found["resolution"] == pytest.approx(murphys_resolution - variance + covariance, abs=1e-7)
    score = found["reliability"] - found["resolution"] + found["uncertainty"]
    assert score == pytest.approx(brier_score_loss(truth, p), rel=1e-6)


def test_the_log_loss_of_many_certain_mistakes_does_not_underflow():
    size = 200
    everywhere = np.ones((size, size))
    wrong = count(np.zeros((1, size, size), np.float32), [frame(everywhere, everywhere)], DYNAMIC_CELL * everywhere)
    assert wrong.log_loss[0, VISIBLE] == pytest.approx(-np.log(0.001) * size**2)


def test_a_probability_on_a_bins_edge_belongs_to_the_bin_above():
    size = 30
    more = size**2 - PROBABILITY_BINS
    edges = np.append(PROBABILITY_EDGES[:-1], np.zeros(more)).astype(np.float32).reshape(1, size, size)
    free, dynamic = frame(np.ones((size, size)), np.zeros((size, size))), np.full((size, size), DYNAMIC_CELL)
    tally = count(edges, [free], dynamic)
    assert tally.cells[0, VISIBLE].tolist() == [1 + more] + [1] * (PROBABILITY_BINS - 1)
    below = np.nextafter(edges, np.float32(-1)).clip(0, 1)
    tally = count(below, [free], dynamic)
    # below 0 there is nothing, and below the end of a mass is the mass
    assert tally.cells[0, VISIBLE].tolist() == [2 + more] + [1] * (PROBABILITY_BINS - 2) + [0]


def test_edges_are_exact_and_the_bins_for_calibration_are_made_of_whole_bins():
    assert np.array_equal(PROBABILITY_EDGES.astype(np.float32), PROBABILITY_EDGES)
    assert (np.diff(PROBABILITY_EDGES) > 0).all()
    for edges in (PROBABILITY_EDGES, CALIBRATION_EDGES):
        assert (edges[0], 0.5 in edges, 1.0 in edges) == (0.0, True, True)
    assert set(CALIBRATION_EDGES) <= set(PROBABILITY_EDGES)
    assert POSSIBLY_OCCUPIED in CALIBRATION_EDGES


def test_scores_without_a_scored_cell_are_undefined():
    found = scores_of(np.ones((1, 5, 5), np.float32), [frame(np.zeros((5, 5)), np.zeros((5, 5)))], np.full((5, 5), 2))
    assert all(np.isnan(value).all() for outputs in found.values() for value in outputs.values())


def test_f1_is_zero_where_no_occupied_cell_is_found_and_undefined_without_occupied_cells():
    assert f1_of(np.array([0, 0, 4, 6])) == 0.0
    assert np.isnan(f1_of(np.array([0, 3, 0, 6])))
