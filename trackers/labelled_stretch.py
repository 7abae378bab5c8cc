"""Consecutive labelled scans of the training recordings, drawn by the seed, from which classes are learned."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.errors import ConfigurationError
from gridtrack.common.grid import LabelledFrame
from gridtrack.trackers.contract import FrameSource

LEAD_IN = 40
"""Frames before the labelled ones, without labels: they initialise the state of a tracker."""
VALIDATE_ON = 5
"""Every fifth scan is used for validation: neighbouring scans are nearly equal."""


@dataclass(frozen=True, slots=True)
class LabelledStretch:
    """Consecutive `frames` of a source, the first `lead_in` without labels; labels start at frame `first` of it."""

    source: FrameSource
    first: int
    lead_in: int
    frames: list[LabelledFrame]

    @property
    def name(self) -> str:
        """Source and seconds, for cards: `train.tracks, 800 scans from 1800.75 s on`."""
        scans = len(self.frames) - self.lead_in
        return f"{self.source.name}, {scans} scans from {self.first * self.source.period_s:g} s on"


def draw_labelled(sources: Sequence[FrameSource], scans: int, seed: int) -> LabelledStretch:
    """`scans` consecutive labelled frames of one of `sources`; every possible first frame is equally likely.

    Raises ConfigurationError where no source has so many consecutive labelled frames.
    """
    starts = [possible_starts(_is_labelled(source), scans) for source in sources]
    ends = np.cumsum([len(possible) for possible in starts])
    if not ends[-1]:
        names = ", ".join(source.name for source in sources)
        raise ConfigurationError(
            f"{names}: no {scans} consecutive labelled scans: use fewer labelled_scans, or a recording with labels"
        )
    at = int(np.random.default_rng(seed).integers(ends[-1]))
    number = int(np.searchsorted(ends, at, side="right"))
    first = int(starts[number][at - ends[number]])
    lead_in = min(LEAD_IN, first)
    frames = list(islice(sources[number].labelled(), first - lead_in, first + scans))
    unlabelled = [item._replace(cells=item.cells[:0], labels=item.labels[:0]) for item in frames[:lead_in]]
    return LabelledStretch(sources[number], first, lead_in, unlabelled + frames[lead_in:])


def possible_starts(labelled: NDArray[np.bool_], scans: int) -> NDArray[np.int64]:
    """First frames of every `scans` consecutive frames that are all `labelled` (T,) bool."""
    count = np.concatenate([[0], np.cumsum(labelled)])
    return np.flatnonzero(count[scans:] - count[: max(count.size - scans, 0)] == scans)


def _is_labelled(source: FrameSource) -> NDArray[np.bool_]:
    return np.fromiter((item.labels.size > 0 for item in source.labelled()), np.bool_, len(source))


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
