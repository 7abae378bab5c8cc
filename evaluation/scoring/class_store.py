"""The class store: two Parquet files of a trial with counts of the cells whose class is known.

`classes.parquet` counts the cells of each class that were called occupied, `semantics.parquet` true by predicted
classes (`results.columns` declares the columns). Rows that count nothing are not written.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pyarrow as pa
from numpy.typing import NDArray

from gridtrack.evaluation.results.columns import CLASSES_TABLE, FOUND, SEMANTICS_TABLE, ParquetTable
from gridtrack.evaluation.scoring.score_store import ScoresError
from gridtrack.evaluation.scoring.semantics import VISIBILITIES
from gridtrack.evaluation.scoring.store_writer import StoreWriter


class ClassWriter(StoreWriter):
    """Writes one trial's counts by class."""

    def __init__(self, folder: Path, classes: Sequence[str], semantics: bool) -> None:
        """`classes` of the recording; `semantics`: whether the tracker gives class probabilities."""
        super().__init__(folder)
        self._names = list(classes)
        self._classes = self._rows_of(CLASSES_TABLE)
        self._semantics = self._rows_of(SEMANTICS_TABLE) if semantics else None

    def add_found(self, stamp_ns: int, found: NDArray[np.int32]) -> None:
        """Add `found` (S, visibility, K, 4), as of `semantics.count_found`, for the forecast made at `stamp_ns`."""
        step, kind, label = np.nonzero(found.any(axis=-1))
        counts = found[step, kind, label]
        rows = self._key(stamp_ns, step, kind) | {"class": _named(label, self._names)}
        self._classes.append(rows | {name: counts[:, i] for i, name in enumerate(FOUND)})

    def add_semantics(self, stamp_ns: int, confusion: NDArray[np.int32], log_loss: NDArray[np.float64]) -> None:
        """Add the result of `semantics.count_classes` for the forecast made at `stamp_ns`."""
        assert self._semantics is not None, "a tracker without semantics has none to count"
        step, kind, true, predicted = where = np.nonzero(confusion)
        rows = self._key(stamp_ns, step, kind)
        rows |= {"true": _named(true, self._names), "predicted": _named(predicted, self._names)}
        self._semantics.append(rows | {"cells": confusion[where], "log_loss": log_loss[where]})

    def _key(self, stamp_ns: int, step: NDArray[np.int64], kind: NDArray[np.int64]) -> dict[str, Any]:
        return {
            "stamp_ns": np.full(step.size, stamp_ns),
            "step": step.astype(np.int16),
            "kind": _named(kind, list(VISIBILITIES)),
        }


def _named(index: NDArray[np.int64], names: list[str]) -> Any:
    """Indices as names; null for an index beyond them: a class that the recording does not have."""
    beyond = index >= len(names)
    return pa.DictionaryArray.from_arrays(pa.array(np.where(beyond, 0, index).astype(np.int16), mask=beyond), names)


@dataclass(frozen=True, slots=True)
class SemanticsCounts:
    """Counts of a trial's class probabilities, pooled over its forecasts, for S steps, both visibilities and K classes.

    `confusion` (S, visibility, K, K+1) int64; `log_loss` (S, visibility) float64 summed over cells, nats;
    `scan_log_loss` (S, visibility) summed over the scans, the mean over the cells of each; `scans` (S, visibility)
    int64: those with any cell.
    """

    confusion: NDArray[np.int64]
    log_loss: NDArray[np.float64]
    scan_log_loss: NDArray[np.float64]
    scans: NDArray[np.int64]

    def at(self, steps: list[int]) -> SemanticsCounts:
        """The counts of these steps only, in their order."""
        return SemanticsCounts(
            self.confusion[steps], self.log_loss[steps], self.scan_log_loss[steps], self.scans[steps]
        )


def add_semantics(counts: Sequence[SemanticsCounts]) -> SemanticsCounts:
    """The sum of the counts of several trials."""
    first, *others = counts
    return SemanticsCounts(
        sum((other.confusion for other in others), first.confusion),
        sum((other.log_loss for other in others), first.log_loss),
        sum((other.scan_log_loss for other in others), first.scan_log_loss),
        sum((other.scans for other in others), first.scans),
    )


def read_semantics(folder: Path, steps: int, classes: Sequence[str]) -> SemanticsCounts | None:
    """Counts of a trial's class probabilities; None where its tracker gives none. Raises ScoresError."""
    path = folder / SEMANTICS_TABLE.file
    if not path.exists():
        return None
    names = list(classes)
    rows = _scan(path, SEMANTICS_TABLE)
    entries = rows.group_by("step", "kind", "true", "predicted").agg(pl.col("cells").cast(pl.Int64).sum())
    scans = rows.group_by("stamp_ns", "step", "kind").agg(pl.col("log_loss").sum(), pl.col("cells").sum())
    per_step = scans.group_by("step", "kind").agg(
        pl.col("log_loss").sum(), scan_log_loss=(pl.col("log_loss") / pl.col("cells")).sum(), scans=pl.len()
    )
    counts = SemanticsCounts(
        np.zeros((steps + 1, len(VISIBILITIES), len(names), len(names) + 1), np.int64),
        np.zeros((steps + 1, len(VISIBILITIES))),
        np.zeros((steps + 1, len(VISIBILITIES))),
        np.zeros((steps + 1, len(VISIBILITIES)), np.int64),
    )
    try:
        for step, kind, true, predicted, cells in entries.collect().iter_rows():
            column = len(names) if predicted is None else names.index(predicted)
            counts.confusion[_within(step, steps), VISIBILITIES.index(kind), names.index(true), column] = cells
        for step, kind, log_loss, scan_log_loss, scored in per_step.collect().iter_rows():
            at = _within(step, steps), VISIBILITIES.index(kind)
            counts.log_loss[at], counts.scan_log_loss[at], counts.scans[at] = log_loss, scan_log_loss, scored
    except (pl.exceptions.PolarsError, OSError, ValueError) as error:
        raise _unreadable(path, error) from None
    return counts


def read_scan_losses(folder: Path, stamps_ns: NDArray[np.int64], steps: int) -> NDArray[np.float32]:
    """Mean log loss of each scan, nats, and 1; 0 and 0 where the class of no cell is known: (F, S, visibility, 2).

    `stamps_ns` (F,) int64 are those of the frames forecast from, increasing. Raises ScoresError.
    """
    losses = np.zeros((stamps_ns.size, steps + 1, len(VISIBILITIES), 2), np.float32)
    path = folder / SEMANTICS_TABLE.file
    rows = _scan(path, SEMANTICS_TABLE).group_by("stamp_ns", "step", "kind")
    try:
        scans = rows.agg(pl.col("log_loss").sum() / pl.col("cells").sum()).collect()
        frame = _found_at(scans["stamp_ns"].to_numpy(), stamps_ns)
        step = [_within(step, steps) for step in scans["step"]]
        kind = [VISIBILITIES.index(kind) for kind in scans["kind"]]
    except (pl.exceptions.PolarsError, OSError, ValueError) as error:
        raise _unreadable(path, error) from None
    losses[frame, step, kind] = np.stack([scans["log_loss"].to_numpy(), np.ones(len(scans))], axis=-1)
    return losses


def read_found(folder: Path, steps: int, classes: Sequence[str]) -> NDArray[np.int64]:
    """Counts FOUND (S, visibility, K, 4) int64 of a trial by class, pooled over its forecasts. Raises ScoresError."""
    names = list(classes)
    found = np.zeros((steps + 1, len(VISIBILITIES), len(names), len(FOUND)), np.int64)
    path = folder / CLASSES_TABLE.file
    rows = _scan(path, CLASSES_TABLE).group_by("step", "kind", "class")
    try:
        together = rows.agg(pl.col(name).cast(pl.Int64).sum() for name in FOUND).collect()
        for step, kind, name, *counts in together.iter_rows():
            found[_within(step, steps), VISIBILITIES.index(kind), names.index(name)] = counts
    except (pl.exceptions.PolarsError, OSError, ValueError) as error:
        raise _unreadable(path, error) from None
    return found


def _scan(path: Path, table: ParquetTable) -> pl.LazyFrame:
    """The rows of a file, read lazily, names as strings. Raises ScoresError unless its columns are those of `table`."""
    try:
        rows = pl.scan_parquet(path, glob=False)
        columns = rows.collect_schema().names()
    except (pl.exceptions.PolarsError, OSError) as error:
        raise _unreadable(path, error) from None
    if tuple(columns) != table.names:
        raise ScoresError(f"{path}: columns {', '.join(columns)}; expected {', '.join(table.names)}: run it again")
    categories = [column.name for column in table.columns if pa.types.is_dictionary(column.type)]
    return rows.with_columns(pl.col(categories).cast(pl.String))


def _within(step: int, steps: int) -> int:
    if not 0 <= step <= steps:
        raise ValueError(f"step {step}, expected 0 to {steps}")
    return step


def _found_at(stamps: NDArray[np.int64], stamps_ns: NDArray[np.int64]) -> NDArray[np.intp]:
    """Indices of `stamps` (N,) in `stamps_ns` (F,), which increase."""
    at = np.searchsorted(stamps_ns, stamps)
    if not np.isin(stamps, stamps_ns).all():
        raise ValueError("a stamp at which no forecast was scored")
    return at


def _unreadable(path: Path, error: Exception) -> ScoresError:
    return ScoresError(f"{path}: cannot be read as counts of classes ({str(error).splitlines()[0]}); run it again")
