"""The plugin contract: what a tracker is given, what it must do, and what it answers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.config import Settings
from gridtrack.common.grid import GridFrame, GridSpec, LabelledFrame

API = 1
Role = Literal["tracker", "floor"]
"""The role of a row in a comparison: a tracker, or a floor, which every tracker must beat."""
ComparedPart = Literal["occupancy", "classes"]
"""What two rows are compared by: their forecasts of occupancy, or of classes."""


@dataclass(frozen=True, slots=True)
class StreamSpec:
    """What a tracker knows before the first frame.

    `grid` and `period_s` of the stream, its `site`, the `classes` its labels name, and `weights`: the settings file
    (`.toml`, arrays in the `.safetensors` beside it) that this tracker's `fit` wrote for the site, or None.
    """

    grid: GridSpec
    period_s: float
    site: str = ""
    classes: tuple[str, ...] = ()
    weights: Path | None = None


@dataclass(frozen=True, slots=True)
class TrackedObject:
    """One object of a forecast, at step 0, in the grid frame of the last update.

    `box` (5,): x, y, heading, length along it, width (metres, radians); `velocity` (2,) m/s and `covariance` (4, 4) of
    (x, y, vx, vy): of the point that the tracker follows, which need not be the middle of what is seen; `label` a class
    name, or "" where unknown; `track` the identity kept over time.
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
    classes, or None; `velocity` (2, M, M) float32 m/s at step 0, or None; `objects` where the tracker has any.
    """

    occupancy: NDArray[np.float32]
    semantics: NDArray[np.float32] | None = None
    velocity: NDArray[np.float32] | None = None
    objects: tuple[TrackedObject, ...] = ()


class FrameSource(Protocol):
    """A stretch of a recording as frames of one fixed period; every iteration starts over from its first frame."""

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
        """The same frames with the classes of their occupied cells, for `fit`; none are known in most recordings."""
        ...


def stream_of(source: FrameSource, weights: Path | None = None) -> StreamSpec:
    """What a tracker is told about `source` before its first frame."""
    return StreamSpec(source.grid, source.period_s, source.site, source.classes, weights)


@dataclass(frozen=True, slots=True)
class StretchScore:
    """The host's score of one tracker on one stretch: F1 (steps+1,) per stratum at the best threshold of each step."""

    f1: dict[str, NDArray[np.float64]]
    log_loss: dict[str, NDArray[np.float64]]


Score = Callable[["Tracker", FrameSource, int], StretchScore]
"""`score(tracker, source, steps)`: resets the tracker, streams the source through it, and scores its forecasts."""


@dataclass(frozen=True, slots=True)
class FitOutput:
    """Where `fit` leaves what it learned (`path`, a `.toml` to be written), the command that made it, and the seed."""

    path: Path
    command: str
    seed: int
    log_dir: Path
    """A folder that `fit` may fill with logs and checkpoints; a second call with the same one resumes."""
    report: Callable[[str], None] = print
    """One line of progress."""


class Tracker(ABC):
    """A tracker: takes in one grid frame at a time, and forecasts the steps ahead.

    Subclasses override the class attributes that differ and the three methods `reset`, `update` and `predict`.
    """

    api: ClassVar[int] = API
    Options: ClassVar[type[Settings]] = Settings
    """The tracker's own settings; unknown keys are refused."""
    classes: tuple[str, ...] = ()
    """The classes it gives probabilities for; empty: occupancy only."""
    moving_sensor: ClassVar[bool] = False
    """Whether it can follow a sensor that moves."""
    learns: ClassVar[bool] = False
    """Whether `fit` must have run for the site before the tracker can be used."""
    role: ClassVar[Role] = "tracker"
    """A floor is a row that every tracker must beat, such as persistence."""
    reference_for: ClassVar[frozenset[ComparedPart]] = frozenset()
    """The comparisons in which the other rows are compared with this tracker, unless the user names another row."""

    def __init__(self, stream: StreamSpec, options: Any) -> None:
        self.stream = stream
        self.options = options

    @property
    def recoveries(self) -> int:
        """How often since `reset` something in it failed and it went on from what was sound; told in the outcome."""
        return 0

    @abstractmethod
    def reset(self, seed: int) -> None:
        """Forget everything seen so far: a new stream begins. Same seed and frames, same forecasts."""

    @abstractmethod
    def update(self, frame: GridFrame) -> None:
        """Take in x_t. On a clock (`--deadline`) frames are missed: stamps then lie more than a period apart."""

    @abstractmethod
    def predict(self, steps: int) -> Forecast:
        """Forecast steps 0..steps from x_1..x_t. Must not change the state."""

    @classmethod
    def fit(
        cls,
        train: Sequence[FrameSource],
        validation: Sequence[FrameSource],
        score: Score,
        out: FitOutput,
        options: Any,
    ) -> None:
        """Learn or tune on `train`, choose on `validation`, and write `out.path`. Only where `learns` is true."""
        raise NotImplementedError(f"{cls.__name__} has nothing to learn")
