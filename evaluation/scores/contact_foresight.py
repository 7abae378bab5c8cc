"""Contact foresight: the contacts of a robot that a forecast foresees, at the price of needless alarms.

Virtual robots drive straight on from where they are safe. A robot that meets an occupied cell within a horizon has a
contact; one that stays on visible free cells is clear; others are unknown and left out. The risk of a path is the
largest probability on its cells, and the score ranks paths by risk. The world does not react to the robots. The ranking
of paths by a forecast is after Philion, Kar and Fidler, "Learning to evaluate perception models using planner-centric
metrics" (CVPR 2020), without a planner.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import nearest_step, shift_between
from gridtrack.common.scene import UNLABELLED
from gridtrack.evaluation.referee.referee import ScoredForecast
from gridtrack.evaluation.referee.samples import RobotPaths
from gridtrack.evaluation.referee.strata import PARTS, RANGE_NAMES, RANGES
from gridtrack.evaluation.referee.targets import SEEN_FREE
from gridtrack.evaluation.scores.cells import (
    CALIBRATION_BIN,
    CALIBRATION_BINS,
    CLIP,
    FIRST_OF_CALIBRATION_BIN,
    PROBABILITY_BINS,
    PROBABILITY_EDGES,
    bin_of,
)
from gridtrack.evaluation.scores.contact_paths import NEVER, Events, Paths, draw_paths, events_of, risks_of
from gridtrack.evaluation.scores.definition import (
    Floats,
    Measure,
    Output,
    RareEvents,
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
CONTACT_HORIZONS_S = (0.5, 1.0, 2.0)
"""The horizons of contacts, seconds; paths are as long as the last one."""
LEAST_PATHS = 50
"""A forecast with fewer paths is left out."""
FALSE_ALARMS = 0.05
"""Rate of false alarms at which foreseen contacts are counted."""
NEEDLESS_AT, ALARMS_AT = 0.8, 0.95
"""Shares of foreseen contacts at which needless stops, and the rate of false alarms, are given."""
CROWDED = 0.005
"""A frame is crowded if at least this share of its visible cells off static ones is occupied."""
_SLICES = ("dynamic", "in-motion", "standing")
_HIDDEN = "occluded dynamic"
_WITH_PEOPLE = "contacts with people"
_DISTANCES = tuple(f"contacts {name}" for name in RANGE_NAMES)
_DENSITIES = ("contacts among few", "contacts in a crowd")
_TIMES = tuple(f"contacts {begin:g}-{end:g} s ahead" for begin, end in pairwise((0.0, *CONTACT_HORIZONS_S)))
_HISTOGRAMS = {
    "contacts": PROBABILITY_BINS,
    "clears": PROBABILITY_BINS,
    "independent contacts": CALIBRATION_BINS,
    "independent clears": CALIBRATION_BINS,
}
"""Bins of the histograms by risk."""
_SHARED = ("clears", "independent clears", "unknown", "seconds")
"""Sums that are the same in all strata of a forecast."""
_PARTS = (
    *(part for name, bins in _HISTOGRAMS.items() for part in block(name, bins)),
    *block("lead", CALIBRATION_BINS),
    *("followed", "unknown", "seconds", "forecasts", "skipped", "sampled paths", "sampled log loss"),
)


def contact_strata(facts: TrialFacts) -> tuple[str, ...]:
    """All contacts; then by the first cell: in motion, standing, its distance from the sensor, hidden at first (with
    truth), of each class, and of an annotated person; by the time until the contact; and by the density of the
    frame."""
    hidden = (_HIDDEN,) if facts.has_truth else ()
    people = (_WITH_PEOPLE,) if facts.has_people else ()
    classes = (f"dynamic {name}" for name in facts.classes)
    return *_SLICES, *hidden, *classes, *people, *_DISTANCES, *_TIMES, *_DENSITIES


def longest(facts: TrialFacts) -> int:
    """The last step that has this score."""
    return min(facts.steps, nearest_step(CONTACT_HORIZONS_S[-1], facts.period_s))


def counted_steps(facts: TrialFacts) -> tuple[int, ...]:
    """The steps (H,) that have this score: those of CONTACT_HORIZONS_S, as far as forecasts reach, and the last one."""
    last = longest(facts)
    steps = {nearest_step(horizon_s, facts.period_s) for horizon_s in CONTACT_HORIZONS_S} | {last}
    return tuple(sorted(step for step in steps if 1 <= step <= last))


@dataclass(slots=True)
class _Approach:
    """The `paths` of a forecast; the risks of the paths `met` (N,) in it and in later forecasts until their contacts.

    `contact` (N,) and `slices` (K, N) are those of the contacts. `since_s` of each of the forecasts; `risks` (N, H) of
    each, within the counted steps of the first one.
    """

    stamp_ns: int
    window: SE2
    paths: Paths
    met: NDArray[np.int64]
    contact: NDArray[np.int16]
    slices: NDArray[np.bool_]
    since_s: list[float]
    risks: list[NDArray[np.float32]]


class _Driven(NamedTuple):
    """The N paths of a forecast, their events, and the risk (N, L) of each within so many steps: the largest one, and
    the one if its cells were independent."""

    paths: Paths
    events: Events
    largest: NDArray[np.float32]
    independent: NDArray[np.float64]


def _driven(forecast: ScoredForecast, facts: TrialFacts) -> _Driven | None:
    """The paths of a forecast; None with fewer than LEAST_PATHS."""
    paths = paths_of(forecast, facts)
    if len(paths) < LEAST_PATHS:
        return None
    states = np.stack([target.state for target in forecast.targets[1 : longest(facts) + 1]])
    events = events_of(paths, states, has_truth=facts.has_truth)
    return _Driven(paths, events, *risks_of(paths, np.arange(len(paths)), _ahead(forecast, facts)))


def _ahead(forecast: ScoredForecast, facts: TrialFacts) -> NDArray[np.float32]:
    """The forecast occupancy (L, M, M) of the steps that paths take."""
    return np.ascontiguousarray(forecast.forecast.occupancy[1 : longest(facts) + 1])


def _count(forecast: ScoredForecast, facts: TrialFacts, memory: list[_Approach]) -> Floats:
    """Sums (H, K, P) over the paths of a forecast; a step has contacts within so many steps.

    `memory`: approaches that have not ended.
    """
    within = Sums(np.zeros((len(counted_steps(facts)), len(contact_strata(facts)), len(_PARTS))), _PARTS)
    _follow(forecast, facts, memory, within)
    driven = _driven(forecast, facts)
    within["forecasts"][:] = 1.0
    if driven is None:
        within["skipped"][:] = 1.0
    else:
        _add_contacts(within, forecast, facts, driven, memory)
    return within.values


def _add_contacts(
    within: Sums, forecast: ScoredForecast, facts: TrialFacts, driven: _Driven, memory: list[_Approach]
) -> None:
    """Add the paths to the sums (H, K, P), and those with a contact to `memory`."""
    paths, events = driven.paths, driven.events
    steps, last = np.array(counted_steps(facts)), longest(facts)
    of_frame = _of_frame(forecast, facts)
    slices = _slices_of(events, forecast, facts) & of_frame[:, None]
    largest = np.ascontiguousarray(driven.largest[:, steps - 1])
    independent = np.ascontiguousarray(driven.independent[:, steps - 1])
    histograms = (within.block(name) for name in _HISTOGRAMS)
    counts = within["unknown"], within["seconds"]
    _add_paths(steps, largest, independent, events.contact, events.unseen, slices, *counts, *histograms)
    within["seconds"][:] *= facts.period_s
    for name in _SHARED:
        shared = within.block(name) if name in _HISTOGRAMS else within[name][..., None]
        shared[:] = shared[:, :1] * of_frame[:, None]
    if forecast.forecast.futures is not None:
        _add_futures(within, steps, forecast.forecast.futures[:, 1 : last + 1], paths, events, slices)
    met = np.flatnonzero(events.contact != NEVER)
    if met.size:
        window, ends = forecast.targets[0].frame.world_T_grid, (events.contact[met], slices[:, met])
        memory.append(_Approach(forecast.stamp_ns, window, paths, met, *ends, [0.0], [largest[met]]))


def _of_frame(forecast: ScoredForecast, facts: TrialFacts) -> NDArray[np.bool_]:
    """Whether the frame belongs to each stratum (K,): all frames do, but for a crowd, few, and people only some."""
    first, dynamic = forecast.targets[0].frame, forecast.region_maps.dynamic
    crowded = (first.occupied & dynamic).sum() >= CROWDED * (first.visible & dynamic).sum()
    left_out = [_DENSITIES[not crowded], _WITH_PEOPLE if forecast.targets[0].people is None else ""]
    return np.array([name not in left_out for name in contact_strata(facts)])


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
    shown = nearest_step(ROBOTS_AHEAD_S, facts.period_s)
    driven = _driven(forecast, facts) if 1 <= shown <= longest(facts) else None
    if driven is None:
        return None
    paths, events, risks = driven.paths, driven.events, driven.largest[:, shown - 1]
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


def _slices_of(events: Events, forecast: ScoredForecast, facts: TrialFacts) -> NDArray[np.bool_]:
    """The strata (K, N) of the first cell of each path's contact."""
    slices = {name: np.zeros(len(events.hit), np.bool_) for name in contact_strata(facts)}
    met = np.flatnonzero(events.contact != NEVER)
    step, cell = events.contact[met], events.hit[met]
    slices["dynamic"][met] = True
    regions = forecast.region_maps.visible.flat[cell]
    for band, name in enumerate(_DISTANCES):
        slices[name][met] = regions % RANGES == band
    ends = np.searchsorted([nearest_step(horizon_s, facts.period_s) for horizon_s in CONTACT_HORIZONS_S], step)
    for time, name in enumerate(_TIMES):
        slices[name][met] = ends == time
    for name in _DENSITIES:
        slices[name][met] = True
    motion = np.stack([target.motion.ravel() for target in forecast.targets])[step, cell]
    for name in ("in-motion", "standing"):
        slices[name][met] = motion == PARTS.index(name)
    if facts.has_truth:
        slices[_HIDDEN][met] = ~forecast.targets[0].frame.visible.flat[cell]
    if facts.classes:
        labels = np.full((len(forecast.targets), forecast.targets[0].state.size), UNLABELLED, np.uint8)
        for own, target in zip(labels, forecast.targets, strict=True):
            own[target.cells] = target.labels
        for number, name in enumerate(facts.classes):
            slices[f"dynamic {name}"][met] = labels[step, cell] == number
    if facts.has_people:
        nobody = np.zeros(forecast.targets[0].state.size, np.bool_)
        near = [nobody if target.people is None else target.people.near.ravel() for target in forecast.targets]
        slices[_WITH_PEOPLE][met] = np.stack(near)[step, cell]
    return np.stack(list(slices.values()))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _add_paths(  # type: ignore[no-untyped-def]
    steps,
    largest,
    independent,
    contact,
    unseen,
    slices,
    unknown,
    driven,
    contacts,
    clears,
    coarse_contacts,
    coarse_clears,
):
    """Add N paths to the histograms (H, K, B) and (H, K, C) by their risks (N, H) within `steps` (H,).

    Contacts are added in the strata `slices` (K, N), everything else in the first one. Within some steps a path has a
    contact, is clear, or is unknown. It is `driven` until the contact or for all of them. A path without a risk (NaN)
    is missed if it has a contact, an alarm if not.
    """
    for i in range(largest.shape[0]):
        for n in range(steps.size):
            met, risk, joint = contact[i] <= steps[n], float(largest[i, n]), independent[i, n]
            if not met and unseen[i] <= steps[n]:
                unknown[n, 0] += 1.0
                continue
            if math.isnan(risk):
                risk = joint = 0.0 if met else 1.0
            bin_, coarse = bin_of(risk), CALIBRATION_BIN[bin_of(joint)]
            driven[n, 0] += contact[i] if met else steps[n]
            if not met:
                clears[n, 0, bin_] += 1.0
                coarse_clears[n, 0, coarse] += 1.0
                continue
            for k in range(slices.shape[0]):
                if slices[k, i]:
                    contacts[n, k, bin_] += 1.0
                    coarse_contacts[n, k, coarse] += 1.0


def _add_futures(
    sums: Sums,
    steps: NDArray[np.int64],
    futures: NDArray[np.generic],
    paths: Paths,
    events: Events,
    slices: NDArray[np.bool_],
) -> None:
    """Add the share of futures (F, L, M, M) in which a path has a contact within `steps` (H,), as its probability."""
    in_futures = [events_of(paths, (one >= 0.5).view(np.uint8), has_truth=True).contact for one in futures]
    share = np.mean(np.array(in_futures)[..., None] <= steps, axis=0)
    clipped = np.clip(share, CLIP, 1.0 - CLIP)
    contact = events.contact[:, None] <= steps
    clear = ~contact & (events.unseen[:, None] > steps)
    for k, chosen in enumerate(slices):
        met = contact & chosen[:, None]
        sums["sampled paths"][:, k] += (met | clear).sum(axis=0)
        sums["sampled log loss"][:, k] -= np.where(met, np.log(clipped), 0.0).sum(axis=0)
        sums["sampled log loss"][:, k] -= np.where(clear, np.log(1.0 - clipped), 0.0).sum(axis=0)


def _follow(forecast: ScoredForecast, facts: TrialFacts, memory: list[_Approach], sums: Sums) -> None:
    """Follow earlier paths to their contacts through this forecast, and add the lead times of those that had theirs."""
    steps, occupancy = np.array(counted_steps(facts)), _ahead(forecast, facts)
    for approach in tuple(memory):
        since_s = (forecast.stamp_ns - approach.stamp_ns) / 1e9
        gone = round(since_s / facts.period_s)
        if gone < len(occupancy):
            shift = shift_between(approach.window, forecast.targets[0].frame.world_T_grid, facts.cell_m)
            ahead, risks = approach.contact >= gone, np.zeros_like(approach.risks[0])
            risks[ahead] = risks_of(approach.paths, approach.met[ahead], occupancy, gone, shift)[0][:, steps - 1]
            approach.since_s.append(since_s)
            approach.risks.append(risks)
            continue
        memory.remove(approach)
        ends_s = approach.contact * facts.period_s
        forecasts = steps, np.stack(approach.risks), np.array(approach.since_s)
        _add_lead_times(*forecasts, approach.contact, ends_s, approach.slices, sums.block("lead"), sums["followed"])


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _add_lead_times(steps, risks, since_s, contact, ends_s, slices, lead_s, followed):  # type: ignore[no-untyped-def]
    """Add the seconds (H, K, C) from the first forecast with an alarm that stays on until the contact, by threshold.

    The alarm stays on from a forecast on if this one and all later ones before the contact have a risk (T, N, H) of at
    least the threshold: the smallest of these risks decides.
    """
    for i in range(contact.size):
        for n in range(steps.size):
            if steps[n] < contact[i]:
                continue
            smallest, until_s = 1.0, ends_s[i]
            for t in range(since_s.size - 1, -1, -1):
                if since_s[t] >= ends_s[i]:
                    continue
                risk = float(risks[t, i, n])
                smallest = 0.0 if math.isnan(risk) else min(smallest, risk)
                for k in range(slices.shape[0]):
                    if slices[k, i]:
                        lead_s[n, k, CALIBRATION_BIN[bin_of(smallest)]] += until_s - since_s[t]
                until_s = since_s[t]
            for k in range(slices.shape[0]):
                followed[n, k] += slices[k, i]


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
    position=5,
    outputs=(
        Output(
            "foreseen",
            "Contacts foreseen",
            better="higher",
            scale="odds",
            tested=True,
            margin=0.02,
            saying="foresees {share} of 100 contacts of a robot within {ahead}, at 5 % false alarms",
        ),
        Output("average_precision", "Contacts: average precision", better="higher", scale="odds"),
        Output("contact_share", "Share of paths with a contact", scale="odds", of_trial=True),
        Output("roc_auc", "Contacts: ROC AUC", better="higher", scale="odds"),
        Output("false_alarms", "False alarms, 95 % foreseen", better="lower", scale="odds"),
        Output(
            "needless_stops",
            "Needless stops, 80 % foreseen",
            unit="1/min",
            better="lower",
            scale="log",
            decimals=1,
            beside=True,
        ),
        Output("lead_time", "Lead time", unit="s", better="higher", scale="linear"),
        Output("independent", "Contacts foreseen, cells independent", better="higher", scale="odds"),
        Output("sampled_log_loss", "Log loss of contacts, from futures", better="lower", scale="log"),
        Output("unknown", "Share of paths left out", scale="odds", of_trial=True),
        Output("skipped", "Share of forecasts without paths", of_trial=True),
        Output("contacts", "Contacts", decimals=0, of_trial=True),
    ),
    about="Share of the contacts of a virtual robot that are foreseen, at 5 % false alarms on clear paths. A robot is a"
    " disc that drives straight on at a constant speed; the risk of its path is the largest probability on its cells."
    " It is a ranking score: it needs no threshold and says nothing of calibration, and the world does not react to the"
    " robot. Paths on which a cell was not seen before a contact are left out, except with ground truth. Contacts are"
    " counted within 0.5, 1 and 2 s.",
    strata=contact_strata,
    steps=counted_steps,
    parts=lambda facts: _PARTS,
    count=_count,
    value=_value,
    new_memory=lambda facts: [],
    events=RareEvents("contacts", lambda sums: sums.block("contacts").sum(axis=-1)),
    stratum=_SLICES[0],
    horizons_s=CONTACT_HORIZONS_S,
)
