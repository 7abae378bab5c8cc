"""The horizons at which several recordings are scored together, and the steps that these are in each of them.

Recordings of one period and horizon share their steps. Else a step is another time in each, and what is added up are
the counts at horizons in seconds: every POOLED_EVERY_S, in each recording by the step that is nearest.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise

from gridtrack.common.grid import nearest_step
from gridtrack.evaluation.results.recording import RecordingDescription

POOLED_EVERY_S = 0.5
"""Spacing of the common horizons, seconds: those of the headline are multiples of it."""


def common_horizons(recordings: Iterable[RecordingDescription]) -> tuple[float, ...]:
    """The horizons, seconds, of the scores of `recordings` together, 0 first; empty where they have none in common.

    Those of their steps where all have the same; else the multiples of POOLED_EVERY_S that every one reaches. A period
    above POOLED_EVERY_S has no step for each of these.
    """
    described = list(recordings)
    if all(one.horizons_s == other.horizons_s for one, other in pairwise(described)):
        return described[0].horizons_s
    if any(one.period_s > POOLED_EVERY_S for one in described):
        return ()
    reached = min(_reached(one) for one in described)
    return tuple(k * POOLED_EVERY_S for k in range(reached + 1)) if reached else ()


def _reached(described: RecordingDescription) -> int:
    """How many multiples of POOLED_EVERY_S lie nearest to one of the steps of a recording."""
    steps, reached = len(described.horizons_s) - 1, 0
    while nearest_step((reached + 1) * POOLED_EVERY_S, described.period_s) <= steps:
        reached += 1
    return reached


def steps_at(horizons_s: Sequence[float], described: RecordingDescription) -> tuple[int, ...]:
    """The steps of a recording that are nearest to these horizons, which increase."""
    if tuple(horizons_s) == described.horizons_s:
        return tuple(range(len(horizons_s)))
    return tuple(nearest_step(horizon_s, described.period_s) for horizon_s in horizons_s)


def unlike_recordings(recordings: Mapping[str, RecordingDescription]) -> list[str]:
    """Notices of what is unlike among recordings whose scores are pooled; empty where nothing is."""
    described = list(recordings.values())
    notices, horizons_s = [], common_horizons(described)
    if any(one.horizons_s != horizons_s for one in described):
        off_s = max(_off_s(horizons_s, one) for one in described)
        notices.append(
            "the recordings differ in rate or horizon: scores over all of them are given every"
            f" {POOLED_EVERY_S:g} s; of each recording the nearest step counts, at most {off_s * 1000:.0f} ms away"
        )
    if len({one.grid.partition("@")[0].partition("x")[2] for one in described}) > 1:
        notices.append("the recordings differ in the size of their cells: together every cell counts as one")
    return notices


def _off_s(horizons_s: Sequence[float], described: RecordingDescription) -> float:
    """The largest distance, seconds, from one of these horizons to its step in a recording."""
    steps = steps_at(horizons_s, described)
    return max(abs(described.horizons_s[step] - h) for h, step in zip(horizons_s, steps, strict=True))
