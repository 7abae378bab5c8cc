"""Base of the trackers that are a network: its weights, their training, and what a stream's frames have in common."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar

from gridtrack.common.config import Settings
from gridtrack.common.geometry import SE2
from gridtrack.common.grid import Shift, shift_between
from gridtrack.trackers.contract import FitTask, StreamSpec, Tracker
from gridtrack.trackers.recurrent.network import (
    Network,
    TrainedNetwork,
    channels_last,
    resolution_of,
    set_resolution,
)
from gridtrack.trackers.recurrent.pacing import StepPace
from gridtrack.trackers.recurrent.settings import InferenceSettings
from gridtrack.trackers.registry import registered_name
from gridtrack.trackers.training.device import device_name, inference_device
from gridtrack.trackers.training.networks import restore_network, trained_settings
from gridtrack.trackers.training.weights import Weights, load_weights

MOST_MISSED = 20
"""Largest number of missed frames for which steps are made at once: a network with steps longer than a period would
otherwise fall further behind with every frame."""


class NetworkTracker(Tracker):
    """A network as a tracker; a subclass has `Options`, builds the network and prepares it for a stream."""

    learns: ClassVar[bool] = True
    learns_general: ClassVar[bool] = True
    moving_sensor: ClassVar[bool] = True
    map_options: ClassVar[frozenset[str]] = frozenset()
    """The options of the static memory, which general weights do not have."""
    running: ClassVar[type[Settings]] = InferenceSettings
    """The settings of inference, which a card does not have."""

    def __init__(self, stream: StreamSpec, options: Any, network: Any = None, place: SE2 | None = None) -> None:
        """Loads the network from the site's weights unless one `inference_for` the stream is passed.

        `place`: the `world_T_grid` of its maps; None: they lie in the first window of each stream. Raises WeightsError.
        """
        super().__init__(stream, options)
        self._place = place
        self.network = network or self._restored(load_weights(stream, registered_name(type(self))))
        self.reset(seed=0)

    @classmethod
    @abstractmethod
    def build(cls, size: int, options: Any, classes: int) -> Network:
        """The untrained network for a grid of `size` cells a side."""

    @classmethod
    @abstractmethod
    def at_pace(cls, network: Any, pace: StepPace, options: Any) -> Any:
        """The trained `network`, on its device, at the pace of a stream."""

    @classmethod
    def inference_for(cls, network: Any, stream: StreamSpec, options: Any) -> Any:
        """The trained `network` for the grids of `stream`; a network without maps adapts to their size.

        Raises ConfigurationError if torch does not have the device of the `options`.
        """
        device = inference_device(options.device)
        network.size = stream.grid.size
        pace = StepPace.of(stream.period_s, options.step_s)
        set_resolution(network, resolution_of(stream.grid.cell_m, pace.step_s(stream.period_s)))
        return cls.at_pace(channels_last(network.eval().to(device)), pace, options)

    @property
    def device(self) -> str:
        """The name of the device of the network."""
        return device_name(self.network.device)

    @classmethod
    def prepare_training(cls, network: Any, device: str) -> TrainedNetwork:
        """What is trained on a kind of `device` ("cpu", "cuda", ...): `network`, or a faster variant of it."""
        trained: TrainedNetwork = network
        return trained

    @classmethod
    def without_map(cls, options: Any, why: str, task: FitTask) -> Any:
        """The options of a training without one window for all frames, and `why`: without static memory."""
        return options

    def reset(self, seed: int) -> None:
        """Forget the last stamp and window."""
        self._stamp_ns: int | None = None
        self._world_T_grid: SE2 | None = None

    def _missed_before(self, stamp_ns: int) -> int:
        """The number of frames that were missed since the last one, MOST_MISSED at most; stores the stamp."""
        last_ns, self._stamp_ns = self._stamp_ns, stamp_ns
        if last_ns is None:
            return 0
        return min(MOST_MISSED, max(0, round((stamp_ns - last_ns) / 1e9 / self.stream.period_s) - 1))

    def _shift(self, before: SE2, after: SE2) -> Shift:
        return shift_between(before, after, self.stream.grid.cell_m)

    def _restored(self, weights: Weights) -> Any:
        """The trained network. Raises WeightsError if the weights do not fit it or contradict an option."""
        self._place = weights.card.map_pose
        options = trained_settings(self.stream, weights, self.options, running=self.running)
        self.classes = weights.card.classes
        network = self.build(self.stream.grid.size, options, len(self.classes))
        restore_network(network, self.stream, weights)
        return self.inference_for(network, self.stream, options)

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
