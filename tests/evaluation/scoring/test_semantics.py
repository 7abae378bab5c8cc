"""Class scores: counts against scikit-learn, recall by class, and the round trip of the files."""

import numpy as np
import pytest
from sklearn.metrics import balanced_accuracy_score, confusion_matrix, log_loss

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame
from gridtrack.evaluation.results.columns import CLASSES_TABLE, SEMANTICS_TABLE
from gridtrack.evaluation.runs.trial_record import TrialRecord
from gridtrack.evaluation.scoring.class_scores import class_scores
from gridtrack.evaluation.scoring.class_store import ClassWriter, read_found, read_scan_losses, read_semantics
from gridtrack.evaluation.scoring.score_store import ScoresError
from gridtrack.evaluation.scoring.semantics import count_classes, count_found, match_classes
from gridtrack.evaluation.referee.strata import CELL_KINDS
from gridtrack.evaluation.referee.targets import HIDDEN_OCCUPIED, SEEN_OCCUPIED, Target
from gridtrack.evaluation.scoring.thresholds import Thresholds, bins_of

NAMES = ("pedestrian", "cyclist", "car", "static")
SIZE, STEPS = 20, 2
NOTHING = np.zeros((0, 2), np.float32)


def random_targets(rng):
    found = []
    for _ in range(STEPS + 1):
        state = rng.integers(0, 4, (SIZE, SIZE)).astype(np.uint8)
        cells = rng.permutation(np.flatnonzero(state % 2 == 1))[:120]
        frame = GridFrame(0, state < 2, state == 1, SE2(), NOTHING, NOTHING, np.zeros(0, np.uint8))
        labels = rng.integers(0, len(NAMES), cells.size).astype(np.uint8)
        found.append(Target(frame, state, np.zeros_like(state), cells, labels))
    return found


def random_semantics(rng, classes):
    p = rng.dirichlet(np.full(classes, 0.5), (STEPS + 1, SIZE, SIZE)).astype(np.float32)
    return np.ascontiguousarray(np.moveaxis(p, -1, 1))


def scored_kinds(case, folder, horizons_s):
    """The scores of one frame, by kind of cell, at the steps that have these horizons."""
    semantics, targets = case
    with ClassWriter(folder, NAMES, semantics=True) as writer:
        writer.add_semantics(0, *count_classes(semantics, targets, match_classes(NAMES, NAMES)))
        writer.add_found(0, np.zeros((STEPS + 1, 2, len(NAMES), 4), np.int32))
    record = TrialRecord(label="a", recording="r", outcome="ok", steps=STEPS, frames_scored=1)
    return class_scores([(record, folder, list(range(len(horizons_s))))], NAMES, horizons_s).semantics.kinds


@pytest.mark.parametrize(
    ("horizons_s", "steps"),
    [([0.0, 0.5, 1.0], [0, 1, 2]), ([0.0, 0.526316, 1.052632], [0, 1, 2]), ([0.0, 2.5], [0, 1]), ([0.0], [0])],
)
def test_there_is_a_confusion_matrix_at_the_step_nearest_to_each_horizon(case, horizons_s, steps, tmp_path):
    kinds = scored_kinds(case, tmp_path, horizons_s)
    assert [one.step for one in kinds["visible"].confusion] == steps


@pytest.fixture
def case():
    rng = np.random.default_rng(3)
    return random_semantics(rng, len(NAMES)), random_targets(rng)


def of_kind(target, semantics, state):
    """True classes (N,) and probabilities (N, K) of the labelled cells in one state."""
    chosen = target.state.ravel()[target.cells] == state
    return target.labels[chosen], semantics.reshape(len(semantics), -1)[:, target.cells[chosen]].T


def test_confusion_log_loss_and_balanced_accuracy_agree_with_scikit_learn(case, tmp_path):
    semantics, targets = case
    kinds = scored_kinds(case, tmp_path, [0.0, 0.5, 1.0])
    for kind, state in (("visible", SEEN_OCCUPIED), ("occluded", HIDDEN_OCCUPIED)):
        for n, target in enumerate(targets):
            truth, p = of_kind(target, semantics[n], state)
            matrix = confusion_matrix(truth, p.argmax(axis=1), labels=range(len(NAMES)))
            assert np.array_equal(np.array(kinds[kind].confusion[n].cells)[:, :-1], matrix)
            expected = balanced_accuracy_score(truth, p.argmax(axis=1))
            assert kinds[kind].balanced_accuracy[n] == pytest.approx(expected, abs=1e-6)
            clipped = p.astype(float).clip(0.001, 0.999)
            # scikit-learn wants rows that sum to 1: the probability of the true class against all others together
            own = clipped[np.arange(len(truth)), truth]
            loss = log_loss(np.ones(len(truth)), np.stack([1 - own, own], axis=1), labels=[0, 1])
            assert kinds[kind].nll_per_cell[n] == pytest.approx(loss, abs=1e-6)


def test_log_loss_per_scan_gives_every_scan_the_same_weight(tmp_path):
    """Two scans, one of 1 cell with a loss of 2, one of 3 cells with a loss of 1 each."""
    with ClassWriter(tmp_path, NAMES, semantics=True) as writer:
        for stamp_ns, cells, loss in ((1, 1, 2.0), (2, 3, 3.0)):
            confusion, log_loss_of = np.zeros((2, 1, 2, len(NAMES), len(NAMES) + 1))
            confusion[0, 0, 1, 2], log_loss_of[0, 0, 1, 2] = cells, loss
            writer.add_semantics(stamp_ns, confusion.astype(np.int32), log_loss_of)
    counts = read_semantics(tmp_path, 0, NAMES)
    assert counts.scan_log_loss[0, 0] == 3.0
    assert counts.scans[0, 0] == 2
    assert counts.log_loss[0, 0] == 5.0
    assert counts.confusion[0, 0, 1, 2] == 4


def test_the_loss_of_each_scan_is_read_back_also_for_scans_without_classes(tmp_path):
    """Three frames forecast from: the second one's scan has two cells of one class and one of another."""
    with ClassWriter(tmp_path, NAMES, semantics=True) as writer:
        confusion, log_loss_of = np.zeros((2, STEPS + 1, 2, len(NAMES), len(NAMES) + 1))
        confusion[1, 0, 1, 2], log_loss_of[1, 0, 1, 2] = 2, 3.0
        confusion[1, 0, 3, 3], log_loss_of[1, 0, 3, 3] = 1, 1.5
        writer.add_semantics(20, confusion.astype(np.int32), log_loss_of)
    stamps = np.array([10, 20, 30])
    losses = read_scan_losses(tmp_path, stamps, STEPS)
    assert losses.shape == (3, STEPS + 1, 2, 2)
    assert losses[1, 1, 0].tolist() == [1.5, 1.0]
    assert losses.sum() == 2.5
    with pytest.raises(ScoresError, match="a stamp at which no forecast was scored"):
        read_scan_losses(tmp_path, stamps + 1, STEPS)


def test_classes_are_matched_by_name_whatever_their_order(case):
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
    assert np.array_equal(strange[0][..., -1], usual[0][..., 0]), "what was a pedestrian is now a horse"
    pedestrians = strange[0][:, :, 0].sum()
    assert strange[1][:, :, 0].sum() == pytest.approx(-pedestrians * np.log(0.001))


def test_recall_counts_dynamic_cells_of_a_class_at_the_threshold_of_their_stratum():
    state = np.full((4, 4), SEEN_OCCUPIED, np.uint8)
    state[2:] = HIDDEN_OCCUPIED
    cell_kinds = np.full((4, 4), CELL_KINDS.index("dynamic"), np.uint8)
    cell_kinds[:, 0] = CELL_KINDS.index("static")
    occupancy = np.full((1, 4, 4), 0.4, np.float32)
    occupancy[0, :, 3] = 0.6
    frame = GridFrame(0, state < 2, state == 1, SE2(), NOTHING, NOTHING, np.zeros(0, np.uint8))
    target = Target(frame, state, np.zeros_like(state), np.arange(16), np.repeat([0, 1, 0, 1], 4).astype(np.uint8))
    strata = ("visible", "dynamic", "static", "occluded")
    bins = bins_of(np.array([[0.5, 0.125, 0.5, 0.75]]))  # dynamic from below 0.4 on, occluded only above 0.6
    (found,) = count_found(occupancy, [target], cell_kinds, Thresholds(bins, strata=strata), 2)
    visible, occluded = found
    assert visible.tolist() == [[3, 0, 1, 2], [3, 0, 1, 2]]
    assert occluded.tolist() == [[0, 3, 1, 2], [0, 3, 1, 2]]


def test_found_cells_survive_a_round_trip(tmp_path):
    rng = np.random.default_rng(1)
    found = rng.integers(0, 5, (70, STEPS + 1, 2, len(NAMES), 4)).astype(np.int32)
    with ClassWriter(tmp_path, NAMES, semantics=False) as writer:
        for stamp_ns, counts in enumerate(found):
            writer.add_found(stamp_ns, counts)
    assert np.array_equal(read_found(tmp_path, STEPS, NAMES), found.sum(axis=0))
    assert read_semantics(tmp_path, STEPS, NAMES) is None


def test_a_file_that_is_no_store_or_of_other_classes_or_steps_is_refused_in_one_line(tmp_path):
    with ClassWriter(tmp_path, NAMES, semantics=False) as writer:
        writer.add_found(0, np.ones((STEPS + 1, 2, len(NAMES), 4), np.int32))
    for steps, names in ((STEPS - 1, NAMES), (STEPS, NAMES[1:])):
        with pytest.raises(ScoresError, match=r"classes\.parquet: cannot be read as counts of classes"):
            read_found(tmp_path, steps, names)
    (tmp_path / SEMANTICS_TABLE.file).write_bytes((tmp_path / CLASSES_TABLE.file).read_bytes())
    with pytest.raises(ScoresError, match=r"semantics\.parquet: columns stamp_ns"):
        read_semantics(tmp_path, STEPS, NAMES)
    (tmp_path / CLASSES_TABLE.file).write_bytes(b"PAR1 not really")
    with pytest.raises(ScoresError) as refused:
        read_found(tmp_path, STEPS, NAMES)
    assert "\n" not in str(refused.value)
