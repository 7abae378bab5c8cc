"""Between floor and ceiling: each F1 as a share of the way from the better floor to the oracle."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from gridtrack.evaluation.courses import ORACLE

FLOORS = ("persistence", "static-map")
Curve = list[float | None]


def add_ceiling(trackers: Mapping[str, Any]) -> None:
    """Add to every trial of a summary's `trackers`, in each stratum, `share_of_oracle`, and `gap_to_truth` beside.

    The share is (f1 - floor) / (oracle - floor), floor the better of persistence and static-map: 0 is no better than
    not to track at all, 1 is all that could be had. None where a row is missing or the oracle is not above the floor.
    The gap is F1 on visible less F1 on occluded cells: what a score of future consistency cannot see.
    """
    for label, entry in trackers.items():
        for recording, trial in entry["recordings"].items():
            strata = trial["strata"]
            for name, scores in strata.items():
                ceiling = _f1(trackers.get(ORACLE), recording, name)
                floors = [_f1(floor, recording, name) for floor in _floors(trackers)]
                scores["share_of_oracle"] = (
                    None if label == ORACLE or not ceiling else _shares(scores["f1"], ceiling, floors)
                )
            trial["gap_to_truth"] = (
                _differences(strata["visible"]["f1"], strata["occluded"]["f1"]) if "occluded" in strata else None
            )


def _floors(trackers: Mapping[str, Any]) -> Iterator[Mapping[str, Any]]:
    """The rows of the floor: of several with other options each counts."""
    return (entry for entry in trackers.values() if entry["tracker"] in FLOORS)


def _f1(entry: Mapping[str, Any] | None, recording: str, stratum: str) -> Curve:
    """The F1 of a complete trial; empty where there is none."""
    trial = entry["recordings"].get(recording) if entry else None
    if trial is None or trial["outcome"] != "ok" or trial["frames_scored"] != trial["frames_expected"]:
        return []
    return list(trial["strata"][stratum]["f1"]) if stratum in trial["strata"] else []


def _shares(f1: Curve, ceiling: Curve, floors: list[Curve]) -> Curve:
    known = [floor for floor in floors if floor]
    return [_share(value, ceiling[step], [floor[step] for floor in known]) for step, value in enumerate(f1)]


def _share(value: float | None, ceiling: float | None, floors: list[float | None]) -> float | None:
    known = [floor for floor in floors if floor is not None]
    if value is None or ceiling is None or not known or ceiling <= max(known):
        return None
    return round((value - max(known)) / (ceiling - max(known)), 6)


def _differences(one: Curve, other: Curve) -> Curve:
    return [None if a is None or b is None else round(a - b, 6) for a, b in zip(one, other, strict=True)]
