"""A recurrent network as a tracker: the latent state follows the frames; a forecast is updates with empty input."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from copy import deepcopy
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor, nn

from gridtrack.common.grid import GridFrame
from gridtrack.trackers.contract import FitOutput, Forecast, FrameSource, Score, StreamSpec, Tracker, stream_of
from gridtrack.trackers.recurrent.network import LatentState, RecurrentNetwork, channels_last
from gridtrack.trackers.recurrent.settings import InferenceSettings
from gridtrack.trackers.restoring import restore, trained_settings
from gridtrack.trackers.weights import Weights, card_for, load_weights, save_weights

VALIDATION_HORIZONS_S = (0.5, 1.0, 2.0)


class RecurrentTracker(Tracker):
    """Base of the recurrent trackers; a subclass names itself and builds its network."""

    name: ClassVar[str]
    learns: ClassVar[bool] = True

    def __init__(self, stream: StreamSpec, options: Any, network: RecurrentNetwork | None = None) -> None:
        """Without a `network`, the one of the site's weights. Raises WeightsError."""
        super().__init__(stream, options)
        self.network: Any = network or self._restored(load_weights(stream, self.name))
        self.state: LatentState = self.network.initial(1)

    @classmethod
    @abstractmethod
    def build(cls, size: int, options: Any, classes: int) -> nn.Module:
        """The untrained network for a grid of `size` cells a side; see RecurrentNetwork."""

    @classmethod
    @abstractmethod
    def prepare_training(cls, network: Any, rate: float) -> Any:
        """Set the output bias to the occupied `rate`; returns what is trained in place of `network` on a processor.

        That is a RecurrentNetwork, the same function of the same parameters, faster.
        """

    @classmethod
    @abstractmethod
    def prepare_inference(cls, network: Any, options: Any) -> RecurrentNetwork:
        """What follows a stream in place of the trained `network`: the same function, faster."""

    def reset(self, seed: int) -> None:
        """h_0; the network draws nothing, so the seed does not matter."""
        self.state = self.network.initial(1)

    def update(self, frame: GridFrame) -> None:
        """One step of the network on (visible, occupied)."""
        x = planes(frame) if frame.visible.any() else None
        with torch.inference_mode():
            self.state = self.network.step(x, self.state)

    def predict(self, steps: int) -> Forecast:
        """Steps with empty input from a copy of the state, every one decoded."""
        with torch.inference_mode():
            state, decoded = self.state, [self._decoded(self.state)]
            for _ in range(steps):
                state = self.network.step(None, state)
                decoded.append(self._decoded(state))
            occupancy, semantics = zip(*decoded, strict=True)
            return Forecast(
                torch.cat(occupancy).numpy(),
                torch.cat(semantics).contiguous().numpy() if self.classes else None,
            )

    def _decoded(self, state: LatentState) -> tuple[Tensor, Tensor | None]:
        """P(occupied) (1, M, M), and P(class) (1, K, M, M) where it gives classes."""
        features = self.network.features(state)
        occupancy = torch.sigmoid(self.network.occupancy(features))
        return occupancy, torch.softmax(self.network.semantics(features), dim=1) if self.classes else None

    def _restored(self, weights: Weights) -> RecurrentNetwork:
        """The trained network. Raises WeightsError where the weights do not fit it, or contradict a given option."""
        options = trained_settings(self.stream, weights, self.options, running=InferenceSettings)
        self.classes = weights.card.classes
        network = self.build(self.stream.grid.size, options, len(self.classes))
        restore(network, self.stream, weights)
        return self.prepare_inference(channels_last(network.eval()), options)

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
        on_processor = cls.prepare_training(network, occupied_rate(dataset.stretches))
        steps = round(max(VALIDATION_HORIZONS_S) / train[0].period_s)

        def validate(trained: nn.Module) -> dict[str, float]:
            following = cls.prepare_inference(channels_last(deepcopy(trained).cpu().eval()), options)

            def as_tracker(source: FrameSource) -> Any:
                return score(cls(stream_of(source), options, following), source, steps)

            return validation_scores(as_tracker, validation, VALIDATION_HORIZONS_S)

        results = train_network(network, on_processor, dataset, options, validate, out)
        arrays = {name: value.detach().contiguous().numpy() for name, value in network.state_dict().items()}
        settings = options.model_dump(mode="json", exclude=set(InferenceSettings.model_fields))
        save_weights(out.path, card_for(cls.name, out, train, validation, settings, results), arrays)


def planes(frame: GridFrame) -> Tensor:
    """x_t: (1, 2, M, M) float32 of 0 and 1, visible and occupied, in channels-last memory."""
    cells = np.stack([frame.visible, frame.occupied], axis=2).astype(np.float32)
    return torch.from_numpy(cells).permute(2, 0, 1)[None]
