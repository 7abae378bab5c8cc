"""Shared by the learned networks: their settings and arrays from weights, and the inputs of a network for any place."""

from __future__ import annotations

import math
from typing import TypeVar

import torch
from torch import nn

from gridtrack.common.config import Settings, validated
from gridtrack.common.errors import WeightsError
from gridtrack.trackers.contract import StreamSpec
from gridtrack.trackers.training.weights import Weights, array

Given = TypeVar("Given", bound=Settings)


UNIT_CELL_M, UNIT_PERIOD_S = 0.1, 0.1
"""The cell size and the period at which the inputs are 0."""


def trained_settings(stream: StreamSpec, weights: Weights, given: Given, running: type[Settings] = Settings) -> Given:
    """The settings of the training of `weights`; settings in `running` do not depend on it and are taken from `given`.

    Raises WeightsError if another given setting differs from the trained one.
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


def restore_network(network: nn.Module, stream: StreamSpec, weights: Weights, prefix: str = "") -> None:
    """Load the arrays of `weights` with names that begin with `prefix` into `network`.

    Raises WeightsError unless the network has the same arrays, with the same shapes.
    """
    shapes = {prefix + name: tuple(value.shape) for name, value in network.state_dict().items()}
    if unknown := sorted(name for name in weights.arrays.keys() - shapes.keys() if name.startswith(prefix)):
        raise WeightsError(f"{stream.weights}: arrays that do not belong to the network on its card: {unknown}")
    found = {name: torch.from_numpy(array(weights, name, shape)) for name, shape in shapes.items()}
    network.load_state_dict({name.removeprefix(prefix): value for name, value in found.items()})


def cell_input(cell_m: float) -> float:
    """log2 of the cell size in UNIT_CELL_M."""
    return math.log2(cell_m / UNIT_CELL_M)


def period_input(period_s: float) -> float:
    """log2 of the period in UNIT_PERIOD_S."""
    return math.log2(period_s / UNIT_PERIOD_S)
