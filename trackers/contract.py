"""The plugin contract: the inputs of a tracker, its methods, and the forecast that it returns."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.config import Settings
from gridtrack.common.errors import ConfigurationError
from gridtrack.common.grid import GridFrame, GridSpec, LabelledFrame
from gridtrack.trackers.training.progress import Progress

API = 2
"""The version of this contract, in which `fit` takes one FitTask."""
API_WITHOUT_FIT = 1
"""The version before, which differs in `fit` only."""
MAX_FUTURES = 64
"""The most sampled futures of one forecast; it bounds the size of an answer before memory is allocated."""
Role = Literal["tracker", "floor", "recorded"]
"""The role of a row in a comparison: a tracker, a floor, which every tracker must beat, or forecasts from a file."""
ComparedPart = Literal["occupancy", "classes"]
"""The part of their forecasts by which two rows are compared."""


@dataclass(frozen=True, slots=True)
class StreamSpec:
    """The properties of a stream, known before its first frame.

    `grid` and `period_s` of the stream, its `site`, and the `classes` that its labels name. `weights`: the card
    (`.toml`, its arrays in the `.safetensors` beside it) that the `fit` of this tracker wrote for the site or, without
    one, for any place; or None. `weights_sha256`: the hash of the card, which `load_weights` checks; "" if it is not
    known. `velocity_scored`: whether the velocities of forecasts are scored; if not, a tracker may save their time.
    """

    grid: GridSpec
    period_s: float
    site: str = ""
    classes: tuple[str, ...] = ()
    weights: Path | None = None
    weights_sha256: str = ""
    velocity_scored: bool = False


@dataclass(frozen=True, slots=True)
class TrackedObject:
    """One object of a forecast, at step 0, in the grid frame of the last update.

    `box` (5,): x, y, heading, length along it, width (metres, radians). `velocity` (2,) m/s and `covariance` (4, 4) of
    (x, y, vx, vy): of the tracked point, which may be another one than the centre of the box. `label`: the name of a
    class, "" if unknown. `track`: the identity over time.
    """

    track: int
    box: NDArray[np.float32]
    velocity: NDArray[np.float32]
    covariance: NDArray[np.float32]
    label: str = ""


@dataclass(frozen=True, slots=True)
class Forecast:
    """P(occupied) for steps 0..n in the grid frame of the last update.

    `occupancy` (n+1, M, M) float32 in [0, 1]; `semantics` (n+1, K, M, M) float32 summing to 1 over the tracker's K
    classes, or None; `objects`, if the tracker has any.

    `velocity` (n+1, 2, M, M) float32 or float16, or None: x and y, m/s, along the axes of the grid and so of the world,
    of the object that would occupy a cell at a step; (2, M, M) is step 0 alone. NaN: no velocity.

    `futures` (F, n+1, M, M), or None: F sampled futures, 2 to MAX_FUTURES, equally probable and drawn jointly over
    cells and steps; bool, or P(occupied) in [0, 1] as float16. `occupancy` is their mean for a large F.
    A tracker gives futures in all of its forecasts or in none.

    >>> Forecast(np.zeros((11, 100, 100), np.float32)).occupancy.max()  # free cells for 10 steps
    np.float32(0.0)
    """

    occupancy: NDArray[np.float32]
    semantics: NDArray[np.float32] | None = None
    velocity: NDArray[np.floating] | None = None
    objects: tuple[TrackedObject, ...] = ()
    futures: NDArray[np.bool_] | NDArray[np.float16] | None = None


class FrameSource(Protocol):
    """A stretch of a recording as frames of one fixed period; every iteration starts at its first frame."""

    name: str
    """Recording and stretch, for messages: `demo.mcap@0s-75s`."""
    sha256: str
    """Hash of the recording file."""
    grid: GridSpec
    period_s: float
    site: str
    classes: tuple[str, ...]

    def __iter__(self) -> Iterator[GridFrame]: ...

    def __len__(self) -> int: ...

    def labelled(self) -> Iterator[LabelledFrame]:
        """The same frames with the classes of their occupied cells, for `fit`; most recordings have none."""
        ...


def stream_of(source: FrameSource, weights: Path | None = None) -> StreamSpec:
    """The stream of `source`, for a tracker with these `weights`."""
    return StreamSpec(source.grid, source.period_s, source.site, source.classes, weights)


@dataclass(frozen=True, slots=True)
class StretchScore:
    """The scores of one tracker on one stretch, each (steps+1,): NaN where undefined."""

    f1: dict[str, NDArray[np.float64]]
    """By stratum, at the best threshold of each step."""
    log_loss: dict[str, NDArray[np.float64]]
    """By stratum, nats."""
    contacts_foreseen: NDArray[np.float64]
    """Share of a robot's contacts within so many steps, at 5 % false alarms; NaN except at 0.5, 1 and 2 s."""


class Objective(Protocol):
    """The host's score of a tracker, by which `fit` selects: `task.objective(tracker, source, steps)`."""

    def __call__(self, tracker: Tracker, source: FrameSource, steps: int, /) -> StretchScore:
        """Reset the tracker, stream the source through it, and score its forecasts of 0 to `steps` steps.

        The source is a stretch of the FitTask, or consecutive frames of one with their stamps. Raises RecordingError
        for another source.
        """
        ...


@dataclass(frozen=True, slots=True)
class FitTask:
    """The input of one training: `Tracker.fit` learns from it and writes the card `out`.

    `train` and `validation`: stretches of recordings, each a stream of GridFrames with planes (M, M); no frame is in
    both. `options`: an instance of the tracker's Options. An example that counts the occupied rate of each cell:

        @classmethod
        def fit(cls, task: FitTask) -> None:
            frames = [frame for source in task.train for frame in source]
            rate = np.mean([frame.occupied for frame in frames], axis=0)  # (M, M)
            save_weights(task.out, card_for("my-tracker", task, {}), {"rate": rate})
    """

    train: Sequence[FrameSource]
    """The stretches to learn from."""
    validation: Sequence[FrameSource]
    """The stretches to select by; `fit` must not learn from them."""
    objective: Objective
    """The host's score of a tracker on one of these stretches."""
    out: Path
    """The card to write (`.toml`, its arrays in the `.safetensors` beside it)."""
    options: Any
    log_dir: Path
    """Folder for logs and checkpoints; a second call with the same folder resumes."""
    seed: int = 0
    command: str = ""
    """The command line of the training, for the card."""
    general: bool = False
    """Learn for any place: from recordings of many sites, grids and periods, and nothing of a place."""
    start: Path | None = None
    """The card of the general weights to start from, if the tracker `starts_from_general`; None: from scratch."""
    device: str = "auto"
    """Kind of torch device to train on, such as `cpu` or `cuda`; `auto`: an accelerator if there is one."""
    report: Callable[[str], None] = print
    """Prints one line for the user."""
    progress: Progress = field(default_factory=Progress)
    """The stages of the training; the host prints their rate and the time left every few seconds."""


class Tracker(ABC):
    """A tracker: it is updated with one grid frame at a time, and forecasts the steps ahead.

    Subclasses override the class attributes that differ and the three methods `reset`, `update` and `predict`:

    >>> class Free(Tracker):
    ...     def reset(self, seed): ...
    ...     def update(self, frame): ...
    ...     def predict(self, steps):
    ...         return Forecast(np.zeros((steps + 1, *self.stream.grid.shape), np.float32))
    >>> Free(StreamSpec(GridSpec(100, 0.2), period_s=0.125), Settings()).predict(10).occupancy.shape
    (11, 100, 100)
    """

    api: ClassVar[int] = API
    """The version of the contract; a tracker without `fit` may also say API_WITHOUT_FIT."""
    Options: ClassVar[type[Settings]] = Settings
    """The settings of the tracker; unknown keys are refused."""
    classes: tuple[str, ...] = ()
    """The classes that it estimates probabilities for; empty: occupancy only."""
    moving_sensor: ClassVar[bool] = False
    """Whether it follows a sensor that moves. The window of its frames then moves by whole cells, by several after
    missed frames, and the tracker moves its arrays of cells with it (`gridtrack.common.grid.rolled`)."""
    learns: ClassVar[bool] = False
    """Whether `fit` must have run, for the site or for any place, before the tracker can be used."""
    learns_general: ClassVar[bool] = False
    """Whether `fit` can learn for any place (`FitTask.general`)."""
    role: ClassVar[Role] = "tracker"
    """A floor is a row that every tracker must beat, such as persistence. Only the role "recorded" may leave cells
    without a forecast (NaN), and frames with NaN in all cells."""
    reference_for: ClassVar[frozenset[ComparedPart]] = frozenset()
    """The comparisons in which this tracker is the reference of the other rows, unless the user names another row."""

    def __init__(self, stream: StreamSpec, options: Any) -> None:
        self.stream = stream
        self.options = options

    @classmethod
    def starts_from_general(cls, options: Any) -> bool:
        """Whether `fit` with these options starts from general weights if it gets some.

        It reads them from `FitTask.start`. The command writes their name and their training data on the card.
        """
        return False

    @property
    def device(self) -> str:
        """The name of the device on which it computes, such as "NVIDIA H100"; "" for the processor.

        It is shown with the times of the row.
        """
        return ""

    @property
    def recoveries(self) -> int:
        """Number of failures since `reset` from which the tracker recovered; reported with the outcome."""
        return 0

    @abstractmethod
    def reset(self, seed: int) -> None:
        """Set the state as before the first frame. Equal seeds and frames give equal forecasts."""

    @abstractmethod
    def update(self, frame: GridFrame) -> None:
        """Update the state with frame x_t, which is newer than the last one; frames between them may be missing."""

    @abstractmethod
    def predict(self, steps: int) -> Forecast:
        """Forecast steps 0..`steps` from x_1..x_t, without changing the state."""

    def export(self, folder: Path) -> str:
        """Write files into the empty `folder` with which another program can run it; returns a line about them.

        Optional. Raises ConfigurationError.
        """
        kinds = "networks with a latent state, and trackers with tuned settings, have one"
        raise ConfigurationError(f"{type(self).__name__} has no export: {kinds}")

    @classmethod
    def fit(cls, task: FitTask) -> None:
        """Train on `task.train`, select on `task.validation`, and write the card `task.out`.

        Called only if `learns` is true.
        """
        raise NotImplementedError(f"{cls.__name__} has nothing to learn")
