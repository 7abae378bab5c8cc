"""Range errors of a laser, measured in a recording whose true scene is known."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.scan import Scan
from gridtrack.common.scene import Scene
from gridtrack.recordings.observation import reference_pose
from gridtrack.simulation.laser import sweep

BAND_M = 1.0
"""Width of a band of true range in which errors are taken to have one distribution."""
MIN_ERRORS = 1000
"""A band with fewer errors takes those of all ranges."""


@dataclass(frozen=True, slots=True)
class RangeErrors:
    """Measured less true ranges of one laser, metres, by band of true range; in the last band there is no true return.

    `values` (N,) float64, ascending within each band: -inf for an invalid range, +inf for a lost return; in the last
    band the measured range itself. Band b has `values[starts[b] : ends[b]]`; `starts`, `ends` (bands,) int64.
    """

    values: NDArray[np.float64]
    starts: NDArray[np.int64]
    ends: NDArray[np.int64]

    def bands(self, true_ranges: NDArray[np.float32]) -> NDArray[np.int64]:
        """The band (B,) of each true range (B,), +inf where no surface is within reach."""
        last = self.starts.size - 1
        nearer = np.floor(np.where(np.isfinite(true_ranges), true_ranges, 0.0) / BAND_M).astype(np.int64)
        return np.where(np.isfinite(true_ranges), np.minimum(nearer, last - 1), last)


def measure_range_errors(scans: Iterable[tuple[Scan, Scene]], every: int = 1) -> dict[str, RangeErrors]:
    """The range errors of each sensor, from every `every`-th of its scans with their true scenes."""
    found: dict[str, list[tuple[NDArray[np.float32], NDArray[np.float32]]]] = {}
    count: Counter[str] = Counter()
    for scan, scene in scans:
        if count[scan.sensor] % every == 0:
            found.setdefault(scan.sensor, []).append((true_ranges(scan, scene), scan.ranges))
        count[scan.sensor] += 1
    return {sensor: _by_band(*map(np.concatenate, zip(*pairs, strict=True))) for sensor, pairs in found.items()}


def true_ranges(scan: Scan, scene: Scene) -> NDArray[np.float32]:
    """The ranges (B,) float32, metres, that the laser of `scan` would measure of `scene` without errors."""
    ranges, _ = sweep(
        scene, reference_pose(scan), scan.angle_min, scan.angle_increment, scan.ranges.size, scan.range_max
    )
    return ranges


def _by_band(true: NDArray[np.float32], measured: NDArray[np.float32]) -> RangeErrors:
    """Sort the errors by band and then by size."""
    returned = np.isfinite(true)
    errors = measured.astype(np.float64) - np.where(returned, true, 0.0)
    errors[np.isnan(errors)] = -np.inf
    bands = 1 + int(true[returned].max(initial=0.0) // BAND_M)
    band = np.where(returned, np.where(returned, true, 0.0) // BAND_M, bands).astype(np.int64)
    order = np.lexsort((errors, band))
    edges = np.searchsorted(band[order], np.arange(bands + 2))
    values, starts, ends = errors[order], edges[:-1].copy(), edges[1:].copy()
    few = ends - starts < MIN_ERRORS
    few[-1] = False
    if few.any():
        starts[few], ends[few] = values.size, values.size + int(returned.sum())
        values = np.concatenate([values, np.sort(errors[returned])])
    return RangeErrors(values, starts, ends)
