"""Statistical units of a trial: blocks of time, each reduced to counts by stratum and step band."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.regression.measurement import BANDS, BandCounts, UnitCounts, Unmeasured
from gridtrack.evaluation.results.columns import CONFUSION
from gridtrack.evaluation.statistics.frame_counts import FrameCounts, read_frame_counts
from gridtrack.evaluation.statistics.jackknife import COUNTS

CONFUSION_COLUMNS = [COUNTS.index(name) for name in CONFUSION]
LOG_LOSS = COUNTS.index("log_loss")


def read_units(
    folder: Path, horizons_s: Sequence[float], strata: tuple[str, ...], block_s: float | None, frames: int
) -> tuple[UnitCounts, ...]:
    """The units of the trial in `folder`, in order of time: blocks of at least `block_s` seconds; None: one unit.

    Raises ScoresError where the scores cannot be read, Unmeasured where they are not those of `frames` scored frames.
    """
    scored = read_frame_counts(folder, len(horizons_s) - 1, strata)
    if len(scored.stamps_ns) != frames or (scored.counts[..., CONFUSION_COLUMNS] < 0).any():
        raise Unmeasured(
            [f"{folder.name}: its scores are not those of the {frames} forecasts of its record: run it again"]
        )
    blocks = _block_numbers(scored.stamps_ns, block_s)
    return tuple(_unit_counts(scored.at(blocks == block), horizons_s, strata) for block in np.unique(blocks))


def band_of(horizon_s: float) -> str | None:
    """The step band of a horizon; None for step 0."""
    return next((name for name, (low, high) in BANDS.items() if low < horizon_s <= high + 1e-9), None)


def _block_numbers(stamps_ns: NDArray[np.int64], block_s: float | None) -> NDArray[np.int64]:
    """The block of each frame (F,): the largest number of equal blocks of at least `block_s`, and at least one."""
    since_ns = stamps_ns - stamps_ns[0]
    span_ns = max(1, int(since_ns[-1]))
    blocks = max(1, int(span_ns / 1e9 / block_s)) if block_s else 1
    numbers: NDArray[np.int64] = np.minimum(since_ns * blocks // span_ns, blocks - 1)
    return numbers


def _unit_counts(scored: FrameCounts, horizons_s: Sequence[float], strata: tuple[str, ...]) -> UnitCounts:
    per_step = scored.counts.sum(axis=0, dtype=np.float64)
    bands = [band_of(horizon) for horizon in horizons_s]
    counts: dict[str, dict[str, BandCounts]] = {stratum: {} for stratum in strata}
    for band in (name for name in BANDS if name in bands):
        steps = [step for step, its in enumerate(bands) if its == band]
        for stratum, sums in zip(strata, per_step[steps].sum(axis=0), strict=True):
            tp, fp, fn, tn = (int(count) for count in sums[CONFUSION_COLUMNS])
            counts[stratum][band] = (tp, fp, fn, tn, float(f"{sums[LOG_LOSS]:.6g}"))
    return UnitCounts(frames=len(scored.stamps_ns), delivered=_digest(scored), counts=counts)


def _digest(scored: FrameCounts) -> str:
    """A digest of the stamps of the scored frames and of every frame delivered until then."""
    frames = list(zip(scored.stamps_ns.tolist(), scored.delivered.tolist(), strict=True))
    return hashlib.blake2b(repr(frames).encode(), digest_size=16).hexdigest()
