"""Contact foresight by truth and by observation alone."""

from dataclasses import replace

import numpy as np
import pytest

from gridtrack.evaluation.referee.targets import (
    HIDDEN_FREE,
    HIDDEN_OCCUPIED,
    NOT_SCORED,
    SEEN_FREE,
    SEEN_OCCUPIED,
    Target,
)
from gridtrack.evaluation.statistics.jackknife import Replicates

from scenes.scored_cells import DYNAMIC_CELL, frame, region_maps, scored
from studies.contact_truth import OBSERVED, TRUTH, as_observed, reversed_pairs


def test_by_observation_hidden_cells_are_unknown():
    state = np.array([[SEEN_FREE, SEEN_OCCUPIED], [HIDDEN_FREE, HIDDEN_OCCUPIED]], np.uint8)
    target = replace(Target.of_frame(frame(state < HIDDEN_FREE, state == SEEN_OCCUPIED)), state=state)
    forecast = scored(np.zeros((1, 2, 2), np.float32), [target], region_maps(np.full((2, 2), DYNAMIC_CELL)))
    (found,) = as_observed(forecast).targets
    assert found.state.tolist() == [[SEEN_FREE, SEEN_OCCUPIED], [NOT_SCORED, NOT_SCORED]]


def rows(first, second):
    """Two trackers with 20 recordings that differ by little from `first` and `second`."""
    noise = 0.001 * np.random.default_rng(0).standard_normal((2, 20))
    values = zip(("first", "second"), (first, second), noise, strict=True)
    return {name: Replicates(np.array(v), v + own, np.ones(20)) for name, v, own in values}


@pytest.mark.parametrize(("observed", "significant"), [((0.6, 0.5), None), ((0.5, 0.501), 1), ((0.5, 0.6), 2)])
def test_a_pair_with_another_order_is_named_with_its_significant_differences(observed, significant):
    found = list(reversed_pairs({TRUTH: rows(0.7, 0.6), OBSERVED: rows(*observed)}, ("first", "second")))
    assert [told for _, told in found] == ([] if significant is None else [significant])
    assert all(text.startswith("first less second: +0.1") for text, _ in found)
