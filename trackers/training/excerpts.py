"""Excerpts of recordings, and the scores by which a search and a validation select on them: the same for all trackers.

Excerpts are cached in memory, because they are streamed many times.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.grid import GridFrame, GridSpec, LabelledFrame, nearest_step
from gridtrack.trackers.contract import FrameSource, StretchScore

SELECTION_STRATA, SELECTION_HORIZONS_S = ("dynamic", "in-motion", "visible"), (0.5, 1.0, 2.0)
"""Settings and weights are selected by the mean of F1 in these strata and of the contacts foreseen, at these horizons.
Standing objects would decide among the dynamic cells alone; and vehicles that wait at a red light count as static in a
stretch of one or two minutes, so that only the visible cells contain them. Contacts lead the reports."""
EXCERPTS, EXCERPT_S = 4, 100.0
"""Number and duration of the excerpts of a long recording for the search; each is longer than a signal cycle."""
PLACES, SEARCHED_S, VALIDATED_S = 24, 20.0, 60.0
"""Number of places for general weights, and the duration of the excerpt of each in a search and in a validation. A
search scores hundreds of settings; a training scores a few networks, which differ too little for short excerpts."""
PLACE_STRIDE = 5
"""Stride between places in the order of the excerpts; it has no divisor in common with PLACES."""


@dataclass(slots=True)
class CachedSource:
    """A part of another source, its frames cached in memory."""

    name: str
    sha256: str
    grid: GridSpec
    period_s: float
    site: str
    classes: tuple[str, ...]
    frames: Sequence[GridFrame]

    @classmethod
    def excerpt(cls, source: FrameSource, first: int, count: int) -> CachedSource:
        """The `count` frames of `source` from number `first` on, named by their time range."""
        name = f"{source.name}, {count * source.period_s:g} s from {first * source.period_s:g} s on"
        frames = tuple(islice(source, first, first + count))
        return cls(name, source.sha256, source.grid, source.period_s, source.site, source.classes, frames)

    def __iter__(self) -> Iterator[GridFrame]:
        return iter(self.frames)

    def __len__(self) -> int:
        return len(self.frames)

    def labelled(self) -> Iterator[LabelledFrame]:
        """Not available: only occupancy is tuned on cached frames."""
        raise NotImplementedError("classes are not trained on cached frames")


def searched_excerpts(sources: Sequence[FrameSource], *, general: bool) -> list[FrameSource]:
    """The sources for a search, their frames cached in memory; for general weights `excerpts_of_places`.

    A long source is replaced by EXCERPTS of EXCERPT_S, evenly distributed over it.
    """
    if general:
        return excerpts_of_places(sources, SEARCHED_S)
    chosen: list[FrameSource] = []
    for source in sources:
        count = round(EXCERPT_S / source.period_s)
        if len(source) <= EXCERPTS * count:
            chosen.append(CachedSource.excerpt(source, 0, len(source)))
        else:
            firsts = (round((2 * n + 1) * len(source) / (2 * EXCERPTS)) - count // 2 for n in range(EXCERPTS))
            chosen += [CachedSource.excerpt(source, first, count) for first in firsts]
    return chosen


def excerpts_of_places(sources: Sequence[FrameSource], duration_s: float) -> list[FrameSource]:
    """For general weights: the middle `duration_s` of each of at most PLACES sources, evenly chosen, in memory.

    Neighbours among the sources, such as two worlds of one kind, do not follow each other, so that the first excerpts
    are a fair sample already.
    """
    order = [n * PLACE_STRIDE % PLACES for n in range(PLACES)]
    chosen = [sources[n * len(sources) // PLACES] for n in order] if len(sources) > PLACES else sources
    counts = [round(duration_s / source.period_s) for source in chosen]
    firsts = [max(0, (len(source) - count) // 2) for source, count in zip(chosen, counts, strict=True)]
    return [CachedSource.excerpt(*each) for each in zip(chosen, firsts, counts, strict=True)]


def step_of(source: FrameSource, horizon_s: float) -> int:
    """The step nearest to a horizon, at least 1."""
    return max(1, nearest_step(horizon_s, source.period_s))


def selection_scores(score: StretchScore, source: FrameSource) -> dict[str, float]:
    """The `selection_curves` at SELECTION_HORIZONS_S; NaN where undefined."""
    return {
        f"{name}_{horizon_s:g}s": float(curve[step_of(source, horizon_s)])
        for name, curve in selection_curves(score).items()
        for horizon_s in SELECTION_HORIZONS_S
    }


def selection_curves(score: StretchScore) -> dict[str, NDArray[np.float64]]:
    """F1 in SELECTION_STRATA and the contacts foreseen, each (steps+1,), by name."""
    f1 = {f"{stratum}_f1": score.f1[stratum] for stratum in SELECTION_STRATA}
    return f1 | {"contacts_foreseen": score.contacts_foreseen}


def mean_of_defined(scores: Iterable[float]) -> float:
    """The mean of the scores that are defined, NaN without any. Without motion the F1 of dynamic cells is undefined."""
    defined = [score for score in scores if math.isfinite(score)]
    return float(np.mean(defined)) if defined else math.nan
