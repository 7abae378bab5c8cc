"""Scores that forgive a forecast that is right but some cells away, with their intervals.

Fractions skill score, soft IoU and beam errors of one recording, or of several pooled, from the sums of their
statistical units.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import polars as pl
from numpy.typing import NDArray

from gridtrack.evaluation.results.columns import (
    AGREEMENT,
    BEAM_ERROR_BINS,
    BEAM_ERROR_EDGES_M,
    BEAMS_TABLE,
    NEIGHBOURHOODS_TABLE,
    SCALES,
    SQUARES,
)
from gridtrack.evaluation.results.values import Curve, rounded_curve
from gridtrack.evaluation.scoring.beam_errors import BEAM_STRATA
from gridtrack.evaluation.scoring.metrics import ratio
from gridtrack.evaluation.scoring.neighbourhoods import neighbourhood_strata
from gridtrack.evaluation.scoring.score_store import ScoresError
from gridtrack.evaluation.statistics.finished_trial import FinishedTrial
from gridtrack.evaluation.statistics.frame_counts import read_rows
from gridtrack.evaluation.statistics.jackknife import (
    Floats,
    JackknifedScore,
    PairedDifferences,
    proportion_interval,
    ratio_differences,
    ratio_interval,
)
from gridtrack.evaluation.statistics.units import UnitRule, number_of_units, sum_by_unit

Ratios = dict[str, tuple[Floats, Floats]]
"""By score that is a ratio of two sums, these sums (U, ...) of units."""
ScoreWithEnds = tuple[str, Floats, Floats, Floats]
"""The name of a score in StratumScores, its value (S, K), and the ends of its interval; NaN where there is none."""
SpatialScores = dict[str, dict[str, Curve]]
"""By stratum, fields of StratumScores."""


def spatial_scores(
    trials: Sequence[FinishedTrial], stamps_ns: Sequence[NDArray[np.int64]], strata: Sequence[str], rule: UnitRule
) -> SpatialScores:
    """The scores of `trials` pooled, in `strata`; without those whose sums a trial of a run of before lacks.

    `stamps_ns` (F,) are the scored frames of each trial. Raises ScoresError.
    """
    units = rule.units_of(stamps_ns)
    found: SpatialScores = {name: {} for name in strata}
    if all((trial.folder / NEIGHBOURHOODS_TABLE.file).exists() for trial in trials):
        names = neighbourhood_strata(strata)
        sums = [_read_neighbourhoods(*one, names) for one in zip(trials, stamps_ns, strict=True)]
        add_curves(found, names, neighbourhood_scores(sum_by_unit(sums, units)))
    if all((trial.folder / BEAMS_TABLE.file).exists() for trial in trials):
        counts = np.zeros((number_of_units(units), len(trials[0].steps), len(BEAM_STRATA), BEAM_ERROR_BINS), np.int32)
        sums = [_add_beams(*one, counts) for one in zip(trials, stamps_ns, units, strict=True)]
        errors = sum_by_unit(sums, units)
        add_curves(found, BEAM_STRATA, beam_scores(errors[..., 0], errors[..., 1], counts))
    return found


def add_curves(found: SpatialScores, names: Sequence[str], scores: Iterator[ScoreWithEnds]) -> None:
    """Add `scores` in the strata `names` to those `found`, with the ends of their intervals."""
    for score, *values in scores:
        for field, value in zip((score, f"{score}_low", f"{score}_high"), values, strict=True):
            for k, name in enumerate(names):
                found[name][field] = rounded_curve(value[:, k])


def neighbourhood_scores(sums: Floats) -> Iterator[ScoreWithEnds]:
    """Fractions skill scores and soft IoU of sums (U, S, K, C) of units; C as the sums of NEIGHBOURHOODS_TABLE."""
    for name, (part, whole) in neighbourhood_ratios(sums).items():
        ends = proportion_interval(part, whole, counted=name != "soft_iou")
        yield name, ratio(part.sum(axis=0), whole.sum(axis=0)), *ends


def neighbourhood_ratios(sums: Floats) -> Ratios:
    """The sums (U, ...) of each score of sums (U, ..., C); the first is a part of the second.

    Sums of a scale are multiplied by the cells of a neighbourhood: a lone occupied cell then counts as one.
    """
    agreement, squares = sums[..., : len(SCALES)], sums[..., len(SCALES) : 2 * len(SCALES)]
    found = {
        f"fss_{scale}": (scale**2 * agreement[..., w], scale**2 * squares[..., w]) for w, scale in enumerate(SCALES)
    }
    found["soft_iou"] = agreement[..., 0] / 2, sums[..., -1]
    return {name: (np.minimum(part, whole), whole) for name, (part, whole) in found.items()}  # stored sums are rounded


def beam_ratios(late_m: Floats, early_m: Floats, beams: Floats) -> Ratios:
    """The sums (U, ...) of the mean beam error, of sums (U, ...) of errors, metres, and numbers of beams."""
    return {"beam_error": (late_m + early_m, beams)}


def spatial_differences(own: Ratios, reference: Ratios) -> dict[str, PairedDifferences]:
    """Differences (...) of the scores that both sides have, whose sums are of the same units."""
    return {name: ratio_differences(own[name], reference[name]) for name in own if name in reference}


def spatial_ratios(
    trials: Sequence[FinishedTrial],
    scored_ns: Sequence[NDArray[np.int64]],
    paired_ns: Sequence[NDArray[np.int64]],
    units: Sequence[NDArray[np.int64]],
    chosen: Sequence[tuple[int, str]],
) -> Ratios:
    """The sums (U, N) of `trials` at the `chosen` steps and strata, without scores that a trial of before lacks.

    `scored_ns` are the scored frames of each trial, `paired_ns` (F,) those of them that count, of the `units` (F,).
    Raises ScoresError.
    """
    found: Ratios = {}
    kept = [np.isin(scored, paired) for scored, paired in zip(scored_ns, paired_ns, strict=True)]
    if all((trial.folder / NEIGHBOURHOODS_TABLE.file).exists() for trial in trials):
        names = [neighbourhood_strata(trial.strata) for trial in trials]
        sums = [_read_neighbourhoods(*one) for one in zip(trials, scored_ns, names, strict=True)]
        of_frames = [_at(one[frames], chosen, own) for one, frames, own in zip(sums, kept, names, strict=True)]
        found |= neighbourhood_ratios(sum_by_unit(of_frames, units))
    if all((trial.folder / BEAMS_TABLE.file).exists() for trial in trials):
        beams = [_read_beam_numbers(*one) for one in zip(trials, scored_ns, strict=True)]
        of_frames = [_at(one[frames], chosen, BEAM_STRATA) for one, frames in zip(beams, kept, strict=True)]
        summed = sum_by_unit(of_frames, units)
        found |= beam_ratios(*np.moveaxis(summed, -1, 0))
    return found


def _at(sums: NDArray[np.floating], chosen: Sequence[tuple[int, str]], strata: Sequence[str]) -> NDArray[np.floating]:
    """The sums (F, N, C) of sums (F, S, K, C) in `strata` at the `chosen` steps and strata; 0 in one that has none."""
    found = np.zeros((len(sums), len(chosen), sums.shape[-1]), sums.dtype)
    for n, (step, name) in enumerate(chosen):
        if name in strata:
            found[:, n] = sums[:, step, strata.index(name)]
    return found


def beam_scores(late_m: Floats, early_m: Floats, counts: NDArray[np.integer]) -> Iterator[ScoreWithEnds]:
    """Mean and median size of the beam errors, and their mean with its sign, of units: sums (U, S, K), metres, and
    beams (U, S, K, B) by size.
    """
    beams = counts.sum(axis=-1).astype(np.float64)
    size = late_m + early_m
    yield "beam_error", ratio(size.sum(axis=0), beams.sum(axis=0)), *ratio_interval(size, beams)
    of_all = counts.sum(axis=0)
    without = np.stack([median_size(of_all - own) for own in counts])
    median = JackknifedScore(median_size(of_all), without, beams)
    yield "beam_error_median", median.value, *median.positive_interval()
    bias = ratio_differences((late_m, beams), (early_m, beams))
    yield "beam_bias", bias.value, bias.low, bias.high


def median_size(counts: NDArray[np.integer]) -> Floats:
    """Median (...), metres, of the beam errors counted by size (..., B): as if they lay evenly within their bin."""
    number = counts.sum(axis=-1)
    up_to = counts.cumsum(axis=-1)
    bin_ = (2 * up_to >= number[..., None]).argmax(axis=-1)
    inside = np.take_along_axis(counts, bin_[..., None], axis=-1)[..., 0]
    before = np.take_along_axis(up_to, bin_[..., None], axis=-1)[..., 0] - inside
    low, high = BEAM_ERROR_EDGES_M[bin_], BEAM_ERROR_EDGES_M[:-1][np.minimum(bin_ + 1, BEAM_ERROR_BINS - 1)]
    median: Floats = low + (high - low) * np.nan_to_num(ratio(number / 2 - before, inside))
    return np.where(number > 0, median, np.nan)


def _read_neighbourhoods(
    trial: FinishedTrial, stamps_ns: NDArray[np.int64], strata: Sequence[str]
) -> NDArray[np.float32]:
    """The sums (F, S, K, C) of a trial in `strata`. Raises ScoresError."""
    path, steps = trial.folder / NEIGHBOURHOODS_TABLE.file, trial.record.steps
    written = neighbourhood_strata(trial.strata)
    columns = (*AGREEMENT, *SQUARES, "soft_union")
    rows = read_rows(path, columns, steps, written)
    sums = rows.select(pl.col(columns).cast(pl.Float32)).to_numpy()
    refuse_other_frames(path, rows, (steps + 1) * len(written), stamps_ns)
    shaped = sums.reshape(len(stamps_ns), steps + 1, len(written), len(columns))
    return shaped[:, trial.steps][:, :, [written.index(name) for name in strata]]


def _read_beam_numbers(trial: FinishedTrial, stamps_ns: NDArray[np.int64]) -> NDArray[np.float32]:
    """Sums of the errors, late and early, and number of beams (F, S, K, 3) of a trial. Raises ScoresError."""
    rows = _beam_rows(trial, stamps_ns)
    columns = rows.select(pl.col("late_m"), pl.col("early_m"), pl.col("count").list.sum())
    sums = columns.select(pl.all().cast(pl.Float32)).to_numpy()
    return sums.reshape(len(stamps_ns), trial.record.steps + 1, len(BEAM_STRATA), 3)[:, trial.steps]


def _beam_rows(trial: FinishedTrial, stamps_ns: NDArray[np.int64]) -> pl.DataFrame:
    """The rows of the beams of a trial. Raises ScoresError."""
    path, steps = trial.folder / BEAMS_TABLE.file, trial.record.steps
    rows = read_rows(path, ("late_m", "early_m", "bin", "count"), steps, BEAM_STRATA)
    refuse_other_frames(path, rows, (steps + 1) * len(BEAM_STRATA), stamps_ns)
    return rows


def _add_beams(
    trial: FinishedTrial, stamps_ns: NDArray[np.int64], units: NDArray[np.int64], counts: NDArray[np.int32]
) -> NDArray[np.float32]:
    """Sums of the errors (F, S, K, 2), late and early, of a trial; its beams by size are added to those of its `units`
    (F,) in `counts` (U, S, K, B).

    Raises ScoresError.
    """
    rows, steps = _beam_rows(trial, stamps_ns), trial.record.steps
    shape, first = (steps + 1, len(BEAM_STRATA)), int(units.min()) if len(units) else 0
    cells = shape[0] * shape[1]
    errors = rows.select(pl.col("late_m", "early_m").cast(pl.Float32)).to_numpy()
    row, bins, beams = _entries(trial.folder / BEAMS_TABLE.file, rows)
    where = ((units[row // cells] - first) * cells + row % cells) * BEAM_ERROR_BINS + bins
    size = (int(units.max(initial=first - 1)) + 1 - first) * cells * BEAM_ERROR_BINS
    own = np.bincount(where, beams, size).reshape(-1, *shape, BEAM_ERROR_BINS)  # sums of whole numbers: exact
    counts[first : first + len(own)] += own[:, trial.steps].astype(np.int32)
    return errors.reshape(len(stamps_ns), *shape, 2)[:, trial.steps]


def _entries(path: Path, rows: pl.DataFrame) -> tuple[NDArray[np.int64], ...]:
    """Row, bin and beams (N,) of the bins that have beams. Raises ScoresError for a bin that is none."""
    try:
        entries = rows.select(pl.int_range(pl.len()).alias("row"), "bin", "count").explode("bin", "count").drop_nulls()
    except pl.exceptions.PolarsError:
        entries = None
    if entries is None or not entries["bin"].is_between(0, BEAM_ERROR_BINS - 1).all():
        raise ScoresError(f"{path}: not errors in {BEAM_ERROR_BINS} bins; run it again")
    row, bins, beams = (entries[name].to_numpy().astype(np.int64) for name in ("row", "bin", "count"))
    return row, bins, beams


def refuse_other_frames(path: Path, rows: pl.DataFrame, cells: int, stamps_ns: NDArray[np.int64]) -> None:
    """Raises ScoresError unless the frames of `cells` rows each are those that were scored."""
    if not np.array_equal(rows["stamp_ns"].gather_every(cells).to_numpy(), stamps_ns):
        raise ScoresError(f"{path}: not the frames of the scores beside it; run it again")
