"""A recurrent network as a tracker: the latent state follows the frames; a forecast is updates with empty input."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
import torch
from torch import nn

from gridtrack.common.grid import GridFrame
from gridtrack.trackers.contract import FitOutput, Forecast, FrameSource, Score, StreamSpec, Tracker, stream_of
from gridtrack.trackers.recurrent.network import State, channels_last
from gridtrack.trackers.restoring import restore, trained_settings
from gridtrack.trackers.weights import Weights, card_for, load_weights, save_weights

VALIDATION_HORIZONS_S = (0.5, 1.0, 2.0)


class RecurrentTracker(Tracker):
    """Base of the recurrent trackers; a subclass names itself and builds its network."""

    name: ClassVar[str]
    learns: ClassVar[bool] = True

    def __init__(self, stream: StreamSpec, options: Any, network: nn.Module | None = None) -> None:
        """Without a `network`, the one of the site's weights. Raises WeightsError."""
        super().__init__(stream, options)
        if network is None:
            network = self._restored(load_weights(stream, self.name))
        self.network = channels_last(network)
        self.state: State = self.network.initial(1)

    @classmethod
    @abstractmethod
    def build(cls, size: int, options: Any, classes: int) -> nn.Module:
        """The untrained network for a grid of `size` cells a side; see RecurrentNetwork."""

    @classmethod
    @abstractmethod
    def prepare_training(cls, network: Any, rate: float) -> None:
        """Last touches before training: output bias at the occupied `rate`, fused kernels."""

    @classmethod
    @abstractmethod
    def prepare_inference(cls, network: Any) -> None:
        """Last touches before a trained network follows a stream: fused kernels."""

    def reset(self, seed: int) -> None:
        """h_0; the network draws nothing, so the seed does not matter."""
        self.state = self.network.initial(1)

    def update(self, frame: GridFrame) -> None:
        """One step of the network on (visible, occupied)."""
        planes = np.stack([frame.visible, frame.occupied]).astype(np.float32)[None] if frame.visible.any() else None
        with torch.inference_mode():
            x = None if planes is None else torch.from_numpy(planes).contiguous(memory_format=torch.channels_last)
            self.state = self.network.step(x, self.state)

    def predict(self, steps: int) -> Forecast:
        """Steps with empty input from a copy of the state, every one decoded."""
        state, features = self.state, [self.network.features(self.state)]
        with torch.inference_mode():
            for _ in range(steps):
                state = self.network.step(None, state)
                features.append(self.network.features(state))
            stacked = torch.cat(features)
            occupancy = torch.sigmoid(self.network.occupancy(stacked))
            semantics = self.network.semantics(stacked) if self.classes else None
            return Forecast(
                occupancy.numpy(),
                None if semantics is None else torch.softmax(semantics, dim=1).contiguous().numpy(),
            )

    def _restored(self, weights: Weights) -> nn.Module:
        """The trained network. Raises WeightsError where the weights do not fit it, or contradict a given option."""
        options = trained_settings(self.stream, weights, self.options)
        self.classes = weights.card.classes
        network = self.build(self.stream.grid.size, options, len(self.classes))
        restore(network, self.stream, weights)
        self.prepare_inference(network)
        return network.eval()

    @classmethod
    def fit(
        cls,
        train: Sequence[FrameSource],
        validation: Sequence[FrameSource],
        score: Score,
        out: FitOutput,
        options: Any,
    ) -> None:
        """Train the network on `train`, keep what scores best on `validation`, and write its weights."""
        from gridtrack.trackers.recurrent.sequences import SequenceDataset, occupied_rate
        from gridtrack.trackers.recurrent.training import train_network, validation_scores

        torch.manual_seed(out.seed)
        dataset = SequenceDataset(train, options.length, out.seed, reverse=options.reverse, superpose=options.superpose)
        network = cls.build(train[0].grid.size, options, classes=0)
        cls.prepare_training(network, occupied_rate(dataset.stretches))
        steps = round(max(VALIDATION_HORIZONS_S) / train[0].period_s)

        def validate(trained: nn.Module) -> dict[str, float]:
            def as_tracker(source: FrameSource) -> Any:
                return score(cls(stream_of(source), options, trained), source, steps)

            return validation_scores(as_tracker, validation, VALIDATION_HORIZONS_S)

        results = train_network(network, dataset, options, validate, out)
        arrays = {name: value.detach().contiguous().numpy() for name, value in network.state_dict().items()}
        settings = options.model_dump(mode="json")
        save_weights(out.path, card_for(cls.name, out, train, validation, settings, results), arrays)
