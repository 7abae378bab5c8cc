"""Paths of virtual robots in kept moments: their contacts, and the alarms of each row at 5 % false alarms."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.referee.samples import RobotPaths, Sample
from gridtrack.evaluation.runs.sums import ScoresError, TrialSums
from gridtrack.evaluation.scores.cells import PROBABILITY_BINS
from gridtrack.evaluation.scores.contact_foresight import CONTACT_FORESIGHT, alarm_risk
from gridtrack.evaluation.scores.definition import block
from gridtrack.reports.run import ReportError

_CLEARS = tuple(block("clears", PROBABILITY_BINS))


def alarm_risk_of(trials: Iterable[tuple[Path, int]]) -> float | None:
    """The least risk that gives an alarm, over all trials of a row; None without sums of contact foresight.

    `trials`: their folders, each with the step of the horizon of the paths. Raises ReportError.
    """
    found = [clears for folder, step in trials if (clears := _clears(folder, step)) is not None]
    return alarm_risk(np.sum(found, axis=0)) if found else None


def _clears(folder: Path, step: int) -> NDArray[np.floating] | None:
    """The clear paths of a trial by their risk (B,)."""
    try:
        sums = TrialSums(folder)
        layout = sums.layouts.get(CONTACT_FORESIGHT.name)
        if layout is None or step not in layout.steps:
            return None
        units = np.zeros(len(sums.frames.stamps_ns), np.int64)
        counted = sums.by_unit(CONTACT_FORESIGHT.name, units, [step], ["dynamic"], _CLEARS).values
    except ScoresError as error:
        raise ReportError(str(error)) from None
    clears: NDArray[np.floating] = counted.sum(axis=(0, 1, 2))
    return clears


def robots_of_moment(samples: Mapping[str, Sample | None], alarm_risks: Mapping[str, float | None]) -> Any:
    """The paths with a contact, or with an alarm of a row, and these alarms; None without paths.

    `paths`: x, y, vx, vy, seconds until the contact or the horizon, and 1 with a contact. `alarms`: for each row a text
    of 0 and 1 for the paths; None if the row has no forecast or no threshold. The paths of all rows are the same.
    """
    kept = {
        label: sample.robots for label, sample in samples.items() if sample is not None and sample.robots is not None
    }
    if not kept:
        return None
    first = next(iter(kept.values()))
    alarms = {
        label: _alarms(robots, risk)
        for label, robots in kept.items()
        if (risk := alarm_risks.get(label)) is not None and np.array_equal(robots.places, first.places)
    }
    shown = np.logical_or.reduce([first.contact == 1, *alarms.values()])
    paths = np.column_stack([first.places, first.velocities, first.until_s, first.contact])[shown]
    return {
        "paths": [[round(float(value), 2) for value in path] for path in paths],
        "alarms": [
            "".join("01"[alarm] for alarm in alarms[label][shown].tolist()) if label in alarms else None
            for label in samples
        ],
    }


def _alarms(robots: RobotPaths, risk: float) -> NDArray[np.bool_]:
    """Which paths (N,) have an alarm; a path without a risk is missed if it has a contact, an alarm if not."""
    return np.where(np.isnan(robots.risks), robots.contact == 0, robots.risks >= risk)
