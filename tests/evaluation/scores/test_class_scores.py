"""Class scores: counts against scikit-learn, matching of classes by name, and recall by class."""

import numpy as np
import pytest
from sklearn.metrics import balanced_accuracy_score, confusion_matrix, log_loss

from gridtrack.evaluation.referee.strata import STRATA_WITH_TRUTH
from gridtrack.evaluation.referee.targets import HIDDEN_OCCUPIED, SEEN_OCCUPIED, Target
from gridtrack.evaluation.scores.class_log_loss import CLASS_LOG_LOSS, confusion_of, count_classes, match_classes
from gridtrack.evaluation.scores.class_recall import CLASS_RECALL
from gridtrack.evaluation.scores.definition import Sums
from gridtrack.evaluation.scores.thresholds import Thresholds, bins_of

from scenes.scored_cells import DYNAMIC_CELL, STATIC_CELL, counted, facts_of, frame, region_maps, scored, values

NAMES = ("pedestrian", "cyclist", "car", "static")
SIZE, STEPS = 20, 2


def random_targets(rng):
    found = []
    for _ in range(STEPS + 1):
        state = rng.integers(0, 4, (SIZE, SIZE)).astype(np.uint8)
        cells = rng.permutation(np.flatnonzero(state % 2 == 1))[:120]
        labels = rng.integers(0, len(NAMES), cells.size).astype(np.uint8)
        found.append(Target(frame(state < 2, state == 1), state, np.zeros_like(state), cells, labels))
    return found


@pytest.fixture
def case():
    rng = np.random.default_rng(3)
    p = rng.dirichlet(np.full(len(NAMES), 0.5), (STEPS + 1, SIZE, SIZE)).astype(np.float32)
    return np.ascontiguousarray(np.moveaxis(p, -1, 1)), random_targets(rng)


def forecast_of(semantics, targets):
    maps = region_maps(np.full((SIZE, SIZE), DYNAMIC_CELL), STRATA_WITH_TRUTH)
    return scored(np.zeros((len(targets), SIZE, SIZE), np.float32), targets, maps, semantics=semantics)


def test_confusion_log_loss_and_balanced_accuracy_agree_with_scikit_learn(case):
    semantics, targets = case
    known = {"classes": NAMES, "tracker_classes": NAMES}
    strata, sums = counted(CLASS_LOG_LOSS, forecast_of(semantics, targets), **known)
    assert strata == ("visible", "occluded")
    found, confusion = values(CLASS_LOG_LOSS, sums), confusion_of(sums)
    for k, state in enumerate((SEEN_OCCUPIED, HIDDEN_OCCUPIED)):
        for n, target in enumerate(targets):
            chosen = target.state.ravel()[target.cells] == state
            truth = target.labels[chosen]
            p = semantics[n].reshape(len(NAMES), -1)[:, target.cells[chosen]].T
            assert np.array_equal(confusion[n, k][:, :-1], confusion_matrix(truth, p.argmax(axis=1), labels=range(4)))
            assert not confusion[n, k][:, -1].any()
            assert found["balanced_accuracy"][n, k] == pytest.approx(balanced_accuracy_score(truth, p.argmax(axis=1)))
            # scikit-learn wants rows that sum to 1: the probability of the true class against all others together
            own = p.astype(float).clip(0.001, 0.999)[np.arange(len(truth)), truth]
            loss = log_loss(np.ones(len(truth)), np.stack([1 - own, own], axis=1), labels=[0, 1])
            assert found["per_cell"][n, k] == found["per_scan"][n, k] == pytest.approx(loss, abs=1e-6)
            assert (found["cells"][n, k], found["scans"][n, k]) == (len(truth), 1)


def test_log_loss_per_scan_gives_every_scan_the_same_weight(case):
    """Two scans, one of 1 cell with a loss of 2, one of 3 cells with a loss of 1 each."""
    parts = CLASS_LOG_LOSS.parts(facts_of(forecast_of(*case), classes=NAMES, tracker_classes=NAMES))
    sums = np.zeros((2, len(parts)))
    sums[:, :3] = [[2.0, 2.0, 1], [3.0, 1.0, 1]]
    sums[:, parts.index("cyclist as car")] = 1, 3
    found = values(CLASS_LOG_LOSS, Sums(sums.sum(axis=0), parts))
    assert (found["per_scan"], found["summed_over_scans"], found["per_cell"]) == (1.5, 3.0, 1.25)


def test_a_tracker_without_classes_has_no_class_log_loss(case):
    forecast = forecast_of(None, case[1])
    assert CLASS_LOG_LOSS.strata(facts_of(forecast, classes=NAMES)) == ()
    known = facts_of(forecast, classes=NAMES, tracker_classes=NAMES)
    assert CLASS_LOG_LOSS.count(forecast, known, CLASS_LOG_LOSS.new_memory(known)) is None


def test_classes_are_matched_by_name_in_any_order(case):
    semantics, targets = case
    order = [2, 0, 3, 1]
    names = [NAMES[k] for k in order]
    one = count_classes(semantics, targets, match_classes(NAMES, NAMES))
    other = count_classes(np.ascontiguousarray(semantics[:, order]), targets, match_classes(names, NAMES))
    assert np.array_equal(one[0], other[0])
    assert other[1] == pytest.approx(one[1])


def test_a_class_that_only_one_side_has_is_the_last_column_or_costs_the_clip(case):
    semantics, targets = case
    strange = count_classes(semantics, targets, match_classes(("horse", *NAMES[1:]), NAMES))
    usual = count_classes(semantics, targets, match_classes(NAMES, NAMES))
    assert np.array_equal(strange[0][..., -1], usual[0][..., 0]), "pedestrians are now horses"
    pedestrians = strange[0][:, :, 0].sum()
    assert strange[1][:, :, 0].sum() == pytest.approx(-pedestrians * np.log(0.001))


def test_recall_counts_dynamic_cells_of_a_class_at_the_threshold_of_their_stratum():
    state = np.full((4, 4), SEEN_OCCUPIED, np.uint8)
    state[2:] = HIDDEN_OCCUPIED
    cell_kinds = np.full((4, 4), DYNAMIC_CELL)
    cell_kinds[:, 0] = STATIC_CELL
    occupancy = np.full((1, 4, 4), 0.4, np.float32)
    occupancy[0, :, 3] = 0.6
    labels = np.repeat([0, 1, 0, 1], 4).astype(np.uint8)
    target = Target(frame(state < 2, state == 1), state, np.zeros_like(state), np.arange(16), labels)
    strata = ("visible", "dynamic", "static", "occluded")
    bins = bins_of(np.array([[0.5, 0.125, 0.5, 0.75]]))  # dynamic from below 0.4 on, occluded only above 0.6
    forecast = scored(occupancy, [target], region_maps(cell_kinds, strata))
    known = {"classes": NAMES[:2], "thresholds": Thresholds(bins, strata=strata)}
    of_class, sums = counted(CLASS_RECALL, forecast, **known)
    found = values(CLASS_RECALL, sums)
    assert of_class == ("dynamic pedestrian", "dynamic cyclist", "occluded pedestrian", "occluded cyclist")
    assert sums.values[0].tolist() == [[3, 0, 1, 2], [3, 0, 1, 2], [0, 3, 1, 2], [0, 3, 1, 2]]
    assert found["recall"].tolist() == [[1, 1, 0, 0]]
    assert found["cells"].tolist() == [[3, 3, 3, 3]]
