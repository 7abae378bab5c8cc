"""The general weights that a training starts from: at a site those that `compare` would find, or none."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from gridtrack.common.errors import ConfigurationError
from gridtrack.evaluation.runs.learned import LearnedWeights, copy_weights, find_weights
from gridtrack.evaluation.runs.recipe import Recipe
from gridtrack.evaluation.scoring.splits import common_with
from gridtrack.recordings.stream import GridStream
from gridtrack.trackers.card import GENERAL


def general_start(
    recipe: Recipe, validation: Sequence[GridStream], folder: Path, report: Callable[[str], None], *, can_start: bool
) -> LearnedWeights | None:
    """A copy in `folder` of the general weights of the recipe's tracker, None from scratch; a line says which.

    `can_start`: whether the tracker can start from some. Raises WeightsError, and ConfigurationError where they learned
    from frames of `validation`.
    """
    if not can_start:
        if recipe.weights:
            report(f"from scratch: this training of {recipe.tracker} starts from no weights, --weights has no effect")
        return None
    if recipe.from_scratch:
        report("from scratch, not from general weights")
        return None
    if recipe.general and not recipe.weights:
        report("from scratch: a general training goes on from general weights where --weights names their folder")
        return None
    found = find_weights(recipe.tracker, GENERAL, Path(recipe.weights) if recipe.weights else None, "general")
    if found is None:
        report(f"from scratch: there are no general weights of {recipe.tracker}")
        return None
    _refuse_seen(found, validation)
    start = copy_weights(found, folder)
    report(f"starts from the general weights {start.name}, sha256 {start.sha256[:12]}")
    return start


def _refuse_seen(found: LearnedWeights, validation: Sequence[GridStream]) -> None:
    """Weights that know the validation stretch would decide nothing there, and their thresholds would flatter."""
    for stream in validation:
        for data in found.card.train:
            if common_with(stream, data) is not None:
                raise ConfigurationError(
                    f"{found.name} was trained on {data.recording}, which has frames of {stream.name}: validate on"
                    " other frames, or train with --from-scratch"
                )
