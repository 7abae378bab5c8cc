"""F1 relative to the best floor, 0, and the oracle, 1."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from gridtrack.evaluation.results.summary import ORACLE, TrackerSummary
from gridtrack.evaluation.results.trial_summary import ScopeSummary, StratumScores, TrialSummary

MIN_ORACLE_GAP = 0.01
"""No share is computed where oracle and floor differ by less: it would be noise."""
F1Curve = tuple[float | None, ...]


def with_ceiling(trackers: Mapping[str, TrackerSummary]) -> dict[str, TrackerSummary]:
    """The rows with `share_of_oracle` in each stratum, and `gap_to_truth`, on each recording and pooled.

    The share is (f1 - floor) / (oracle - floor), with the best of the rows with the role `floor`: 0 for the floor, 1
    for the oracle. None where a row is missing or the oracle is not MIN_ORACLE_GAP above the floor. The gap is F1 on
    visible less F1 on occluded cells.
    """
    return {label: _row_with_ceiling(label, row, trackers) for label, row in trackers.items()}


def _row_with_ceiling(label: str, row: TrackerSummary, trackers: Mapping[str, TrackerSummary]) -> TrackerSummary:
    oracle = None if label == ORACLE else trackers.get(ORACLE)
    floors = [one for one in trackers.values() if one.floor]
    recordings = {
        name: trial.model_copy(update=_added(trial, _trial(oracle, name), [_trial(floor, name) for floor in floors]))
        for name, trial in row.recordings.items()
    }
    pooled = row.pooled
    if pooled is not None:
        added = _added(pooled, oracle.pooled if oracle else None, [floor.pooled for floor in floors])
        pooled = pooled.model_copy(update=added)
    return row.model_copy(update={"recordings": recordings, "pooled": pooled})


def _trial(row: TrackerSummary | None, name: str) -> TrialSummary | None:
    return row.recordings.get(name) if row else None


def _added(scope: ScopeSummary, oracle: ScopeSummary | None, floors: Sequence[ScopeSummary | None]) -> dict[str, Any]:
    """The fields of one scope that need the oracle, the floors or ground truth."""
    strata = {}
    for name, scores in scope.strata.items():
        best, lowest = _f1(oracle, name), [f1 for floor in floors if (f1 := _f1(floor, name))]
        steps = range(len(scores.f1))
        shares = tuple(_share(scores.f1[n], best[n], [f1[n] for f1 in lowest]) for n in steps) if best else None
        strata[name] = scores.model_copy(update={"share_of_oracle": shares})
    return {"strata": strata, "gap_to_truth": _gap(scope.strata)}


def _f1(scope: ScopeSummary | None, stratum: str) -> F1Curve:
    """The F1 of a scope that was scored in full; empty where there is none."""
    if scope is None or scope.outcome != "ok" or stratum not in scope.strata:
        return ()
    return scope.strata[stratum].f1


def _gap(strata: Mapping[str, StratumScores]) -> F1Curve | None:
    if "occluded" not in strata:
        return None
    pairs = zip(strata["visible"].f1, strata["occluded"].f1, strict=True)
    return tuple(None if seen is None or hidden is None else round(seen - hidden, 6) for seen, hidden in pairs)


def _share(value: float | None, ceiling: float | None, floors: list[float | None]) -> float | None:
    known = [floor for floor in floors if floor is not None]
    if value is None or ceiling is None or not known or ceiling < max(known) + MIN_ORACLE_GAP:
        return None
    return round((value - max(known)) / (ceiling - max(known)), 6)
