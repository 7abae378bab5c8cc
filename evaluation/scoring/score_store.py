"""The scores store: counts per scored frame, histograms per second, in two Parquet files of a trial's folder.

They hold counts, not averages: every score, curve and resampling is computed from them without running a tracker
again (`results.columns` declares the columns). Rows are written in groups, so memory does not grow.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import ArrowException, parquet

from gridtrack.common.errors import GridtrackError
from gridtrack.common.files import atomic_write
from gridtrack.evaluation.results.columns import (
    CONFUSION,
    CONFUSION_AT_HALF,
    HISTOGRAM_TABLE,
    PROBABILITY_BINS,
    SCORES_TABLE,
    ParquetTable,
)
from gridtrack.evaluation.scoring.counting import Tally
from gridtrack.evaluation.scoring.strata import STRATA, STRATA_WITH_TRUTH
from gridtrack.evaluation.scoring.thresholds import Thresholds, half

ROW_GROUP = 64
"""Scored frames, or seconds of histogram, that are kept in memory before they are written."""

_STRATUM_INDEX = {name: i for i, name in enumerate(STRATA_WITH_TRUTH)}


class ScoresError(GridtrackError):
    """A scores store that cannot be read."""


class ScoreWriter:
    """Writes the counts of one trial's scored frames; on closing both files are complete, however the trial ended."""

    def __init__(self, folder: Path, steps: int, thresholds: Thresholds) -> None:
        self._steps = steps
        self._strata = thresholds.strata
        self._bins = thresholds.bins
        self._half = half(steps, self._strata).bins
        self._second: int | None = None
        self._in_second = Tally.empty(steps, self._strata)
        self._files = ExitStack()
        self._scores = self._files.enter_context(RowGroups(folder, SCORES_TABLE))
        self._histogram = self._files.enter_context(RowGroups(folder, HISTOGRAM_TABLE))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._files:
            self._close_second()

    def add(self, stamp_ns: int, delivered: str, tally: Tally) -> None:
        """Add the counts of the forecast made at `stamp_ns`.

        `delivered` is the digest of the frames delivered up to its last step. Stamps must not decrease.
        """
        second = stamp_ns // 1_000_000_000
        if second != self._second:
            self._close_second()
            self._second = second
        self._in_second.add(tally)
        rows = self._rows()
        counts = np.concatenate([tally.confusion(self._bins), tally.confusion(self._half)], axis=-1)
        for i, name in enumerate(CONFUSION + CONFUSION_AT_HALF):
            rows[name] = counts[..., i].ravel()
        rows["stamp_ns"] = np.full(len(rows["step"]), stamp_ns)
        rows["delivered"] = [delivered] * len(rows["step"])
        rows["squared_error"] = tally.squared_error.ravel()
        rows["log_loss"] = tally.log_loss.ravel()
        self._scores.append(rows)

    def _rows(self) -> dict[str, Any]:
        """Step and stratum of each row: steps x strata, strata varying fastest."""
        steps, strata = np.indices((self._steps + 1, len(self._strata)), np.int16).reshape(2, -1)
        names = pa.DictionaryArray.from_arrays(strata.astype(np.int8), list(self._strata))
        return {"step": steps, "stratum": names}

    def _close_second(self) -> None:
        if self._second is None:
            return
        rows = self._rows()
        rows["second"] = np.full(len(rows["step"]), self._second)
        histograms = {
            "count": self._in_second.cells,
            "positives": self._in_second.positives,
            "p_sum": self._in_second.p_sum,
        }
        for name, values in histograms.items():
            value_type = HISTOGRAM_TABLE.type_of(name).value_type
            rows[name] = pa.FixedSizeListArray.from_arrays(pa.array(values.ravel(), value_type), PROBABILITY_BINS)
        self._histogram.append(rows)
        self._in_second = Tally.empty(self._steps, self._strata)
        self._second = None


class RowGroups:
    """A Parquet file of a trial, written one row group at a time, under a temporary name until it is complete."""

    def __init__(self, folder: Path, table: ParquetTable) -> None:
        self._schema = table.schema
        self._file = ExitStack()
        file = self._file.enter_context(atomic_write(folder / table.file))
        self._writer = parquet.ParquetWriter(file, self._schema, compression="zstd")
        self._batches: list[Any] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        with self._file:
            self._flush()
            self._writer.close()

    def append(self, columns: dict[str, Any]) -> None:
        """Add rows, given as columns of equal length."""
        self._batches.append(pa.table([columns[name] for name in self._schema.names], schema=self._schema))
        if len(self._batches) == ROW_GROUP:
            self._flush()

    def _flush(self) -> None:
        if self._batches:
            self._writer.write_table(pa.concat_tables(self._batches))
            self._batches.clear()


def read_tally(folder: Path, steps: int, strata: tuple[str, ...] = STRATA) -> Tally:
    """Counts of a trial in `strata`, pooled over its scored frames. Raises ScoresError."""
    if not set(strata) <= set(STRATA_WITH_TRUTH):
        raise ScoresError(f"{folder}: strata {', '.join(strata)}; expected some of {', '.join(STRATA_WITH_TRUTH)}")
    tally = Tally.empty(steps, STRATA_WITH_TRUTH)
    for columns in _batches(folder, SCORES_TABLE, ["squared_error", "log_loss"], steps):
        np.add.at(tally.squared_error, columns["where"], columns["squared_error"])
        np.add.at(tally.log_loss, columns["where"], columns["log_loss"])
    for columns in _batches(folder, HISTOGRAM_TABLE, ["count", "positives", "p_sum"], steps):
        np.add.at(tally.cells, columns["where"], columns["count"])
        np.add.at(tally.positives, columns["where"], columns["positives"])
        np.add.at(tally.p_sum, columns["where"], columns["p_sum"])
    return tally.of(strata)


def read_deliveries(folder: Path) -> dict[int, str]:
    """Digest of the frames delivered for each scored frame, by its stamp. Raises ScoresError."""
    deliveries: dict[int, str] = {}
    for batch in _read(folder, SCORES_TABLE, ["stamp_ns", "delivered"]):
        deliveries.update(zip(batch["stamp_ns"].to_pylist(), batch["delivered"].to_pylist(), strict=True))
    return deliveries


def _batches(folder: Path, table: ParquetTable, names: list[str], steps: int) -> Iterator[dict[str, Any]]:
    """Columns as numpy arrays, lists as (rows, B), with `where`: the rows' (step, stratum) as an index."""
    path = folder / table.file
    for batch in _read(folder, table, ["step", "stratum", *names]):
        step = batch["step"].to_numpy().astype(np.int64)
        if len(step) and not 0 <= step.min() <= step.max() <= steps:
            raise ScoresError(f"{path}: steps {step.min()} to {step.max()}, expected 0 to {steps}")
        strata = np.array([_STRATUM_INDEX.get(name, -1) for name in batch["stratum"].to_pylist()], np.int64)
        if (strata < 0).any():
            raise ScoresError(f"{path}: a stratum other than {', '.join(STRATA_WITH_TRUTH)}")
        yield {"where": (step, strata), **{name: _as_numpy(batch[name]) for name in names}}


def _as_numpy(column: Any) -> NDArray[Any]:
    if pa.types.is_fixed_size_list(column.type):
        return np.asarray(column.flatten()).reshape(len(column), -1)
    return np.asarray(column)


def _read(folder: Path, table: ParquetTable, names: list[str]) -> Iterator[Any]:
    """Batches of these columns, their types checked. Raises ScoresError."""
    path = folder / table.file
    try:
        with parquet.ParquetFile(path) as file:
            for name in names:
                if file.schema_arrow.field(name).type != table.type_of(name):
                    raise ScoresError(f"{path}: column '{name}' is {file.schema_arrow.field(name).type}")
            yield from file.iter_batches(batch_size=8192, columns=names)
    except (OSError, ArrowException, KeyError) as error:
        raise ScoresError(f"{path}: cannot be read as scores ({str(error).splitlines()[0]}); run it again") from None
