"""A trained network from its weights: its settings checked against what is asked for, its arrays against its shape."""

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
    """The settings that `weights` were trained with, and of those that do not concern training, the `given` ones.

    The latter are the fields of `running`. Raises WeightsError where the trained ones contradict one that was given.
    """
    at_will = given.model_dump(include=set(running.model_fields), exclude_unset=True)
    trained = validated(type(given), weights.card.settings | at_will, str(stream.weights))
    for key in given.model_fields_set:
        if getattr(given, key) != getattr(trained, key):
            raise WeightsError(
                f"{stream.weights}: trained with {key}={getattr(trained, key)}, not {getattr(given, key)}: train anew"
                " with that option"
            )
    return trained


def restore(network: nn.Module, stream: StreamSpec, weights: Weights) -> None:
    """Fill `network` with `weights`. Raises WeightsError unless they are its arrays, in its shapes, and no others."""
    shapes = {name: tuple(value.shape) for name, value in network.state_dict().items()}
    if unknown := sorted(weights.arrays.keys() - shapes.keys()):
        raise WeightsError(f"{stream.weights}: arrays that its card does not account for: {unknown}")
    network.load_state_dict({name: torch.from_numpy(array(weights, name, shape)) for name, shape in shapes.items()})
