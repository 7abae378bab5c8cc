"""The tracker `deep-tracking-rnn`: occupancy."""

from __future__ import annotations

from typing import Any, ClassVar

from torch import nn

from gridtrack.trackers.recurrent.deep_tracking_rnn import DeepTrackingRNN
from gridtrack.trackers.recurrent.inference import InferenceRNN
from gridtrack.trackers.recurrent.network import InferenceNetwork, start_from_rate
from gridtrack.trackers.recurrent.recurrent_tracker import RecurrentTracker
from gridtrack.trackers.recurrent.settings import DeepTrackingRNNOptions
from gridtrack.trackers.recurrent.training_rnn import TrainingRNN


class DeepTrackingRNNTracker(RecurrentTracker):
    """The original Deep Tracking RNN (Ondruska and Posner, 2016)."""

    Options: ClassVar[type[DeepTrackingRNNOptions]] = DeepTrackingRNNOptions

    @classmethod
    def build(cls, size: int, options: Any, classes: int) -> nn.Module:
        """The untrained network; it has no classes."""
        return DeepTrackingRNN(size, options)

    @classmethod
    def prepare_training(cls, network: Any, rate: float, device: str) -> Any:
        """Set the output bias to the occupied rate; the empty input is convolved once a sequence."""
        start_from_rate(network.decode, rate)
        return TrainingRNN(network)

    @classmethod
    def prepare_inference(cls, network: Any, options: Any) -> InferenceNetwork:
        """The convolution of the empty input is computed in advance."""
        return InferenceRNN(network)
