"""Contact foresight: the contacts of a robot that a forecast foresees, at the price of needless alarms.

Virtual robots drive straight on from where they are safe. A robot that meets an occupied cell within a horizon has a
contact; one that stays on visible free cells is clear; others are unknown and left out. The risk of a path is the
largest probability on its cells, and the score ranks paths by risk. The world does not react to the robots. The ranking
of paths by a forecast is after Philion, Kar and Fidler, "Learning to evaluate perception models using planner-centric
metrics" (CVPR 2020), without a planner.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import nearest_step, shift_between
from gridtrack.evaluation.referee.referee import ScoredForecast
from gridtrack.evaluation.referee.samples import RobotPaths
from gridtrack.evaluation.referee.strata import PARTS
from gridtrack.evaluation.referee.targets import SEEN_FREE
from gridtrack.evaluation.scores.cells import (
    CALIBRATION_BINS,
    CALIBRATION_EDGES,
    CLIP,
    FIRST_OF_CALIBRATION_BIN,
    PROBABILITY_BINS,
    PROBABILITY_EDGES,
)
from gridtrack.evaluation.scores.contact_paths import NEVER, Events, Paths, draw_paths, events_of, risks_of
from gridtrack.evaluation.scores.definition import (
    Floats,
    Measure,
    Output,
    Ratio,
    ScoreDefinition,
    Sums,
    TrialFacts,
    block,
    divided,
)
from gridtrack.evaluation.scores.pr_auc import area_under_precision_recall

ROBOTS_AHEAD_S = 1.0
"""The horizon of the paths that are kept to be shown, seconds."""
LONGEST_S = 2.0
"""The longest horizon, seconds."""
LEAST_PATHS = 50
"""A forecast with fewer paths is left out."""
FALSE_ALARMS = 0.05
"""Rate of false alarms at which foreseen contacts are counted."""
NEEDLESS_AT, ALARMS_AT = 0.8, 0.95
"""Shares of foreseen contacts at which needless stops, and the rate of false alarms, are given."""
_SLICES = ("dynamic", "in-motion", "standing")
_HIDDEN = "occluded dynamic"
_MOTIONS = {name: PARTS.index(name) for name in ("in-motion", "standing")}


_PARTS = (
    *block("contacts", PROBABILITY_BINS),
    *block("clears", PROBABILITY_BINS),
    *block("independent contacts", CALIBRATION_BINS),
    *block("independent clears", CALIBRATION_BINS),
    *block("lead", CALIBRATION_BINS),
    *("followed", "unknown", "seconds", "forecasts", "skipped", "sampled paths", "sampled log loss"),
)


def contact_strata(facts: TrialFacts) -> tuple[str, ...]:
    """All contacts; then by the first cell: in motion, standing, hidden at first (with truth), and of each class."""
    hidden = (_HIDDEN,) if facts.has_truth else ()
    return *_SLICES, *hidden, *(f"dynamic {name}" for name in facts.classes)


def longest(facts: TrialFacts) -> int:
    """The last step that has this score."""
    return min(facts.steps, round(LONGEST_S / facts.period_s))


@dataclass(slots=True)
class _Approach:
    """Paths of a forecast that end in a contact, and their risks in it and in later forecasts until the contact.

    `since_s` of each of these forecasts; `risks` (N, L) of each, within steps 1..L of the first forecast.
    """

    stamp_ns: int
    window: SE2
    paths: Paths
    contact: NDArray[np.int16]
    slices: NDArray[np.bool_]
    since_s: list[float]
    risks: list[NDArray[np.float32]]


def _count(forecast: ScoredForecast, facts: TrialFacts, memory: list[_Approach]) -> Floats:
    """Sums (S, K, P) over the paths of a forecast; step n has contacts within n steps.

    `memory`: approaches that have not ended.
    """
    last = longest(facts)
    sums = Sums(np.zeros((facts.steps + 1, len(contact_strata(facts)), len(_PARTS))), _PARTS)
    within = Sums(sums.values[1 : last + 1], sums.parts)
    occupancy = np.ascontiguousarray(forecast.forecast.occupancy[1 : last + 1])
    _follow(forecast, facts, memory, occupancy, within)
    paths = paths_of(forecast, facts)
    within["forecasts"][:] = 1.0
    if len(paths) < LEAST_PATHS:
        within["skipped"][:] = 1.0
        return sums.values
    events = events_of(paths, forecast.targets[1 : last + 1], has_truth=facts.has_truth)
    slices = _slices_of(events, forecast, facts)
    largest, independent = risks_of(paths, occupancy)
    outcome = _Outcomes.of(events, slices, last)
    _add_histograms(within, "", _bins(largest, PROBABILITY_EDGES), outcome)
    _add_histograms(within, "independent ", _bins(independent, CALIBRATION_EDGES), outcome)
    within["unknown"][:] = outcome.unknown.sum(axis=0)[:, None]
    within["seconds"][:] = facts.period_s * outcome.steps_driven.sum(axis=0)[:, None]
    if forecast.forecast.futures is not None:
        _add_futures(within, forecast.forecast.futures[:, 1 : last + 1], paths, outcome)
    met = events.contact != NEVER
    if met.any():
        window, stamp_ns = forecast.frames[0].world_T_grid, forecast.stamp_ns
        ends = events.contact[met], slices[:, met]
        memory.append(_Approach(stamp_ns, window, paths.at(met), *ends, [0.0], [largest[met]]))
    return sums.values


def paths_of(forecast: ScoredForecast, facts: TrialFacts) -> Paths:
    """The paths of a forecast: the same for every tracker, because they follow from the observed frame alone."""
    first, dynamic = forecast.targets[0], forecast.region_maps.dynamic
    key = hashlib.blake2b(np.packbits(first.frame.visible).tobytes(), digest_size=8)
    key.update(np.packbits(first.frame.occupied).tobytes())
    key.update(first.frame.stamp_ns.to_bytes(8, "little", signed=True))
    free = dynamic & (first.state == SEEN_FREE)
    radius, stride = facts.robot.radius / facts.cell_m, facts.robot.speed * facts.period_s / facts.cell_m
    return draw_paths(int.from_bytes(key.digest(), "little"), free, dynamic, radius, stride, longest(facts))


def robots_of(forecast: ScoredForecast, facts: TrialFacts, origin: tuple[float, float]) -> RobotPaths | None:
    """The paths of a forecast with an outcome within ROBOTS_AHEAD_S, to be shown; `origin` of the grid, metres.

    None if a forecast has too few paths, or does not reach so far.
    """
    shown, last = nearest_step(ROBOTS_AHEAD_S, facts.period_s), longest(facts)
    paths = paths_of(forecast, facts) if 1 <= shown <= last else None
    if paths is None or len(paths) < LEAST_PATHS:
        return None
    events = events_of(paths, forecast.targets[1 : last + 1], has_truth=facts.has_truth)
    occupancy = np.ascontiguousarray(forecast.forecast.occupancy[1 : last + 1])
    risks = risks_of(paths, occupancy)[0][:, shown - 1]
    contact = events.contact <= shown
    known = contact | (events.unseen > shown)
    steps = np.minimum(events.contact, shown)
    places = facts.cell_m * paths.starts + np.array(origin)
    velocities = facts.cell_m / facts.period_s * paths.strides
    found = (places, velocities, facts.period_s * steps, contact, risks)
    return RobotPaths(*(own[known].astype(np.float32) for own in found))


def alarm_risk(clears: Floats) -> float:
    """The least risk from which on at most FALSE_ALARMS of the clear paths, a histogram (B,), give an alarm."""
    rates = _curve(clears)[::-1]
    return float(PROBABILITY_EDGES[:-1][rates <= FALSE_ALARMS].min(initial=1.0))


@dataclass(frozen=True, slots=True)
class _Outcomes:
    """Outcomes (N, L) of N paths within 1..L steps: contact, clear or unknown; `slices` (K, N): those of the contact.

    `steps_driven` (N, L): until the contact, or all steps; 0 of an unknown path.
    """

    contact: NDArray[np.bool_]
    clear: NDArray[np.bool_]
    unknown: NDArray[np.bool_]
    steps_driven: NDArray[np.int64]
    slices: NDArray[np.bool_]

    @classmethod
    def of(cls, events: Events, slices: NDArray[np.bool_], last: int) -> _Outcomes:
        within = np.arange(1, last + 1)
        contact = events.contact[:, None] <= within
        clear = ~contact & (events.unseen[:, None] > within)
        driven = np.where(contact, events.contact[:, None], within) * (contact | clear)
        return cls(contact, clear, ~contact & ~clear, driven, slices)


def _slices_of(events: Events, forecast: ScoredForecast, facts: TrialFacts) -> NDArray[np.bool_]:
    """The strata (K, N) of the first cell of each path's contact."""
    strata = contact_strata(facts)
    slices = np.zeros((len(strata), len(events.hit)), np.bool_)
    met = np.flatnonzero(events.contact != NEVER)
    slices[0, met] = True
    first = forecast.targets[0]
    for i in met:
        target, cell = forecast.targets[int(events.contact[i])], int(events.hit[i])
        for name, part in _MOTIONS.items():
            slices[strata.index(name), i] = target.motion.flat[cell] == part
        if facts.has_truth:
            slices[strata.index(_HIDDEN), i] = not first.frame.visible.flat[cell]
        for label in target.labels[target.cells == cell][:1]:
            slices[strata.index(f"dynamic {facts.classes[label]}"), i] = True
    return slices


def _bins(risks: NDArray[np.floating], edges: Floats) -> NDArray[np.int64]:
    """The bin of each risk; -1 without a risk (NaN)."""
    bins = np.searchsorted(edges[1:-1], risks, side="right")
    return np.where(np.isnan(risks), -1, bins)


def _add_histograms(sums: Sums, kind: str, bins: NDArray[np.int64], outcome: _Outcomes) -> None:
    """Add paths to the histograms by risk. A path without a risk is missed if it has a contact, an alarm if not."""
    contacts, clears = sums.block(f"{kind}contacts"), sums.block(f"{kind}clears")
    highest = clears.shape[-1] - 1
    clears += _histogram(np.where(bins < 0, highest, bins), outcome.clear, highest + 1)[:, None]
    for k, chosen in enumerate(outcome.slices):
        contacts[:, k] += _histogram(np.maximum(bins, 0), outcome.contact & chosen[:, None], highest + 1)


def _histogram(
    bins: NDArray[np.int64], chosen: NDArray[np.bool_], size: int, weights: Floats | None = None
) -> NDArray[np.floating | np.integer]:
    """Numbers (L, size) of the chosen paths (N, L) by bin, or the sums of their `weights` (N,)."""
    steps = bins.shape[1]
    cells = (bins + size * np.arange(steps))[chosen]
    own = None if weights is None else np.broadcast_to(weights[:, None], bins.shape)[chosen]
    return np.bincount(cells, own, minlength=steps * size).reshape(steps, size)


def _add_futures(sums: Sums, futures: NDArray[np.generic], paths: Paths, outcome: _Outcomes) -> None:
    """Add the share of futures (F, L, M, M) in which a path has a contact, as the probability of one."""
    touched = [risks_of(paths, np.ascontiguousarray(one, np.float32))[0] >= 0.5 for one in futures]
    share = np.mean(touched, axis=0)
    clipped = np.clip(share, CLIP, 1.0 - CLIP)
    for k, chosen in enumerate(outcome.slices):
        met = outcome.contact & chosen[:, None]
        sums["sampled paths"][:, k] += (met | outcome.clear).sum(axis=0)
        sums["sampled log loss"][:, k] -= np.where(met, np.log(clipped), 0.0).sum(axis=0)
        sums["sampled log loss"][:, k] -= np.where(outcome.clear, np.log(1.0 - clipped), 0.0).sum(axis=0)


def _follow(
    forecast: ScoredForecast, facts: TrialFacts, memory: list[_Approach], occupancy: NDArray[np.float32], sums: Sums
) -> None:
    """Follow earlier paths to their contacts through this forecast, and add the lead times of those that had theirs."""
    for approach in tuple(memory):
        since_s = (forecast.stamp_ns - approach.stamp_ns) / 1e9
        gone = round(since_s / facts.period_s)
        if gone >= len(occupancy):
            _add_lead_times(approach, facts, sums)
            memory.remove(approach)
            continue
        shift = shift_between(approach.window, forecast.frames[0].world_T_grid, facts.cell_m)
        size = occupancy.shape[-1]
        paths = approach.paths.later(gone, shift.rows, shift.columns, size)
        risks = np.zeros_like(approach.risks[0])
        risks[:, gone:] = risks_of(paths, occupancy[: len(occupancy) - gone])[0]
        approach.since_s.append(since_s)
        approach.risks.append(risks)


def _add_lead_times(approach: _Approach, facts: TrialFacts, sums: Sums) -> None:
    """Add the seconds from the first forecast whose alarm stays on until the contact, by the threshold of the alarm.

    The alarm stays on from a forecast on if this one and all later ones before the contact have a risk of at least the
    threshold: the smallest of these risks decides.
    """
    risks, since_s = np.stack(approach.risks), np.array(approach.since_s)[:, None]
    ends_s = approach.contact * facts.period_s
    later = since_s >= ends_s
    risks[later] = np.inf  # of a forecast after the contact
    stays_on = np.minimum.accumulate(risks[::-1])[::-1]
    gains_s = np.diff(np.minimum(np.append(since_s, [[np.inf]], axis=0), ends_s), axis=0)
    within = approach.contact[:, None] <= np.arange(1, risks.shape[-1] + 1)
    lead = sums.block("lead")
    bins = _bins(stays_on, CALIBRATION_EDGES)
    for k, chosen in enumerate(approach.slices):
        met = within & chosen[:, None]
        sums["followed"][:, k] += met.sum(axis=0)
        for own, gained_s in zip(bins, gains_s, strict=True):
            lead[:, k] += _histogram(np.maximum(own, 0), met, lead.shape[-1], gained_s)


def _value(sums: Sums) -> Mapping[str, Ratio | Measure | Floats]:
    contacts, clears = sums.block("contacts"), sums.block("clears")
    number, known = contacts.sum(axis=-1), contacts.sum(axis=-1) + clears.sum(axis=-1)
    found, alarms = _curve(contacts), _curve(clears)
    independent = [_curve(sums.block(f"independent {name}")) for name in ("contacts", "clears")]
    coarse_alarms = _curve(np.add.reduceat(clears, FIRST_OF_CALIBRATION_BIN, axis=-1))
    lead_s = np.cumsum(sums.block("lead")[..., ::-1], axis=-1)
    stops = _first_at(found, alarms, NEEDLESS_AT) * clears.sum(axis=-1)
    return {
        "foreseen": Measure(_last_at(alarms, found, FALSE_ALARMS), number),
        "average_precision": Measure(area_under_precision_recall(contacts + clears, contacts), number),
        "contact_share": Ratio(number, known, counted=True),
        "roc_auc": Measure(_area(alarms, found), number),
        "false_alarms": Measure(_first_at(found, alarms, ALARMS_AT), number),
        "needless_stops": Measure(60.0 * divided(stops, sums["seconds"]), number),
        "lead_time": Measure(divided(_last_at(coarse_alarms, lead_s, FALSE_ALARMS), sums["followed"]), number),
        "independent": Measure(_last_at(independent[1], independent[0], FALSE_ALARMS), number),
        "sampled_log_loss": Ratio(sums["sampled log loss"], sums["sampled paths"]),
        "unknown": Ratio(sums["unknown"], sums["unknown"] + known, counted=True),
        "skipped": Ratio(sums["skipped"], sums["forecasts"], counted=True),
        "contacts": number,
    }


def _curve(counts: Floats) -> Floats:
    """The share (..., B) of the counts (..., B) in the highest 1, 2, ... bins; NaN without a count."""
    summed = np.cumsum(counts[..., ::-1], axis=-1)
    return divided(summed, summed[..., -1:])


def _last_at(x: Floats, y: Floats, level: float) -> Floats:
    """The highest y at x = `level` on the line from (0, 0) through the points (..., B), which do not decrease."""
    return _between(x, y, (x > level).argmax(axis=-1), level)


def _first_at(x: Floats, y: Floats, level: float) -> Floats:
    """The lowest y at x = `level`, as `_last_at`."""
    return _between(x, y, (x >= level).argmax(axis=-1), level)


def _between(x: Floats, y: Floats, end: NDArray[np.intp], level: float) -> Floats:
    """y at x = `level`, between the points `end` (...) and the one before each."""
    at = end[..., None]
    x1, y1 = (np.take_along_axis(own, at, axis=-1)[..., 0] for own in (x, y))
    x0, y0 = (np.where(end > 0, np.take_along_axis(own, np.maximum(at - 1, 0), axis=-1)[..., 0], 0.0) for own in (x, y))
    return y0 + (y1 - y0) * divided(level - x0, x1 - x0)


def _area(x: Floats, y: Floats) -> Floats:
    """The area (...) under the line from (0, 0) through the points (..., B)."""
    width = np.diff(x, axis=-1, prepend=0.0)
    height = y - np.diff(y, axis=-1, prepend=0.0) / 2
    area: Floats = (width * height).sum(axis=-1)
    return area


CONTACT_FORESIGHT = ScoreDefinition(
    name="contact_foresight",
    title="Contact foresight",
    position=25,
    outputs=(
        Output("foreseen", "Contacts foreseen", better="higher", scale="odds", tested=True, margin=0.02),
        Output("average_precision", "Contacts: average precision", better="higher", scale="odds"),
        Output("contact_share", "Share of paths with a contact", scale="odds"),
        Output("roc_auc", "Contacts: ROC AUC", better="higher", scale="odds"),
        Output("false_alarms", "False alarms, 95 % foreseen", better="lower", scale="odds"),
        Output("needless_stops", "Needless stops, 80 % foreseen", unit="1/min", better="lower", scale="log"),
        Output("lead_time", "Lead time", unit="s", better="higher", scale="log"),
        Output("independent", "Contacts foreseen, cells independent", better="higher", scale="odds"),
        Output("sampled_log_loss", "Log loss of contacts, from futures", better="lower", scale="log"),
        Output("unknown", "Share of paths left out", scale="odds"),
        Output("skipped", "Share of forecasts without paths"),
        Output("contacts", "Contacts", decimals=0),
    ),
    about="Share of the contacts of a virtual robot that are foreseen, at 5 % false alarms on clear paths. A robot is a"
    " disc that drives straight on at a constant speed; the risk of its path is the largest probability on its cells."
    " It is a ranking score: it needs no threshold and says nothing of calibration, and the world does not react to the"
    " robot. Paths on which a cell was not seen before a contact are left out, except with ground truth.",
    strata=contact_strata,
    parts=lambda facts: _PARTS,
    count=_count,
    value=_value,
    new_memory=lambda facts: [],
)
