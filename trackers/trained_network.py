"""Loading a trained network: its settings are checked against the options, its arrays against its shapes."""

from __future__ import annotations

from typing import TypeVar

import torch
from torch import nn

from gridtrack.common.config import Settings, validated
from gridtrack.common.errors import WeightsError
from gridtrack.trackers.contract import StreamSpec
from gridtrack.trackers.weights import Weights, array

Given = TypeVar("Given", bound=Settings)


def trained_settings(stream: StreamSpec, weights: Weights, given: Given, running: type[Settings] = Settings) -> Given:
    """The settings that `weights` were trained with; those in `running` do not depend on training: they are `given`.

    Raises WeightsError where another given setting differs from the trained one.
    """
    inference_only = given.model_dump(include=set(running.model_fields), exclude_unset=True)
    trained = validated(type(given), weights.card.settings | inference_only, str(stream.weights))
    for key in given.model_fields_set:
        if getattr(given, key) != getattr(trained, key):
            raise WeightsError(
                f"{stream.weights}: trained with {key}={getattr(trained, key)}, not {getattr(given, key)}: train with"
                " that option"
            )
    return trained


def restore(network: nn.Module, stream: StreamSpec, weights: Weights) -> None:
    """Load `weights` into `network`. Raises WeightsError unless the arrays are those of the network, in its shapes."""
    shapes = {name: tuple(value.shape) for name, value in network.state_dict().items()}
    if unknown := sorted(weights.arrays.keys() - shapes.keys()):
        raise WeightsError(f"{stream.weights}: arrays that do not belong to the network on its card: {unknown}")
    network.load_state_dict({name: torch.from_numpy(array(weights, name, shape)) for name, shape in shapes.items()})
