"""The tracker `dilated-convgru`: occupancy, and classes where the site's weights have a class decoder."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, cast

from torch import nn

from gridtrack.common.errors import ConfigurationError
from gridtrack.trackers.contract import FitOutput, FrameSource, Score
from gridtrack.trackers.recurrent.dilated_convgru import DilatedConvGRU
from gridtrack.trackers.recurrent.inference import InferenceConvGRU
from gridtrack.trackers.recurrent.network import RecurrentNetwork, start_from_rate
from gridtrack.trackers.recurrent.recurrent_tracker import RecurrentTracker
from gridtrack.trackers.recurrent.settings import GATES, DilatedConvGRUOptions
from gridtrack.trackers.recurrent.training_convgru import TrainingConvGRU


class DilatedConvGRUTracker(RecurrentTracker):
    """The dilated ConvGRU with static memory (Ondruska et al., 2016)."""

    name = "dilated-convgru"
    Options: ClassVar[type[DilatedConvGRUOptions]] = DilatedConvGRUOptions

    @classmethod
    def build(cls, size: int, options: Any, classes: int) -> nn.Module:
        """The untrained network."""
        return DilatedConvGRU(size, options, classes, options.class_hidden)

    @classmethod
    def prepare_training(cls, network: Any, rate: float) -> Any:
        """Set the output bias to the occupied rate; the gates and their gradient are one pass over memory."""
        start_from_rate(network.decode_occupancy, rate)
        return TrainingConvGRU(network) if network.layers[0].gates == GATES else network

    @classmethod
    def prepare_inference(cls, network: Any, options: Any) -> RecurrentNetwork:
        """Convolutions and gates in bands of rows; a network without gates is returned unchanged.

        Raises ConfigurationError for a network without gates in bfloat16.
        """
        if network.layers[0].gates == GATES:
            return InferenceConvGRU(network, bfloat16=options.inference == "bfloat16")
        if options.inference != "float32":
            raise ConfigurationError(f"inference={options.inference} needs cell=gru; this network has cell=plain")
        return cast(RecurrentNetwork, network)

    @classmethod
    def fit(
        cls,
        train: Sequence[FrameSource],
        validation: Sequence[FrameSource],
        score: Score,
        out: FitOutput,
        options: Any,
    ) -> None:
        """Train the network on visible cells and then, if the recording has classes, its class decoder on labels."""
        from gridtrack.trackers.recurrent.transfer import fit_class_decoder

        if options.stage != "classes":
            super().fit(train, validation, score, out, options)
        if options.stage == "classes" or (options.stage == "both" and train[0].classes):
            fit_class_decoder(cls, train, validation, out, options)
