"""The tracker `dilated-convgru`: occupancy, and classes if its weights have a class decoder."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, ClassVar

import torch

from gridtrack.common.errors import ConfigurationError, WeightsError
from gridtrack.common.grid import GridFrame
from gridtrack.trackers.contract import FitTask, Forecast
from gridtrack.trackers.recurrent.dilated_convgru import DilatedConvGRU
from gridtrack.trackers.recurrent.inference import InferenceNetwork
from gridtrack.trackers.recurrent.kernels.convgru import INFERENCE, TRAINING
from gridtrack.trackers.recurrent.network import Recurrence
from gridtrack.trackers.recurrent.recurrent_tracker import RecurrentTracker
from gridtrack.trackers.recurrent.seen_cells import PREFIX, SeenCells, seen_cells_of
from gridtrack.trackers.recurrent.settings import GATES, DilatedConvGRUOptions
from gridtrack.trackers.training.weights import Weights, read_card


class DilatedConvGRUTracker(RecurrentTracker):
    """The dilated ConvGRU with static memory (Ondruska et al., 2016)."""

    Options: ClassVar[type[DilatedConvGRUOptions]] = DilatedConvGRUOptions
    map_options = frozenset({"static_gates"})

    _seen: SeenCells | None = None
    _frame: GridFrame | None = None

    def reset(self, seed: int) -> None:
        """Set the state to h_0, before the first frame."""
        super().reset(seed)
        self._frame = None

    def update(self, frame: GridFrame) -> None:
        """Update the state with x_t."""
        super().update(frame)
        self._frame = frame

    def predict(self, steps: int) -> Forecast:
        """Decode the state and those after it; the option `evidence` is for the classes of cells occupied now."""
        forecast = super().predict(steps)
        if self._seen is not None and self._frame is not None and forecast.semantics is not None:
            with torch.inference_mode():
                self._seen.apply_to(forecast.semantics[0], self._frame, self.options.evidence)
        return forecast

    def manifest_entries(self) -> dict[str, Any]:
        """The power of the class probabilities of cells that are occupied now, for `evidence=state`."""
        if self._scan_is_given:
            raise ConfigurationError("evidence=scan has a classifier of scans, which is not exported: leave it out")
        if self._seen is None:
            return {}
        return {"class_power_in_occupied_cells": round(float(self._seen.state_alone[0]), 6)}

    @property
    def _scan_is_given(self) -> bool:
        """Whether the user, and not the default, asks for the classifier of scans."""
        return self.options.evidence == "scan" and "evidence" in self.options.model_fields_set

    def _restored(self, weights: Weights) -> Any:
        of_network = {name: value for name, value in weights.arrays.items() if not name.startswith(PREFIX)}
        network = super()._restored(replace(weights, arrays=of_network))
        self._seen = seen_cells_of(weights, self.stream)
        if self._seen is None and self._scan_is_given:
            raise WeightsError(
                f"{self.stream.weights}: no classifier of scans for evidence=scan: train again with stage=classes"
            )
        return network

    @classmethod
    def build(cls, size: int, options: Any, classes: int) -> DilatedConvGRU:
        """The untrained network."""
        return DilatedConvGRU(size, options, classes, options.class_hidden, options.decoded_layers)

    @classmethod
    def without_map(cls, options: Any, why: str, task: FitTask) -> Any:
        """The options without static memory, which has the cells of one window.

        Raises ConfigurationError if the user set it.
        """
        if not options.static_gates:
            return options
        if "static_gates" in options.model_fields_set:
            raise ConfigurationError(
                f"{why}, and static memory has the cells of one window: train with static_gates=[]"
            )
        task.report(f"{why}: trained without static memory (static_gates=[])")
        return options.model_copy(update={"static_gates": ()})

    @classmethod
    def prepare_training(cls, network: Any, device: str) -> Recurrence:
        """A variant of `kernels`, for a network with gates."""
        has_gates = network.layers[0].gates == GATES
        trained: Recurrence = TRAINING[device](network) if has_gates and device in TRAINING else network
        return trained

    @classmethod
    def prepare_inference(cls, network: Any, options: Any) -> InferenceNetwork:
        """A variant of `kernels`; a network without gates, or on another device than a processor, computes as it was
        trained.

        Raises ConfigurationError for such a network in bfloat16.
        """
        has_gates, device = network.layers[0].gates == GATES, network.output_bias.device.type
        if has_gates and device == "cpu":
            return INFERENCE[options.inference](network)
        if options.inference != "float32":
            found = f"the device is {device}" if has_gates else "this network has cell=plain"
            raise ConfigurationError(f"inference={options.inference} needs cell=gru on device=cpu; {found}")
        return super().prepare_inference(network, options)

    @classmethod
    def starts_from_general(cls, options: Any) -> bool:
        """Only the network starts from general weights, not a class decoder for existing weights (`stage=classes`)."""
        return bool(options.stage != "classes")

    @classmethod
    def fit(cls, task: FitTask) -> None:
        """Train the network on visible cells and then, if the recording has classes, its class decoder on labels."""
        from gridtrack.trackers.recurrent.transfer import fit_class_decoder

        stage = task.options.stage
        if stage != "classes":
            super().fit(task)
        if stage == "classes" or (stage == "both" and any(source.classes for source in task.train)):
            fit_class_decoder(cls, task)
        elif task.start is not None and read_card(task.start).classes:
            task.report(
                "without classes: the class decoder of the general weights is left out, it reads their network only"
            )
