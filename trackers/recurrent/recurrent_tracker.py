"""Base of the recurrent trackers: frames update the latent state; a forecast is a series of updates without input."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from copy import deepcopy
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import torch
from torch import Tensor, nn

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, Shift, nearest_step, shift_between
from gridtrack.trackers.card import card_for
from gridtrack.trackers.contract import FitOutput, Forecast, FrameSource, Score, StreamSpec, Tracker, stream_of
from gridtrack.trackers.excerpts import SELECTION_HORIZONS_S, VALIDATED_S, excerpts_of_places
from gridtrack.trackers.recurrent.general_network import begin_from, general_options, settings_from_general
from gridtrack.trackers.recurrent.network import Float32Array, InferenceNetwork, LatentState, as_cells, channels_last
from gridtrack.trackers.recurrent.pacing import StepPace, paced
from gridtrack.trackers.recurrent.resolution_input import resolution_of, set_resolution
from gridtrack.trackers.recurrent.settings import InferenceSettings
from gridtrack.trackers.recurrent.unseen import rolled_state
from gridtrack.trackers.trained_network import restore, trained_settings
from gridtrack.trackers.weights import Weights, load_start, load_weights, save_interrupted, save_weights

if TYPE_CHECKING:
    from gridtrack.trackers.recurrent.sequences import SequenceDataset

MOST_MISSED = 20
"""Missed frames that are caught up on at a time: with all of them a network whose step takes longer than a period would
be later at every frame."""


class RecurrentTracker(Tracker):
    """A recurrent network as a tracker; a subclass sets `name` and builds the network."""

    name: ClassVar[str]
    learns: ClassVar[bool] = True
    learns_general: ClassVar[bool] = True
    moving_sensor: ClassVar[bool] = True

    def __init__(
        self, stream: StreamSpec, options: Any, network: InferenceNetwork | None = None, place: SE2 | None = None
    ) -> None:
        """Loads the network from the site's weights unless `network` is passed, with the `place` of its maps.

        `place`: their `world_T_grid`; None where it is not known: they then lie in the first window of each stream.
        Raises WeightsError.
        """
        super().__init__(stream, options)
        self._place = place
        self.network: Any = network or self._restored(load_weights(stream, self.name))
        self._buffers: tuple[Float32Array, ...] | None = None
        self.reset(seed=0)

    @classmethod
    @abstractmethod
    def build(cls, size: int, options: Any, classes: int) -> nn.Module:
        """The untrained network for a grid of `size` cells a side; see RecurrentNetwork."""

    @classmethod
    @abstractmethod
    def prepare_training(cls, network: Any, rate: float, device: str) -> Any:
        """Set the output bias to the occupied `rate`, and return the RecurrentNetwork that is trained on a `device`.

        It is the same function of the same parameters as `network`, computed faster. `device`: "cpu", "cuda", ...
        """

    @classmethod
    @abstractmethod
    def prepare_inference(cls, network: Any, options: Any) -> InferenceNetwork:
        """The InferenceNetwork: the same function as the trained `network`, computed faster."""

    @classmethod
    def without_map(cls, options: Any, why: str, out: FitOutput) -> Any:
        """The options of a training whose frames do not have one window, and `why`; most networks have no map of it."""
        return options

    def reset(self, seed: int) -> None:
        """Set the state to h_0; nothing is random, so the seed is not used."""
        self.state: LatentState = self.network.initial(1)
        self.network.anchor(Shift())
        self._updates = 0
        self._stamp_ns: int | None = None
        self._world_T_grid: SE2 | None = None

    def update(self, frame: GridFrame) -> None:
        """Update the state with the planes visible and occupied of x_t, in the window of this frame.

        A frame that a late tracker did not receive is a step without input, so that what moves has moved on since.
        """
        x = input_planes(frame) if frame.visible.any() else None
        with torch.inference_mode():
            for _ in range(self._missed_before(frame.stamp_ns)):
                self._step(None)
            self._follow(frame.world_T_grid)
            self._step(x)

    def _missed_before(self, stamp_ns: int) -> int:
        """The number of frames that were missed since the last one, MOST_MISSED at most; notes the stamp."""
        last_ns, self._stamp_ns = self._stamp_ns, stamp_ns
        if last_ns is None:
            return 0
        return min(MOST_MISSED, max(0, round((stamp_ns - last_ns) / 1e9 / self.stream.period_s) - 1))

    def _step(self, x: Tensor | None) -> None:
        self.state = self.network.step(x, self.state)
        self._updates += 1

    def _follow(self, world_T_grid: SE2) -> None:
        """Move the window to `world_T_grid`, before a step: the states and the maps stay at their places in the world.

        The rolled states are in the same memory every time where a step makes all of the state anew: it does not
        change its input.
        """
        if self._world_T_grid is None:
            self._world_T_grid, self._world_T_map = world_T_grid, self._place or world_T_grid
            self.network.anchor(self._shift(self._world_T_map, world_T_grid))
        shift = self._shift(self._world_T_grid, world_T_grid)
        if shift:
            if self._buffers is None and len(self.network.current(self.state)) == len(self.state):
                self._buffers = tuple(np.empty_like(as_cells(h)) for h in self.state)
            self.state = rolled_state(self.state, shift, self.network.unseen(self._updates), self._buffers)
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
                torch.cat(occupancy).numpy(),
                torch.cat(semantics).contiguous().numpy() if self.classes else None,
            )

    def _decoded(self, state: LatentState) -> tuple[Tensor, Tensor | None]:
        """P(occupied) (1, M, M), and P(class) (1, K, M, M) where the tracker has classes."""
        features = self.network.features(state)
        occupancy = torch.sigmoid(self.network.occupancy(features))
        return occupancy, torch.softmax(self.network.semantics(state), dim=1) if self.classes else None

    def _restored(self, weights: Weights) -> InferenceNetwork:
        """The trained network. Raises WeightsError where the weights do not fit it or contradict an option."""
        self._place = weights.card.map_pose
        options = trained_settings(self.stream, weights, self.options, running=InferenceSettings)
        self.classes = weights.card.classes
        network = self.build(self.stream.grid.size, options, len(self.classes))
        restore(network, self.stream, weights)
        return self.inference_for(network, self.stream, options)

    @classmethod
    def inference_for(cls, network: Any, stream: StreamSpec, options: Any) -> InferenceNetwork:
        """The InferenceNetwork of the trained `network` for the grids of `stream`, whose size a network without maps
        takes on.
        """
        network.size = stream.grid.size
        pace = StepPace.of(stream.period_s, options.step_s)
        set_resolution(network, resolution_of(stream.grid.cell_m, pace.step_s(stream.period_s)))
        return paced(cls.prepare_inference(channels_last(network.eval()), options), pace)

    @classmethod
    def starts_from_general(cls, options: Any) -> bool:
        """A training at a site starts from the general network."""
        return True

    @classmethod
    def fit(
        cls,
        train: Sequence[FrameSource],
        validation: Sequence[FrameSource],
        score: Score,
        out: FitOutput,
        options: Any,
    ) -> None:
        """Train the network on `train` and write the weights that score best on `validation`.

        From general weights `out.start` these are among the candidates.
        """
        from gridtrack.trackers.recurrent.devices import training_device
        from gridtrack.trackers.recurrent.precision import training_precision
        from gridtrack.trackers.recurrent.sequences import SequenceDataset
        from gridtrack.trackers.recurrent.training import train_network, validation_scores

        start = None if out.start is None else load_start(out.start, cls.name)
        options = options if start is None else settings_from_general(options, start)
        if out.general:
            options = general_options(options)
        dataset = SequenceDataset(train, options, out.seed, step_s=options.step_s, general=out.general)
        options = cls._for_windows_of(dataset, options, out)
        options = options.model_copy(update={"precision": training_precision(options, out)})
        torch.manual_seed(out.seed)
        network = cls.build(dataset.size, options, classes=0)
        in_training = cls.prepare_training(network, dataset.occupied_rate, training_device())
        if start is not None:
            begin_from(network, start)
        held_out = excerpts_of_places(validation, VALIDATED_S) if out.general else validation

        def validate(trained: nn.Module) -> dict[str, float]:
            def score_on(source: FrameSource) -> Any:
                stream, steps = stream_of(source), nearest_step(max(SELECTION_HORIZONS_S), source.period_s)
                inference = cls.inference_for(deepcopy(trained).cpu(), stream, options)
                return score(cls(stream, options, inference, dataset.first_window), source, steps)

            return validation_scores(score_on, held_out, SELECTION_HORIZONS_S)

        trained = train_network(network, in_training, dataset, options, validate, out, start)
        arrays = {name: value.detach().contiguous().numpy() for name, value in network.state_dict().items()}
        settings = options.model_dump(mode="json", exclude=set(InferenceSettings.model_fields))
        card = card_for(cls.name, out, train, validation, settings, trained.scores)
        if trained.reached:
            save_interrupted(out.path, card, arrays, trained.reached)
            raise KeyboardInterrupt
        save_weights(out.path, card, arrays)

    @classmethod
    def _for_windows_of(cls, dataset: SequenceDataset, options: Any, out: FitOutput) -> Any:
        """The options for these windows: without maps where they differ, and for general weights."""
        if out.general:
            return cls.without_map(options, "general weights know no place", out)
        if not dataset.has_one_window:
            return cls.without_map(options, "the windows of the training frames differ", out)
        return options


def input_planes(frame: GridFrame) -> Tensor:
    """x_t: (1, 2, M, M) float32 of 0 and 1, visible and occupied, in channels-last memory."""
    cells = np.stack([frame.visible, frame.occupied], axis=2).astype(np.float32)
    return torch.from_numpy(cells).permute(2, 0, 1)[None]
