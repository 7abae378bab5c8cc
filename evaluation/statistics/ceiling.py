"""Between floor and ceiling: each F1 as a share of the way from the better floor to the oracle."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gridtrack.evaluation.scoring.splits import ORACLE

FLOORS = ("persistence", "static-map")
LEAST_WAY = 0.01
"""Where floor and oracle are nearer than this, a share of the way between them is noise."""
Curve = list[float | None]


def add_ceiling(trackers: Mapping[str, Any]) -> None:
    """Add to every scope of a summary's `trackers` `share_of_oracle` in each stratum, and `gap_to_truth` beside.

    A scope is a recording, or all of them pooled. The share is (f1 - floor) / (oracle - floor), floor the better of
    persistence and static-map: 0 is no better than not to track at all, 1 is the oracle's. None where a row is missing
    or the oracle is not LEAST_WAY above the floor. The gap is F1 on visible less F1 on occluded cells: what a score of
    future consistency cannot see.
    """
    names = dict.fromkeys(name for entry in trackers.values() for name in _scopes(entry))
    for name in names:
        rows = {label: _scopes(entry)[name] for label, entry in trackers.items() if name in _scopes(entry)}
        floors = [scope for label, scope in rows.items() if trackers[label]["tracker"] in FLOORS]
        for label, scope in rows.items():
            ceiling = None if label == ORACLE else rows.get(ORACLE)
            _add_shares(scope["strata"], ceiling, floors)
            scope["gap_to_truth"] = _gap(scope["strata"])


def _scopes(entry: Mapping[str, Any]) -> dict[str | None, Any]:
    """What a tracker scored, by recording, and pooled under None."""
    pooled = {None: entry["pooled"]} if entry.get("pooled") else {}
    return {**entry["recordings"], **pooled}


def _add_shares(strata: Mapping[str, Any], ceiling: Mapping[str, Any] | None, floors: list[Mapping[str, Any]]) -> None:
    for name, scores in strata.items():
        best, least = _f1(ceiling, name), [f1 for floor in floors if (f1 := _f1(floor, name))]
        shares = [_share(f1, best[n], [f[n] for f in least]) for n, f1 in enumerate(scores["f1"])] if best else None
        scores["share_of_oracle"] = shares


def _f1(scope: Mapping[str, Any] | None, stratum: str) -> Curve:
    """The F1 of a row that was scored in full; empty where there is none."""
    if scope is None or scope["outcome"] != "ok" or stratum not in scope["strata"]:
        return []
    return list(scope["strata"][stratum]["f1"])


def _gap(strata: Mapping[str, Any]) -> Curve | None:
    if "occluded" not in strata:
        return None
    pairs = zip(strata["visible"]["f1"], strata["occluded"]["f1"], strict=True)
    return [None if seen is None or hidden is None else round(seen - hidden, 6) for seen, hidden in pairs]


def _share(value: float | None, ceiling: float | None, floors: list[float | None]) -> float | None:
    known = [floor for floor in floors if floor is not None]
    if value is None or ceiling is None or not known or ceiling < max(known) + LEAST_WAY:
        return None
    return round((value - max(known)) / (ceiling - max(known)), 6)
