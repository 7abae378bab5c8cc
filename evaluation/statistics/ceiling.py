"""Scores relative to the best floor, 0, and the oracle, 1."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from gridtrack.evaluation.results.summary import ORACLE, TrackerSummary
from gridtrack.evaluation.results.trial_summary import ScopeSummary, StratumScores, TrialSummary
from gridtrack.evaluation.results.values import Curve

MIN_ORACLE_GAP = 0.01
"""No share is computed where the oracle's F1 is less than this above the floor's, or its log loss less than this share
of the floor's below it: it would be noise."""


def with_ceiling(trackers: Mapping[str, TrackerSummary]) -> dict[str, TrackerSummary]:
    """The rows with `share_of_oracle`, `share_of_oracle_nll` in each stratum, and `gap_to_truth`, also pooled.

    A share is (score - floor) / (oracle - floor), with the best of the rows with the role `floor`: 0 for the floor, 1
    for the oracle. None where the oracle or one of the floors is missing or was scored in part, for that one may be the
    best; where the oracle is not clearly better than the floor (MIN_ORACLE_GAP); and where the row was scored in part,
    on other frames than the oracle. The gap is F1 on visible less F1 on occluded cells.
    """
    return {label: _row_with_ceiling(label, row, trackers) for label, row in trackers.items()}


def incomplete_floors(trackers: Mapping[str, TrackerSummary]) -> list[str]:
    """A line for each floor without which no share of the oracle is known, on some of the recordings or on all."""
    found = []
    for label, row in trackers.items() if ORACLE in trackers else ():
        missing, trials = sum(not _is_bound(trial) for trial in row.recordings.values()), len(row.recordings)
        if row.floor and missing:
            where = f" on {missing} of {trials} recordings, nor on all together" if trials > 1 else ""
            found.append(f"no share of the oracle{where}: {label}, a floor, is not complete")
    return found


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
        best = _bound(oracle, name)
        lowest = [one for floor in floors if (one := _bound(floor, name))]
        known = lowest if len(lowest) == len(floors) else []
        shares = _shares(scores, best, known) if best and scope.outcome == "ok" else {}
        strata[name] = scores.model_copy(update=shares)
    return {"strata": strata, "gap_to_truth": _gap(scope.strata)}


def _bound(scope: ScopeSummary | None, stratum: str) -> StratumScores | None:
    """The scores of a scope that may be the floor or the ceiling of others; None where there are none."""
    return scope.strata.get(stratum) if scope is not None and _is_bound(scope) else None


def _is_bound(scope: ScopeSummary) -> bool:
    return scope.outcome == "ok" and not scope.leak


def _shares(scores: StratumScores, oracle: StratumScores, floors: Sequence[StratumScores]) -> dict[str, Curve]:
    """Both shares of one stratum, by step."""
    f1 = zip(scores.f1, oracle.f1, *(floor.f1 for floor in floors), strict=True)
    nll = zip(scores.nll, oracle.nll, *(floor.nll for floor in floors), strict=True)
    return {
        "share_of_oracle": tuple(_share_of_f1(*step) for step in f1),
        "share_of_oracle_nll": tuple(_share_of_log_loss(*step) for step in nll),
    }


def _share_of_f1(value: float | None, ceiling: float | None, *floors: float | None) -> float | None:
    floor = max((one for one in floors if one is not None), default=None)
    clear = ceiling is not None and floor is not None and ceiling - floor >= MIN_ORACLE_GAP
    return _share(value, ceiling, floor) if clear else None


def _share_of_log_loss(value: float | None, ceiling: float | None, *floors: float | None) -> float | None:
    floor = min((one for one in floors if one is not None), default=None)
    clear = ceiling is not None and floor is not None and floor - ceiling >= MIN_ORACLE_GAP * floor > 0.0
    return _share(value, ceiling, floor) if clear else None


def _share(value: float | None, ceiling: float | None, floor: float | None) -> float | None:
    if value is None or ceiling is None or floor is None:
        return None
    return round((value - floor) / (ceiling - floor), 6) + 0.0  # not -0.0


def _gap(strata: Mapping[str, StratumScores]) -> Curve | None:
    if "occluded" not in strata:
        return None
    pairs = zip(strata["visible"].f1, strata["occluded"].f1, strict=True)
    return tuple(None if seen is None or hidden is None else round(seen - hidden, 6) for seen, hidden in pairs)
