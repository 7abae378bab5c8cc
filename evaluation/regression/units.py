"""Statistical units of a tracker's trials, each reduced to counts by stratum and step band."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.regression.measurement import BANDS, BandCounts, ScanLosses, UnitCounts, Unmeasured
from gridtrack.evaluation.results.columns import CONFUSION, SEMANTICS_TABLE
from gridtrack.evaluation.scoring.class_store import read_scan_losses
from gridtrack.evaluation.scoring.semantics import VISIBILITIES
from gridtrack.evaluation.statistics.frame_counts import FrameCounts, read_frame_counts
from gridtrack.evaluation.statistics.jackknife import COUNTS

CONFUSION_COLUMNS = [COUNTS.index(name) for name in CONFUSION]
LOG_LOSS = COUNTS.index("log_loss")


@dataclass(frozen=True, slots=True)
class ScoredTrial:
    """The counts of a trial at each of its F frames, in its strata, at its steps' horizons.

    `scan_losses` (F, S, visibility, 2): mean log loss of each scan's classes, nats, and 1; zeros where no class is
    known. None for a tracker without classes.
    """

    frames: FrameCounts
    horizons_s: tuple[float, ...]
    strata: tuple[str, ...]
    scan_losses: NDArray[np.float32] | None


def read_scored_trial(folder: Path, horizons_s: Sequence[float], strata: tuple[str, ...], frames: int) -> ScoredTrial:
    """The counts of the trial in `folder`.

    Raises ScoresError where the scores cannot be read, Unmeasured where they are not those of `frames` scored frames.
    """
    steps = len(horizons_s) - 1
    scored = read_frame_counts(folder, steps, strata)
    if len(scored.stamps_ns) != frames or (scored.counts[..., CONFUSION_COLUMNS] < 0).any():
        raise Unmeasured(
            [f"{folder.name}: its scores are not those of the {frames} forecasts of its record: run it again"]
        )
    has_classes = (folder / SEMANTICS_TABLE.file).exists()
    losses = read_scan_losses(folder, scored.stamps_ns, steps) if has_classes else None
    return ScoredTrial(scored, tuple(horizons_s), strata, losses)


def units_by_recording(
    trials: Mapping[str, ScoredTrial], numbers: Mapping[str, NDArray[np.int64]]
) -> dict[str, tuple[UnitCounts, ...]]:
    """The units of one tracker's trials by recording, in the order of time; `numbers` has the unit of each frame."""
    return {
        name: tuple(_unit_counts(trial, int(unit), numbers[name] == unit) for unit in np.unique(numbers[name]))
        for name, trial in trials.items()
    }


def band_of(horizon_s: float) -> str | None:
    """The step band of a horizon; None for step 0."""
    return next((name for name, (low, high) in BANDS.items() if low < horizon_s <= high + 1e-9), None)


def _unit_counts(trial: ScoredTrial, unit: int, members: NDArray[np.bool_]) -> UnitCounts:
    scored = trial.frames.at(members)
    per_step = scored.counts.sum(axis=0, dtype=np.float64)
    steps = _steps_by_band(trial.horizons_s)
    counts: dict[str, dict[str, BandCounts]] = {stratum: {} for stratum in trial.strata}
    for band, its in steps.items():
        for stratum, sums in zip(trial.strata, per_step[its].sum(axis=0), strict=True):
            tp, fp, fn, tn = (int(count) for count in sums[CONFUSION_COLUMNS])
            counts[stratum][band] = (tp, fp, fn, tn, _rounded(sums[LOG_LOSS]))
    return UnitCounts(
        unit=unit,
        frames=len(scored.stamps_ns),
        delivered=_digest(scored),
        counts=counts,
        classes={} if trial.scan_losses is None else _class_counts(trial.scan_losses[members], steps),
    )


def _class_counts(losses: NDArray[np.float32], steps: Mapping[str, Sequence[int]]) -> dict[str, dict[str, ScanLosses]]:
    """Sums of scan losses (F, S, visibility, 2) by visibility and band, of those with any scan."""
    counts: dict[str, dict[str, ScanLosses]] = {}
    for band, its in steps.items():
        sums = losses[:, its].sum(axis=(0, 1), dtype=np.float64)
        for visibility, (loss, scans) in zip(VISIBILITIES, sums, strict=True):
            if scans:
                counts.setdefault(visibility, {})[band] = (_rounded(loss), int(scans))
    return counts


def _steps_by_band(horizons_s: Sequence[float]) -> dict[str, list[int]]:
    bands = [band_of(horizon) for horizon in horizons_s]
    return {name: [step for step, its in enumerate(bands) if its == name] for name in BANDS if name in bands}


def _rounded(loss: float) -> float:
    """Six digits: what the order of sums changes is beyond them."""
    return float(f"{loss:.6g}")


def _digest(scored: FrameCounts) -> str:
    """A digest of the stamps of the scored frames and of every frame delivered until then."""
    frames = list(zip(scored.stamps_ns.tolist(), scored.delivered.tolist(), strict=True))
    return hashlib.blake2b(repr(frames).encode(), digest_size=16).hexdigest()
