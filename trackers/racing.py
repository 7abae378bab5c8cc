"""A race between settings: those that lose on the first excerpts are not scored on the others.

Settings are compared with the best ones so far on the same excerpts, as excerpts differ much more than settings do
(F-Race: Birattari, Stützle, Paquete and Varrentrapp, GECCO 2002; here with a bound on the mean paired difference).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from gridtrack.trackers.excerpts import mean_of_defined

FEWEST_EXCERPTS = 6
STANDARD_ERRORS = 2.0
"""Settings lose where their mean difference from the best ones is more standard errors than this below 0."""


class Race:
    """The best scores so far, one for each excerpt; NaN where a score is undefined."""

    def __init__(self) -> None:
        self._best: list[float] = []

    def run(self, scores: Iterable[float]) -> list[float]:
        """The scores of settings, excerpt by excerpt, up to the one after which they have lost."""
        scored: list[float] = []
        for score in scores:
            scored.append(score)
            if self._have_lost(scored):
                break
        return scored

    def mean(self, scored: Sequence[float]) -> float:
        """The mean of the scores that are defined, NaN without any.

        Of settings that have lost: that of the best ones plus the mean difference from them. Settings that were scored
        on every excerpt and have a higher mean are the best ones from then on.
        """
        if len(scored) < len(self._best):
            return mean_of_defined(self._best) + float(np.mean(self._differences(scored)))
        mean = mean_of_defined(scored)
        if not self._best or mean > mean_of_defined(self._best):
            self._best = list(scored)
        return mean

    def _have_lost(self, scored: Sequence[float]) -> bool:
        differences = self._differences(scored)
        if len(differences) < FEWEST_EXCERPTS or len(scored) == len(self._best):
            return False
        error = float(np.std(differences, ddof=1)) / math.sqrt(len(differences))
        return bool(np.mean(differences) < -STANDARD_ERRORS * error)

    def _differences(self, scored: Sequence[float]) -> list[float]:
        """From the best ones, on the excerpts where both are defined; none before there are best ones."""
        differences = (score - best for score, best in zip(scored, self._best, strict=False))
        return [difference for difference in differences if math.isfinite(difference)]
