"""Rankings by F1 that turn round between the chosen thresholds and 0.5."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby, permutations

from gridtrack.evaluation.results.recording import RecordingDescription
from gridtrack.evaluation.results.summary import ALL_RECORDINGS, TrackerSummary
from gridtrack.evaluation.results.trial_summary import ScopeSummary
from gridtrack.evaluation.statistics.score_intervals import HEADLINE_STRATA, Scope

LEAST_LEAD = 0.001
"""A row is ahead of another by at least this much F1 at either threshold: less is not shown in a table."""


@dataclass(frozen=True, slots=True)
class TurnedPair:
    """Two rows of which `ahead` has the higher F1 at the chosen thresholds, and the lower at 0.5.

    `chosen`, `half`: F1 of `ahead` and of `behind` at the chosen thresholds, and at 0.5.
    """

    stratum: str
    horizon_s: float
    ahead: str
    behind: str
    chosen: tuple[float, float]
    half: tuple[float, float]

    @property
    def lead(self) -> float:
        """The smaller of the two leads."""
        return min(self.chosen[0] - self.chosen[1], self.half[1] - self.half[0])

    def __str__(self) -> str:
        return (
            f"on {self.stratum} cells {self.horizon_s:g} s ahead {self.ahead} is above {self.behind} at the chosen"
            f" thresholds (F1 {self.chosen[0]:.3f} and {self.chosen[1]:.3f}) and below it at a threshold of 0.5"
            f" ({self.half[0]:.3f} and {self.half[1]:.3f})"
        )


def turned_rankings(
    recordings: Mapping[str, RecordingDescription],
    trackers: Mapping[str, TrackerSummary],
    pooled_horizons_s: Sequence[float],
) -> list[str]:
    """A line for each headline stratum in which the ranking turns round: the pair with the largest lead.

    Over all recordings at the horizons of their pooled scores, on each where there are none. Ranked rows count, and the
    floors; not the ceiling.
    """
    rows = {label: row for label, row in trackers.items() if not row.ceiling}
    scopes: dict[str, dict[str, ScopeSummary]] = {}
    for label, row in rows.items():
        found: Mapping[str, ScopeSummary | None] = {ALL_RECORDINGS: row.pooled} if pooled_horizons_s else row.recordings
        for name, scope in found.items():
            if scope is not None and scope.ranked:
                scopes.setdefault(name, {})[label] = scope
    horizons_s = {name: described.horizons_s for name, described in recordings.items()}
    horizons_s[ALL_RECORDINGS] = tuple(pooled_horizons_s)
    return [line for name, of_scope in scopes.items() for line in _lines(name, of_scope, horizons_s[name])]


def _lines(name: str, rows: Mapping[str, ScopeSummary], horizons_s: Sequence[float]) -> Iterator[str]:
    for _, of_stratum in groupby(_turned_pairs(rows, horizons_s), key=lambda pair: pair.stratum):
        pairs = sorted(of_stratum, key=lambda pair: -pair.lead)
        pairs_of = "pair of rows and horizon" if len(pairs) == 2 else "pairs of rows and horizons"
        more = f"; {len(pairs) - 1} more such {pairs_of}" if len(pairs) > 1 else ""
        yield f"{name}: the order of trackers depends on the threshold: {pairs[0]}{more}"


def _turned_pairs(rows: Mapping[str, ScopeSummary], horizons_s: Sequence[float]) -> Iterator[TurnedPair]:
    """Every pair of rows that turns round, by stratum and horizon of the headline."""
    for stratum, _, step in Scope(horizons_s, HEADLINE_STRATA).headline:
        scores = {label: scope.strata[stratum] for label, scope in rows.items() if stratum in scope.strata}
        f1 = {label: (one.f1[step], one.f1_at_half[step]) for label, one in scores.items()}
        for ahead, behind in permutations(f1, 2):
            (chosen, half), (other_chosen, other_half) = f1[ahead], f1[behind]
            if chosen is None or half is None or other_chosen is None or other_half is None:
                continue
            pair = TurnedPair(stratum, horizons_s[step], ahead, behind, (chosen, other_chosen), (half, other_half))
            if pair.lead >= LEAST_LEAD:
                yield pair
