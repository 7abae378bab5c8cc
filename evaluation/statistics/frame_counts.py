"""Counts of a trial at each scored frame, read from its scores, for resampling and for pairing with other trials."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl
from numpy.typing import NDArray

from gridtrack.evaluation.results.columns import SCORES_TABLE
from gridtrack.evaluation.scoring.score_store import ScoresError
from gridtrack.evaluation.statistics.finished_trial import FinishedTrial
from gridtrack.evaluation.statistics.jackknife import COUNTS


@dataclass(frozen=True, slots=True)
class FrameCounts:
    """Counts (F, S, K, C) float32 of the F scored frames of a trial, at S steps.

    Of occupancy, K are the strata and C is `jackknife.COUNTS`; the number of cells of a frame is exact in float32. Of
    classes, K is `semantics.VISIBILITIES` and C that of `class_store.read_scan_losses`. `stamps_ns` (F,) increase;
    `delivered` (F,) are the digests of the frames delivered up to each.
    """

    stamps_ns: NDArray[np.int64]
    delivered: NDArray[np.str_]
    counts: NDArray[np.float32]

    def at(self, frames: NDArray[np.intp] | NDArray[np.bool_]) -> FrameCounts:
        """The counts of the chosen frames."""
        return FrameCounts(self.stamps_ns[frames], self.delivered[frames], self.counts[frames])

    def of_steps(self, trial: FinishedTrial) -> FrameCounts:
        """The counts at the steps of `trial`, from those at all of its steps."""
        if trial.chosen_steps is None:
            return self
        return FrameCounts(self.stamps_ns, self.delivered, self.counts[:, trial.steps])


def read_frame_counts(folder: Path, steps: int, strata: tuple[str, ...]) -> FrameCounts:
    """The scored frames of the trial in `folder`, steps 0..steps, `strata` in the order they were written in.

    Raises ScoresError.
    """
    rows = read_rows(folder / SCORES_TABLE.file, ("delivered", *COUNTS), steps, strata)
    cells = (steps + 1) * len(strata)
    counts = rows.select(pl.col(COUNTS).cast(pl.Float32)).to_numpy()
    first = rows.gather_every(cells)
    return FrameCounts(
        first["stamp_ns"].to_numpy().astype(np.int64),
        first["delivered"].to_numpy().astype(np.str_),
        counts.reshape(len(first), steps + 1, len(strata), len(COUNTS)),
    )


def read_rows(path: Path, columns: Sequence[str], steps: int, strata: Sequence[str]) -> pl.DataFrame:
    """The rows of a file with these `columns`: every frame with steps 0..steps, each with all `strata` in order.

    Raises ScoresError.
    """
    try:
        rows = pl.read_parquet(path, columns=["stamp_ns", "step", "stratum", *columns], glob=False)
        if any(rows.null_count().row(0)):
            raise ScoresError(f"{path}: a value is missing; run it again")
        _refuse_another_order(path, rows, steps, strata)
    except (pl.exceptions.PolarsError, OSError) as error:
        raise ScoresError(f"{path}: cannot be read as scores ({str(error).splitlines()[0]}); run it again") from None
    return rows


def _refuse_another_order(path: Path, rows: pl.DataFrame, steps: int, strata: Sequence[str]) -> None:
    """Raises ScoresError unless every frame has all steps, each with all strata, and frames follow in time."""
    cells = (steps + 1) * len(strata)
    frames = len(rows) // cells
    whole = len(rows) == frames * cells
    if whole and frames:
        step, stratum = np.indices((steps + 1, len(strata))).reshape(2, -1)
        stamps = rows["stamp_ns"].to_numpy().reshape(frames, cells)
        names = rows["stratum"].cast(pl.String).to_numpy().astype(np.str_).reshape(frames, cells)
        whole = bool(
            (rows["step"].to_numpy().reshape(frames, cells) == step).all()
            and (names == np.array(strata)[stratum]).all()
            and (stamps == stamps[:, :1]).all()
            and (np.diff(stamps[:, 0]) > 0).all()
        )
    if not whole:
        raise ScoresError(f"{path}: not {steps + 1} steps of {', '.join(strata)} at every frame; run it again")


def common_frames(one: FrameCounts, other: FrameCounts) -> tuple[FrameCounts, FrameCounts]:
    """The frames of both trials with the same stamp and the same digest of delivered frames."""
    _, of_one, of_other = np.intersect1d(one.stamps_ns, other.stamps_ns, assume_unique=True, return_indices=True)
    same = one.delivered[of_one] == other.delivered[of_other]
    return one.at(of_one[same]), other.at(of_other[same])
