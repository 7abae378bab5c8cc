"""A training that starts from a general network: its shape, its arrays, and at a site what the place adds.

General weights have one bias for each channel; at a site each bias is a map of the place, the static memory, and what
it adds to the general bias begins at zero. Before the first update both networks are therefore the same function. The
inputs for cell size and period stay in. A general training that goes on from general weights adds nothing.
"""

from __future__ import annotations

from typing import Any, TypeVar

import torch
from torch import nn

from gridtrack.common.config import validated
from gridtrack.common.errors import WeightsError
from gridtrack.trackers.recurrent.settings import (
    DeepTrackingRNNSettings,
    DilatedConvGRUSettings,
    ResolutionSettings,
    TrainingSettings,
)
from gridtrack.trackers.training.weights import Weights

NetworkOptions = TypeVar("NetworkOptions", bound=ResolutionSettings)

FROM_GENERAL = {"updates": 600, "validate_every": 150, "warm_up": 50, "learning_rate": 1e-3}
"""Settings of a training that starts from general weights: minutes of a processor, and at this rate what the network
knows is not forgotten."""
AT_MOST = {"batch": 2, "burn_in": 20}
"""Its settings that are those of the general weights, but no larger: these may come from an accelerator, whose batches
take a processor too long, and a longer burn-in takes twice as long and gains nothing at a site."""
NOT_TAKEN_OVER = frozenset({"static_gates", "precision", "devices", "shape_updates", "shape_share", "motion_weight"})
"""Settings that are not those of the general weights: the last three are what a network learns motion from at first."""
FOR_ANY_PLACE = {"resolution_input": True, "step_s": 0.1}
"""Settings of a general network, unless others are given."""


def general_options(options: NetworkOptions) -> NetworkOptions:
    """The `options`, and for those that were not given FOR_ANY_PLACE."""
    not_given = FOR_ANY_PLACE.keys() - options.model_fields_set
    return options.model_copy(update={name: FOR_ANY_PLACE[name] for name in not_given})


def settings_from_general(options: NetworkOptions, weights: Weights) -> NetworkOptions:
    """The `options`, and for those that were not given the settings of the general `weights`.

    Raises WeightsError where a given option is another shape than theirs.
    """
    shape = {name for kind in (DilatedConvGRUSettings, DeepTrackingRNNSettings) for name in kind.model_fields}
    known = (shape | TrainingSettings.model_fields.keys()) & type(options).model_fields.keys()
    theirs = {name: value for name, value in weights.card.settings.items() if name in known - NOT_TAKEN_OVER}
    trained: Any = validated(type(options), theirs, f"weights of {weights.card.tracker}, settings")
    for name in sorted(options.model_fields_set & shape - NOT_TAKEN_OVER):
        if getattr(options, name) != getattr(trained, name):
            raise WeightsError(
                f"the general weights have {name}={getattr(trained, name)}, not {getattr(options, name)}: leave the"
                " option out, or train with --from-scratch"
            )
    shorter = FROM_GENERAL | {name: min(getattr(trained, name), most) for name, most in AT_MOST.items()}
    return validated(type(options), theirs | shorter | options.model_dump(exclude_unset=True), "training")


def begin_from(network: nn.Module, weights: Weights) -> None:
    """Load the arrays of the general `weights` into `network`, at a site each bias in every cell of its map.

    Their class decoder is left out. Raises WeightsError where an array is missing or has another shape.
    """
    own = network.state_dict()
    for name, value in own.items():
        found = weights.arrays.get(name)
        shape = (value.shape[0], 1, 1) if ".biases." in name else tuple(value.shape)
        if found is None or found.shape != shape:
            what = "missing" if found is None else f"{found.shape}"
            raise WeightsError(f"general weights of {weights.card.tracker}: array '{name}' is {what}, expected {shape}")
        value.copy_(torch.from_numpy(found))
