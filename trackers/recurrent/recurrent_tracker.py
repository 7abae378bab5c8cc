"""Base of the recurrent trackers: frames update the latent state; a forecast is a series of updates without input."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, Shift
from gridtrack.trackers.contract import Forecast
from gridtrack.trackers.recurrent.inference import InferenceNetwork, is_map
from gridtrack.trackers.recurrent.network import State
from gridtrack.trackers.recurrent.network_tracker import NetworkTracker
from gridtrack.trackers.recurrent.pacing import PacedNetwork, StepPace
from gridtrack.trackers.training.device import wait_for


class RecurrentTracker(NetworkTracker):
    """A recurrent network as a tracker; a subclass has `Options`, and builds the network."""

    network: PacedNetwork

    @classmethod
    def prepare_inference(cls, network: Any, options: Any) -> InferenceNetwork:
        """The trained `network` for inference on its device, or a faster variant of it."""
        return InferenceNetwork(network)

    def reset(self, seed: int) -> None:
        """Set the state to h_0; nothing is random, so the seed is not used."""
        super().reset(seed)
        self.state: State = self.network.initial()
        self.network.anchor(Shift())
        self._updates = 0

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
        occupancy = torch.sigmoid(self.network.occupancy(state))
        logits = self.network.semantics(state) if self.classes else None
        return occupancy, None if logits is None else torch.softmax(logits, dim=1)

    @classmethod
    def at_pace(cls, network: Any, pace: StepPace, options: Any) -> PacedNetwork:
        """The `network` at this pace, or a faster variant of it."""
        return PacedNetwork(cls.prepare_inference(network, options), pace)


def input_planes(frame: GridFrame) -> Tensor:
    """x_t: (1, 2, M, M) float32 of 0 and 1, visible and occupied, in channels-last memory."""
    cells = np.stack([frame.visible, frame.occupied], axis=2).astype(np.float32)
    return torch.from_numpy(cells).permute(2, 0, 1)[None]
