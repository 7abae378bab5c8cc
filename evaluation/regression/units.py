"""Units of a trial: its scored frames in blocks of time, each reduced to counts by stratum and step band."""

from __future__ import annotations

import hashlib
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import polars as pl

from gridtrack.evaluation.regression.measurement import BANDS, Unit, Unmeasured
from gridtrack.evaluation.scoring.scores import CONFUSION, SCORES, ScoresError

MAX_STRATA = 100
_TYPES: dict[str, Any] = {
    "stamp_ns": pl.Int64, "delivered": pl.String, "step": pl.Int16, "log_loss": pl.Float64,
    **dict.fromkeys(CONFUSION, pl.Int32),
}  # fmt: skip


def read_units(folder: Path, horizons_s: Sequence[float], block_s: float | None, frames: int) -> tuple[Unit, ...]:
    """The units of the trial in `folder`, in the order of time; blocks of at least `block_s`, None: one for the whole.

    Raises ScoresError where the scores cannot be read, Unmeasured where they are not those of `frames` scored frames.
    """
    path = folder / SCORES
    try:
        rows = _open(path)
        deliveries = rows.filter(pl.col("step") == 0).select("stamp_ns", "delivered").unique().collect()
        _refuse_other_frames(folder.name, rows, deliveries, len(horizons_s), frames)
        stamps = sorted(zip(deliveries["stamp_ns"].to_list(), deliveries["delivered"].to_list(), strict=True))
        starts = _block_starts([stamp for stamp, _ in stamps], block_s)
        counts = _counts(rows, horizons_s, starts)
    except (pl.exceptions.PolarsError, OSError) as error:
        raise ScoresError(f"{path}: cannot be read as scores ({str(error).splitlines()[0]}); run it again") from None
    if not counts:
        raise Unmeasured([f"{folder.name}: nothing was scored beyond step 0"])
    return tuple(
        Unit(frames=len(part), delivered=_digest(part), counts=counts[unit])
        for unit, part in enumerate(_cut(stamps, starts))
    )


def band_of(horizon_s: float) -> str | None:
    """The step band in which a horizon lies; None for step 0."""
    return next((name for name, (low, high) in BANDS.items() if low < horizon_s <= high + 1e-9), None)


def _open(path: Path) -> pl.LazyFrame:
    """The rows of a trial, their types checked."""
    if not path.is_file():
        raise ScoresError(f"{path}: there is no such file: run it again")
    rows = pl.scan_parquet(path, glob=False, hive_partitioning=False)
    schema = rows.collect_schema()
    for name, kind in _TYPES.items():
        if schema.get(name) != kind:
            raise ScoresError(f"{path}: column '{name}' is {schema.get(name, 'missing')}, expected {kind}")
    if "stratum" not in schema:
        raise ScoresError(f"{path}: column 'stratum' is missing")
    return rows.select(*_TYPES, pl.col("stratum").cast(pl.String))


def _refuse_other_frames(name: str, rows: pl.LazyFrame, deliveries: pl.DataFrame, steps: int, frames: int) -> None:
    """Raises Unmeasured unless there is one row for each of `frames` frames, steps and strata, and no count below 0."""
    about = rows.select(
        rows=pl.len(),
        strata=pl.col("stratum").n_unique(),
        keys=pl.struct("stamp_ns", "step", "stratum").n_unique(),
        last_step=pl.col("step").max(),
        least=pl.min_horizontal(*(pl.col(column).min() for column in CONFUSION)),
    ).collect()
    found = about.row(0, named=True)
    expected = frames * steps * found["strata"]
    whole = found["rows"] == found["keys"] == expected and deliveries.height == frames
    if not whole or found["last_step"] != steps - 1 or found["least"] < 0 or found["strata"] > MAX_STRATA:
        raise Unmeasured([f"{name}: its scores are not those of the {frames} forecasts it tells of: run it again"])


def _block_starts(stamps: Sequence[int], block_s: float | None) -> list[int]:
    """The first scored stamp of each block: as many equal ones as fit with `block_s` each, at least one."""
    span = stamps[-1] - stamps[0]
    blocks = max(1, int(span / 1e9 / block_s)) if block_s else 1
    block_of = [min(blocks - 1, (stamp - stamps[0]) * blocks // max(1, span)) for stamp in stamps]
    return [stamp for i, stamp in enumerate(stamps) if i == 0 or block_of[i] != block_of[i - 1]]


def _cut(stamps: Sequence[tuple[int, str]], starts: Sequence[int]) -> list[list[tuple[int, str]]]:
    ends = [*starts[1:], stamps[-1][0] + 1]
    return [[one for one in stamps if start <= one[0] < end] for start, end in zip(starts, ends, strict=True)]


def _digest(stamps: Sequence[tuple[int, str]]) -> str:
    """Of the scored frames' stamps and of every frame that was delivered until then."""
    return hashlib.blake2b(repr(stamps).encode(), digest_size=16).hexdigest()


def _counts(
    rows: pl.LazyFrame, horizons_s: Sequence[float], starts: Sequence[int]
) -> dict[int, dict[str, dict[str, tuple[float, ...]]]]:
    """TP, FP, FN, TN and the log loss by unit, stratum and step band."""
    bands = {step: band for step, band in enumerate(map(band_of, horizons_s)) if band}
    summed = (
        rows.filter(pl.col("step") > 0)
        .with_columns(
            unit=pl.lit(pl.Series(starts)).search_sorted(pl.col("stamp_ns"), side="right").cast(pl.Int64) - 1,
            band=pl.col("step").replace_strict(bands, return_dtype=pl.String),
        )
        .group_by("unit", "stratum", "band")
        .agg(*(pl.col(name).cast(pl.Int64).sum() for name in CONFUSION), pl.col("log_loss").sum())
        .sort("unit", "stratum", "band")
        .collect()
    )
    order = list(BANDS)
    found: dict[int, dict[str, dict[str, tuple[float, ...]]]] = defaultdict(lambda: defaultdict(dict))
    for unit, stratum, band, *counts, log_loss in sorted(summed.iter_rows(), key=lambda r: (*r[:2], order.index(r[2]))):
        found[unit][stratum][band] = (*counts, float(f"{log_loss:.6g}"))
    return found
