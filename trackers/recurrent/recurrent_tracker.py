"""Base of the recurrent trackers: frames update the latent state; a forecast is a series of updates without input."""

from __future__ import annotations

from abc import abstractmethod
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, Shift, shift_between
from gridtrack.trackers.contract import FitTask, Forecast, StreamSpec, Tracker
from gridtrack.trackers.recurrent.inference import InferenceNetwork, StreamNetwork, is_map
from gridtrack.trackers.recurrent.network import (
    Recurrence,
    RecurrentNetwork,
    State,
    channels_last,
    resolution_of,
    set_resolution,
)
from gridtrack.trackers.recurrent.pacing import StepPace, paced
from gridtrack.trackers.recurrent.settings import InferenceSettings
from gridtrack.trackers.registry import registered_name
from gridtrack.trackers.training.device import device_name, inference_device, wait_for
from gridtrack.trackers.training.networks import restore_network, trained_settings
from gridtrack.trackers.training.weights import Weights, load_weights

MOST_MISSED = 20
"""Largest number of missed frames for which steps are made at once: a network with steps longer than a period would
otherwise fall further behind with every frame."""


class RecurrentTracker(Tracker):
    """A recurrent network as a tracker; a subclass has `Options`, and builds the network."""

    learns: ClassVar[bool] = True
    learns_general: ClassVar[bool] = True
    moving_sensor: ClassVar[bool] = True
    map_options: ClassVar[frozenset[str]] = frozenset()
    """The options of the static memory, which general weights do not have."""

    def __init__(
        self, stream: StreamSpec, options: Any, network: StreamNetwork | None = None, place: SE2 | None = None
    ) -> None:
        """Loads the network from the site's weights unless `network` is passed, with the `place` of its maps.

        `place`: their `world_T_grid`; None: they lie in the first window of each stream. Raises WeightsError.
        """
        super().__init__(stream, options)
        self._place = place
        self.network = network or self._restored(load_weights(stream, registered_name(type(self))))
        self.reset(seed=0)

    @classmethod
    @abstractmethod
    def build(cls, size: int, options: Any, classes: int) -> RecurrentNetwork:
        """The untrained network for a grid of `size` cells a side."""

    @classmethod
    def prepare_training(cls, network: Any, device: str) -> Recurrence:
        """The Recurrence to train on a kind of `device` ("cpu", "cuda", ...): `network`, or a faster variant of it."""
        trained: Recurrence = network
        return trained

    @classmethod
    def prepare_inference(cls, network: Any, options: Any) -> InferenceNetwork:
        """The trained `network` for inference on its device, or a faster variant of it."""
        return InferenceNetwork(network)

    @classmethod
    def without_map(cls, options: Any, why: str, task: FitTask) -> Any:
        """The options of a training without one window for all frames, and `why`: without static memory."""
        return options

    @property
    def device(self) -> str:
        """The name of the device of the network."""
        return device_name(self.network.device)

    def reset(self, seed: int) -> None:
        """Set the state to h_0; nothing is random, so the seed is not used."""
        self.state: State = self.network.initial(1)
        self.network.anchor(Shift())
        self._updates = 0
        self._stamp_ns: int | None = None
        self._world_T_grid: SE2 | None = None

    def update(self, frame: GridFrame) -> None:
        """Update the state with the planes visible and occupied of x_t, in the window of this frame.

        A frame that a late tracker did not receive is a step without input, in which moving objects move on.
        """
        device = self.network.device
        x = input_planes(frame).to(device) if frame.visible.any() else None
        with torch.inference_mode():
            for _ in range(self._missed_before(frame.stamp_ns)):
                self._step(None)
            self._follow(frame.world_T_grid)
            self._step(x)
        wait_for(device)

    def _missed_before(self, stamp_ns: int) -> int:
        """The number of frames that were missed since the last one, MOST_MISSED at most; stores the stamp."""
        last_ns, self._stamp_ns = self._stamp_ns, stamp_ns
        if last_ns is None:
            return 0
        return min(MOST_MISSED, max(0, round((stamp_ns - last_ns) / 1e9 / self.stream.period_s) - 1))

    def _step(self, x: Tensor | None) -> None:
        self.state = self.network.step(x, self.state)
        self._updates += 1

    def _follow(self, world_T_grid: SE2) -> None:
        """Move the window to `world_T_grid`; the states and the maps stay at their places in the world."""
        if self._world_T_grid is None:
            self._world_T_grid, self._world_T_map = world_T_grid, self._place or world_T_grid
            self.network.anchor(self._shift(self._world_T_map, world_T_grid))
        shift = self._shift(self._world_T_grid, world_T_grid)
        if shift:
            self.state = self.network.rolled(self.state, shift, self._updates)
            self.network.anchor(self._shift(self._world_T_map, world_T_grid))
            self._world_T_grid = world_T_grid

    def _shift(self, before: SE2, after: SE2) -> Shift:
        return shift_between(before, after, self.stream.grid.cell_m)

    def predict(self, steps: int) -> Forecast:
        """Decode the state, and each state after it without input; the state itself is not changed."""
        with torch.inference_mode():
            state, decoded = self.state, [self._decoded(self.state)]
            for _ in range(steps):
                state = self.network.step(None, state)
                decoded.append(self._decoded(state))
            occupancy, semantics = zip(*decoded, strict=True)
            return Forecast(
                torch.cat(occupancy).cpu().numpy(),
                torch.cat(semantics).contiguous().cpu().numpy() if self.classes else None,
            )

    def export(self, folder: Path) -> str:
        """Write step and decoder as ONNX graphs. Raises ConfigurationError."""
        from gridtrack.trackers.recurrent.onnx_export import export_network

        return export_network(self, folder)

    @property
    def place_of_map(self) -> SE2 | None:
        """`world_T_grid` of the maps; None for a network without maps, which may run anywhere."""
        return self._place if any(is_map(bias) for bias in self.network.innermost.maps().values()) else None

    def manifest_entries(self) -> dict[str, Any]:
        """Entries of a manifest that the graphs do not contain. Raises ConfigurationError for an unsupported option."""
        return {}

    def _decoded(self, state: State) -> tuple[Tensor, Tensor | None]:
        """P(occupied) (1, M, M), and P(class) (1, K, M, M) if the tracker has classes."""
        occupancy = torch.sigmoid(self.network.occupancy(self.network.features(state)))
        logits = self.network.semantics(state) if self.classes else None
        return occupancy, None if logits is None else torch.softmax(logits, dim=1)

    def _restored(self, weights: Weights) -> StreamNetwork:
        """The trained network. Raises WeightsError if the weights do not fit it or contradict an option."""
        self._place = weights.card.map_pose
        options = trained_settings(self.stream, weights, self.options, running=InferenceSettings)
        self.classes = weights.card.classes
        network = self.build(self.stream.grid.size, options, len(self.classes))
        restore_network(network, self.stream, weights)
        return self.inference_for(network, self.stream, options)

    @classmethod
    def inference_for(cls, network: RecurrentNetwork, stream: StreamSpec, options: Any) -> StreamNetwork:
        """The trained `network` for the grids of `stream`; a network without maps adapts to their size.

        Raises ConfigurationError if torch does not have the device of the `options`.
        """
        device = inference_device(options.device)
        network.size = stream.grid.size
        pace = StepPace.of(stream.period_s, options.step_s)
        set_resolution(network, resolution_of(stream.grid.cell_m, pace.step_s(stream.period_s)))
        return paced(cls.prepare_inference(channels_last(network.eval().to(device)), options), pace)

    @classmethod
    def starts_from_general(cls, options: Any) -> bool:
        """A training at a site starts from the general network."""
        return True

    @classmethod
    def fit(cls, task: FitTask) -> None:
        """Train the network on `task.train` and write the weights that score best on `task.validation`.

        If it starts from general weights `task.start`, these are among the candidates.
        """
        from gridtrack.trackers.recurrent.fit import fit_network

        fit_network(cls, task)


def input_planes(frame: GridFrame) -> Tensor:
    """x_t: (1, 2, M, M) float32 of 0 and 1, visible and occupied, in channels-last memory."""
    cells = np.stack([frame.visible, frame.occupied], axis=2).astype(np.float32)
    return torch.from_numpy(cells).permute(2, 0, 1)[None]
