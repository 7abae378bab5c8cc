"""Hand-made and random frames with their regions, and the cells of each stratum by the definitions."""

from __future__ import annotations

import numpy as np

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec
from gridtrack.evaluation.referee.referee import ScoredForecast
from gridtrack.evaluation.referee.strata import CELL_KINDS, PARTS, STRATA, region_maps_of
from gridtrack.evaluation.referee.targets import NOT_SCORED
from gridtrack.evaluation.scores.definition import Sums, TrialFacts, value_of
from gridtrack.evaluation.scores.thresholds import half
from gridtrack.trackers.contract import Forecast

STATIC_CELL, DYNAMIC_CELL = (CELL_KINDS.index(name) for name in ("static", "dynamic"))


ORIGIN = SE2()


def frame(visible, occupied, stamp_ns=0, window=ORIGIN):
    """A frame of these cells (M, M), without points."""
    nothing = np.zeros((0, 2), np.float32)
    visible, occupied = np.array(visible, bool), np.array(occupied, bool)
    return GridFrame(stamp_ns, visible, occupied & visible, window, nothing, nothing, np.zeros(0, np.uint8))


def region_maps(cell_kinds, strata=STRATA):
    """Places on cells of 1 m, seen from the lower left corner."""
    cell_kinds = np.array(cell_kinds, np.uint8)
    return region_maps_of(cell_kinds, GridSpec(len(cell_kinds), 1.0, (0.0, 0.0)), np.zeros((1, 2), np.float32), strata)


def random_forecast(rng, size, steps):
    occupancy = rng.beta(0.4, 0.8, (steps + 1, size, size)).astype(np.float32)
    occupancy[rng.random(occupancy.shape) < 0.1] = 0.0
    occupancy[rng.random(occupancy.shape) < 0.1] = 1.0
    return occupancy


def members_of(cell_kinds, state, motion, ages):
    """The cells (M, M) of each stratum, by an independent implementation of the definitions."""
    rows, columns = np.indices(cell_kinds.shape) + 0.5
    distance = np.hypot(rows, columns)
    seen, hidden = state < 2, (state >= 2) & (state != NOT_SCORED)
    return {
        "visible": seen,
        "dynamic": seen & (cell_kinds == DYNAMIC_CELL),
        "static": seen & (cell_kinds == STATIC_CELL),
        "in-motion": seen & (cell_kinds == DYNAMIC_CELL) & (motion != PARTS.index("standing")),
        "standing": seen & (motion == PARTS.index("standing")),
        "visible to 5 m": seen & (distance <= 5),
        "visible 5-10 m": seen & (distance > 5) & (distance <= 10),
        "visible over 10 m": seen & (distance > 10),
        "occluded": hidden,
        "occluded dynamic": hidden & (cell_kinds == DYNAMIC_CELL),
        "occluded to 0.5 s": hidden & (ages == 0),
        "occluded 0.5-1 s": hidden & (ages == 1),
        "occluded 1-2 s": hidden & (ages == 2),
        "occluded 2-4 s": hidden & (ages == 3),
        "occluded over 4 s": hidden & (ages == 4),
    }


def scored(occupancy, targets, maps, ages=None, **parts):
    """A forecast with its targets; `parts` are its optional parts: semantics, velocity, futures."""
    ages = np.zeros(maps.visible.shape, np.uint8) if ages is None else ages
    return ScoredForecast(Forecast(occupancy, **parts), tuple(targets), maps, ages)


def facts_of(forecast, **known):
    """The facts of a trial with this forecast; thresholds of 0.5."""
    steps, strata = len(forecast.targets) - 1, forecast.region_maps.strata
    defaults = {"cell_m": 1.0, "thresholds": half(steps, strata)}
    return TrialFacts(steps=steps, strata=strata, **{**defaults, **known})


def counted(score, forecast, **known):
    """The strata of a score, and its sums (S, K, P) of one forecast."""
    facts = facts_of(forecast, **known)
    return score.strata(facts), Sums(score.count(forecast, facts, score.new_memory(facts)), score.parts(facts))


def values(score, sums):
    """The value (...) of each output of sums."""
    return {name: value_of(found) for name, found in score.value(sums).items()}
