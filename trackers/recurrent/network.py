"""The interfaces of networks: of all for training, and of recurrent ones for tracking in a moving window."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from gridtrack.trackers.recurrent.settings import TrainingSettings
from gridtrack.trackers.training.networks import cell_input, period_input

Float32Array = NDArray[np.float32]

State = Any
"""A latent state: tensors (B, C, M, M) in nested tuples, lists or dicts of any structure."""

DecodedLayers = Literal["last", "all"]


class WindowForecast(NamedTuple):
    """The forecasts of some frames of training windows, for the loss.

    `frames`: F numbers of frames in a window. `logits` (F * B, M, M) of P(occupied): the first of these frames of all
    windows, then the second one. `penalty`: what the loss has besides their cross-entropy, nats.
    """

    frames: Sequence[int]
    logits: Tensor
    penalty: Tensor | float = 0.0


class TrainedNetwork(Protocol):
    """A network as its training sees it."""

    mixed_resolutions: bool = False
    """Whether the windows of one batch may differ in cell size and period."""

    @abstractmethod
    def forecast_windows(self, windows: Tensor, settings: TrainingSettings) -> WindowForecast:
        """Forecast frames of `windows` (B, T, 2, M, M) of 0 and 1 from those before them that are observed."""


class Recurrence(TrainedNetwork, Protocol):
    """The steps of a network and its occupancy decoder."""

    @abstractmethod
    def initial(self, batch: int) -> State:
        """h_0."""

    @abstractmethod
    def step(self, x: Tensor | None, state: State) -> State:
        """h_t from x_t (B, 2, M, M), the planes visible and occupied, and h_{t-1}. None is the empty input."""

    @abstractmethod
    def features(self, state: State) -> Tensor:
        """The part of the latent state that the occupancy decoder reads, (B, C, M, M)."""

    @abstractmethod
    def occupancy(self, features: Tensor) -> Tensor:
        """Logits of P(occupied), (B, M, M)."""

    def forecast_windows(self, windows: Tensor, settings: TrainingSettings) -> WindowForecast:
        """The decoded state after every frame, observed or blank; the burn-in has neither forecast nor gradient."""
        state = self.initial(windows.shape[0])
        features = []
        for t, x in enumerate(windows.transpose(0, 1)):
            observed = x.contiguous(memory_format=torch.channels_last) if settings.is_observed(t) else None
            with torch.set_grad_enabled(t >= settings.burn_in):
                state = self.step(observed, state)
            if t >= settings.burn_in:
                features.append(self.features(state))
        return WindowForecast(range(settings.burn_in, windows.shape[1]), self.occupancy(torch.cat(features)))


class Network(nn.Module, TrainedNetwork):
    """Base of the networks.

    `size`: cells a side of its grids; a network without maps takes grids of any size, once this is set.
    """

    def __init__(self, size: int) -> None:
        super().__init__()
        self.size = size

    @property
    @abstractmethod
    def decoder(self) -> nn.Conv2d:
        """The last convolution, whose one output is the logit of P(occupied)."""

    @property
    def output_bias(self) -> Tensor:
        """The bias (1,) of the decoder."""
        assert self.decoder.bias is not None
        return self.decoder.bias

    def maps(self) -> dict[str, nn.Parameter]:
        """The static memory, by name: parameters (C, M, M), or (C, 1, 1) in a network for any place."""
        return {name: parameter for name, parameter in self.named_parameters() if parameter.ndim == 3}


class RecurrentNetwork(Network, Recurrence):
    """Base of the recurrent networks: a Recurrence with parameters.

    A subclass defines `decoder`, and `initial`, `step` and `features` of Recurrence; the other methods have defaults.
    """

    def __init__(self, size: int) -> None:
        super().__init__(size)
        self.decoded_layers: DecodedLayers = "last"
        self.decode_semantics: nn.Module | None
        self.register_module("decode_semantics", None)

    def occupancy(self, features: Tensor) -> Tensor:
        """Logits of P(occupied), (B, M, M)."""
        logits: Tensor = self.decoder(features)
        return logits.squeeze(1)

    def class_planes(self, state: State, layers: DecodedLayers) -> Tensor:
        """The part of the latent state that the class decoder reads, (B, C, M, M); `features` unless overridden."""
        return self.features(state)

    def semantics(self, state: State) -> Tensor | None:
        """Logits of the K classes, (B, K, M, M); None without a class decoder, `decode_semantics`."""
        if self.decode_semantics is None:
            return None
        logits: Tensor = self.decode_semantics(self.class_planes(state, self.decoded_layers))
        return logits


def map_state(function: Callable[..., Any], state: State, *others: State) -> State:
    """`function` of each tensor of the `state`, and of those at the same place in the `others`."""
    if isinstance(state, dict):
        return {key: map_state(function, state[key], *(other[key] for other in others)) for key in state}
    if isinstance(state, tuple | list):
        parts = [map_state(function, *each) for each in zip(state, *others, strict=True)]
        return type(state)(*parts) if hasattr(state, "_fields") else type(state)(parts)
    return function(state, *others)


def tensors_of(state: State) -> Iterator[Tensor]:
    """The tensors of a state, in a fixed order."""
    if isinstance(state, Tensor):
        yield state
    else:
        for part in state.values() if isinstance(state, dict) else state:
            yield from tensors_of(part)


class ResolutionShift(nn.Module):
    """Cell size and period as inputs of a network for any place: they shift the biases (C,) of a layer.

    The shift is weights (C, 2) times `resolution_of` the grids. They begin with zeros: the network is then the same at
    every resolution. `resolution` is (2,), or (B, 2) if the windows of a batch differ.

    Two constant planes beside visible and occupied would do the same, except at the edge of the window, where a
    convolution reads the zeros outside; and they would have to be convolved in frames without input too.
    """

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.zeros(channels, 2))
        self.resolution = torch.zeros(2)

    def forward(self, bias: Tensor) -> Tensor:
        """The `bias` (C,) or (C, M, M) at `resolution`; (B, C, M, M) if the windows of a batch differ."""
        shift = self.resolution.to(self.weight.device) @ self.weight.T
        return bias + shift.view(*shift.shape, *(1,) * (bias.ndim - 1))


def resolution_of(cell_m: float, period_s: float) -> Tensor:
    """The inputs (2,) float32: the logarithms of cell size and period."""
    return torch.tensor([cell_input(cell_m), period_input(period_s)], dtype=torch.float32)


def set_resolution(network: nn.Module, resolution: Tensor) -> None:
    """Set the resolution (2,) of the grids, or (B, 2) of a batch; no effect on a network for one site."""
    for module in network.modules():
        if isinstance(module, ResolutionShift):
            module.resolution = resolution


def channels_last(network: nn.Module) -> Any:
    """The network with its convolutions in channels-last memory, which is fastest on a processor."""
    to: Any = network.to
    return to(memory_format=torch.channels_last)


def as_cells(tensor: Tensor) -> Float32Array:
    """(1, C, M, M) in channels-last memory as (M, M, C), without copying."""
    cells: Float32Array = tensor[0].permute(1, 2, 0).numpy()
    return cells


def as_tensor(cells: Float32Array) -> Tensor:
    """(M, M, C) as (1, C, M, M) in channels-last memory, without copying.

    The batch comes first: if a batch of one had another stride, the tensor would not be channels-last for torch, and
    convolutions and `cat` would copy it.
    """
    return torch.from_numpy(cells)[None].permute(0, 3, 1, 2)
