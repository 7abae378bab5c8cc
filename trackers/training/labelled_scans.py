"""Learning from labelled scans: the settings, and the scans of the training recordings that the seed draws."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from gridtrack.common.config import Settings
from gridtrack.common.errors import ConfigurationError
from gridtrack.common.grid import LabelledFrame
from gridtrack.trackers.contract import FrameSource

ENOUGH_SCANS = 800
"""The default number of labelled scans, as in the paper."""

ClassWeights = Literal["inverse-frequency", "none"]


LEAD_IN = 32
"""Frames without labels before a labelled scan. They initialise the state of a tracker: the referee's warm-up has 20
frames, and forecasts start up to 12 frames before the scan."""
VALIDATE_ON = 20
"""Every twentieth scan is used for validation: neighbouring scans are nearly equal."""
NAMED_SOURCES = 4
"""Up to this many recordings are named one by one; general weights learn from hundreds."""
SourceAndFrames = tuple[FrameSource, Iterator[LabelledFrame]]
"""A source and frames of it; the labels index the class names of the source."""


class LabelSettings(Settings):
    """Which labels a tracker learns from."""

    labelled_scans: int | None = Field(None, ge=1)
    """Number of labelled scans that the classes are learned from; the seed draws them. None: ENOUGH_SCANS, or all if
    fewer are labelled; the card states how many there were."""
    label_drawing: Literal["spread", "consecutive"] = "spread"
    """`spread`: scans from the whole training recordings, as a person would choose them; `consecutive`: in a row."""


class ClassifierSettings(Settings):
    """The width of a classifier, and its training by AdamW on the labelled cells."""

    channels: int = Field(32, ge=1, le=256)
    """Channels of every layer but the last."""
    learning_rate: float = Field(1e-2, gt=0)
    weight_decay: float = Field(1e-2, ge=0)
    class_weights: ClassWeights = "inverse-frequency"
    """Weights of the classes in the loss; the paper's are inverse to the frequency of a class among the labels."""
    updates: int = Field(1200, ge=1)
    """Number of updates; the state with the least log loss on the validation stretch is kept."""
    batch: int = Field(256, ge=1)
    """Labelled cells of one update."""


@dataclass(frozen=True, slots=True)
class LabelledScans:
    """Labelled scans of `sources`: of each source the numbers (N,) of its frames, ascending.

    `classes`: the names of the classes in the labels of these scans; another class cannot be learned from them.
    """

    sources: tuple[FrameSource, ...]
    numbers: tuple[NDArray[np.int64], ...]
    classes: tuple[str, ...]

    @property
    def count(self) -> int:
        """Number of scans."""
        return sum(own.size for own in self.numbers)

    @property
    def name(self) -> str:
        """Number of scans, for cards; if there are few sources, by source with the first and the last second."""
        drawn = list(self._drawn())
        if len(drawn) > NAMED_SOURCES:
            return f"{self.count} scans of {len(drawn)} recordings"
        return "; ".join(
            f"{source.name}, {len(own)} scans from {own[0] * source.period_s:g} s to {own[-1] * source.period_s:g} s"
            for source, own in drawn
        )

    def runs(self) -> Iterator[SourceAndFrames]:
        """Runs of consecutive frames: each labelled scan follows at least LEAD_IN frames, if the source has them.

        All other frames than the labelled scans are without labels. Read a run before the next one is requested.
        """
        for source, own in self._drawn():
            frames, labelled = enumerate(source.labelled()), set(own.tolist())
            for first, last in run_bounds(own):
                yield source, _run(frames, first, last, labelled)

    def scans(self) -> Iterator[SourceAndFrames]:
        """The labelled scans alone."""
        for source, frames in self.runs():
            yield source, (item for item in frames if item.labels.size)

    def _drawn(self) -> Iterator[tuple[FrameSource, NDArray[np.int64]]]:
        return ((source, own) for source, own in zip(self.sources, self.numbers, strict=True) if own.size)


def run_bounds(numbers: NDArray[np.int64]) -> list[tuple[int, int]]:
    """First and last frame of each run of frames for the scans `numbers` (N,), ascending, with their lead-ins."""
    apart = np.flatnonzero(np.diff(numbers) > LEAD_IN) + 1
    return [(max(int(part[0]) - LEAD_IN, 0), int(part[-1])) for part in np.split(numbers, apart)]


def _run(
    frames: Iterator[tuple[int, LabelledFrame]], first: int, last: int, labelled: set[int]
) -> Iterator[LabelledFrame]:
    for number, item in frames:
        if number >= first:
            yield item if number in labelled else item._replace(cells=item.cells[:0], labels=item.labels[:0])
        if number == last:
            return


def draw_labelled(sources: Sequence[FrameSource], settings: LabelSettings, seed: int) -> LabelledScans:
    """Draw `settings.labelled_scans` of the labelled scans of `sources`, by default up to ENOUGH_SCANS.

    `spread`: the scans with labels, in their order, are divided into as many runs of equal length, and one scan of each
    run is drawn. `consecutive`: scans that follow one another; every possible first one is equally likely. Raises
    ConfigurationError if there are fewer than requested, or none.
    """
    present = [[np.unique(item.labels) for item in source.labelled()] for source in sources]
    labelled = [np.array([labels.size > 0 for labels in own], np.bool_) for own in present]
    consecutive = settings.label_drawing == "consecutive"
    there = longest_run(labelled) if consecutive else sum(int(own.sum()) for own in labelled)
    scans = settings.labelled_scans or min(ENOUGH_SCANS, there)
    if not 0 < scans <= there:
        few = len(sources) <= NAMED_SOURCES
        names = ", ".join(source.name for source in sources) if few else f"{len(sources)} recordings"
        kind = "consecutive labelled" if consecutive else "labelled"
        if not there:
            raise ConfigurationError(f"{names}: no labelled scans: train on a recording with labels")
        raise ConfigurationError(f"{names}: {there} {kind} scans, not {scans}: set labelled_scans to at most {there}")
    drawn = (consecutive_scans if consecutive else spread_scans)(labelled, scans, np.random.default_rng(seed))
    learned: dict[str, None] = {}
    for source, own, numbers in zip(sources, present, drawn, strict=True):
        learned |= dict.fromkeys(learned_classes(source.classes, (own[number] for number in numbers)))
    return LabelledScans(tuple(sources), tuple(drawn), tuple(learned))


def spread_scans(
    labelled: Sequence[NDArray[np.bool_]], scans: int, draw: np.random.Generator
) -> list[NDArray[np.int64]]:
    """Numbers of the frames of one scan in each of `scans` equal runs of the `labelled` ones, by source."""
    source = np.repeat(np.arange(len(labelled)), [np.count_nonzero(own) for own in labelled])
    number = np.concatenate([np.flatnonzero(own) for own in labelled])
    edges = np.linspace(0, number.size, scans + 1).round().astype(np.int64)
    chosen = draw.integers(edges[:-1], edges[1:])
    return [number[chosen[source[chosen] == one]] for one in range(len(labelled))]


def consecutive_scans(
    labelled: Sequence[NDArray[np.bool_]], scans: int, draw: np.random.Generator
) -> list[NDArray[np.int64]]:
    """Numbers of the frames of `scans` scans in a row, of one source."""
    starts = [possible_starts(own, scans) for own in labelled]
    ends = np.cumsum([len(possible) for possible in starts])
    at = int(draw.integers(ends[-1]))
    chosen = int(np.searchsorted(ends, at, side="right"))
    first = starts[chosen][at - ends[chosen]]
    return [np.arange(first, first + scans) if one == chosen else np.zeros(0, np.int64) for one in range(len(labelled))]


def longest_run(labelled: Sequence[NDArray[np.bool_]]) -> int:
    """The largest number of consecutive frames of one source that are all `labelled`, each (T,) bool."""
    edges = (np.flatnonzero(np.diff(own, prepend=False, append=False)) for own in labelled)
    return max((int((ends[1::2] - ends[::2]).max()) for ends in edges if ends.size), default=0)


def possible_starts(labelled: NDArray[np.bool_], scans: int) -> NDArray[np.int64]:
    """First frames of every `scans` consecutive frames that are all `labelled` (T,) bool."""
    count = np.concatenate([[0], np.cumsum(labelled)])
    return np.flatnonzero(count[scans:] - count[: max(count.size - scans, 0)] == scans)


def learned_classes(names: Sequence[str], labels: Iterable[NDArray[np.uint8]]) -> tuple[str, ...]:
    """The names of the classes in `labels`; a class without a labelled cell cannot be learned."""
    present = np.unique(np.concatenate([np.zeros(0, np.uint8), *labels]))
    return tuple(names[label] for label in present)


def class_indices(labels: NDArray[np.uint8], names: Sequence[str], classes: Sequence[str]) -> NDArray[np.int64]:
    """Indices into `classes` of labels (N,), which index a recording's `names`; -1 for a class not in `classes`."""
    index = [classes.index(name) if name in classes else -1 for name in names]
    return np.array([*index, -1], np.int64)[np.minimum(labels, len(index))]


def inverse_frequency(targets: NDArray[np.int64], classes: int) -> NDArray[np.float32]:
    """Weights (K,) inverse to the frequency of each class in `targets` (N,); their mean over `targets` is 1."""
    count = np.bincount(targets, minlength=classes)
    return (targets.size / (classes * np.maximum(count, 1))).astype(np.float32)
