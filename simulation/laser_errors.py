"""Errors of a real laser: noise, lost and invalid returns, mixed pixels, glass, and surfaces that reflect little."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from gridtrack.common.config import Settings

MIXED_GAP_M = (0.06, 2.0)
"""Depth of an edge at which a footprint on both sides may give a range in between."""
FACING_RAD, FACING_SEEN = 0.12, 0.9
"""A pane gives a return at nearly normal incidence, with this probability."""
UNKNOWN_RAD = 0.5
"""The angle of incidence of a beam whose neighbours hit something else."""
GRAZING_RAD, GRAZING_LOST = 1.45, 0.5
"""Beyond this angle of incidence, and half the range, that share of the returns is lost."""
DARK_LOST = 0.1
"""Share of returns that a dark surface loses within its reach."""


class LaserErrors(Settings):
    """How the ranges of a laser differ from the true ones.

    Not modelled: reflections in glass, motion during a revolution, and crosstalk of two lasers.
    """

    std_m: float = Field(default=0.01, ge=0.0, le=1.0)
    """Standard deviation of a range at the sensor."""
    std_per_m: float = Field(default=0.0, ge=0.0, le=0.1)
    """Its growth with the range."""
    resolution_m: float = Field(default=0.001, gt=0.0, le=0.1)
    lost: float = Field(default=0.0, ge=0.0, le=1.0)
    """Probability that a beam has no return though it hits something."""
    invalid: float = Field(default=0.0, ge=0.0, le=1.0)
    """Probability that a beam gives no information: NaN."""
    mixed: float = Field(default=0.0, ge=0.0, le=1.0)
    """Probability that a beam at an edge gives a range between both surfaces."""
    glass_seen: float = Field(default=0.3, ge=0.0, le=1.0)
    """Probability of a return from a pane, except at nearly normal incidence."""
    dark_reach: float = Field(default=0.7, ge=0.0, le=1.0)
    """Share of the maximum range up to which dark surfaces give returns."""


@dataclass(frozen=True, slots=True)
class Hits:
    """What the beams (B,) of a scan hit, free of errors.

    `ranges` (B,) float64, metres, +inf without a hit; `outline` (B,) int32 numbers what is hit, -1 without a hit;
    `behind` (B,) float64 and `behind_outline` (B,) are the same without the panes; `glass` and `dark` (B,) bool say
    what the nearest surface is, in `ranges`, and with glass what is behind it for `dark`.
    """

    ranges: NDArray[np.float64]
    outline: NDArray[np.int32]
    behind: NDArray[np.float64]
    behind_outline: NDArray[np.int32]
    glass: NDArray[np.bool_]
    dark: NDArray[np.bool_]


def measured(
    hits: Hits, errors: LaserErrors, angle_increment: float, range_max: float, random: np.random.Generator
) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """The measured ranges (B,) float32, metres, and the outline (B,) int32 of each; -1 where the return is of none.

    The numbers that are drawn depend on B only, so that a change of the scene changes no other beam.
    """
    draws = random.random((6, hits.ranges.size))
    noise = random.standard_normal(hits.ranges.size)
    incidence = incidences(hits.ranges, hits.outline, angle_increment)
    pane_seen = draws[0] < np.where(incidence < FACING_RAD, FACING_SEEN, errors.glass_seen)
    through = hits.glass & ~pane_seen
    ranges = np.where(through, hits.behind, hits.ranges)
    outline = np.where(through, hits.behind_outline, hits.outline)
    dark = hits.dark & ~(hits.glass & pane_seen)
    lost = draws[1] < errors.lost
    lost |= dark & ((ranges > errors.dark_reach * range_max) | (draws[2] < DARK_LOST))
    lost |= (incidence > GRAZING_RAD) & (ranges > range_max / 2.0) & (draws[2] < GRAZING_LOST)
    mixed_ranges = _mixed(ranges, draws[4])
    mixed = np.isfinite(mixed_ranges) & (draws[3] < errors.mixed)
    ranges = np.where(mixed, mixed_ranges, ranges)
    with np.errstate(invalid="ignore"):
        noisy = ranges + (errors.std_m + errors.std_per_m * ranges) * np.where(dark, 2.0, 1.0) * noise
        rounded = np.round(noisy / errors.resolution_m) * errors.resolution_m
    found = np.clip(rounded, 0.0, math.floor(range_max / errors.resolution_m) * errors.resolution_m)
    found = np.where(np.isfinite(ranges) & ~lost, found, np.inf)
    found = np.where(draws[5] < errors.invalid, np.nan, found)
    return found.astype(np.float32), np.where(np.isfinite(found) & ~mixed, outline, -1).astype(np.int32)


def incidences(ranges: NDArray[np.float64], outline: NDArray[np.int32], angle_increment: float) -> NDArray[np.float64]:
    """The angle (B,) between each beam and the normal of what it hits, radians, from its neighbours on the same
    outline; UNKNOWN_RAD where it has none."""
    step = np.full(ranges.size, np.inf)
    same = (outline[1:] == outline[:-1]) & (outline[1:] >= 0)
    difference = np.full(ranges.size - 1, np.inf)
    np.subtract(ranges[1:], ranges[:-1], out=difference, where=same)
    step[1:] = np.abs(difference)
    step[:-1] = np.minimum(step[:-1], np.abs(difference))
    across = np.where(np.isfinite(ranges), ranges, 1.0) * abs(angle_increment)
    return np.where(np.isfinite(step), np.arctan2(step, np.maximum(across, 1e-9)), UNKNOWN_RAD)


def _mixed(ranges: NDArray[np.float64], share: NDArray[np.float64]) -> NDArray[np.float64]:
    """The range (B,) that a footprint on this surface and on that of the next beam would give; +inf without an edge."""
    following = np.append(ranges[1:], ranges[-1:])
    with np.errstate(invalid="ignore"):
        gap = following - ranges
        at_edge = (np.abs(gap) > MIXED_GAP_M[0]) & (np.abs(gap) < MIXED_GAP_M[1])
        return np.where(at_edge, ranges + share * gap, np.inf)
