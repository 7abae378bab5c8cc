"""Rows of a trial's Parquet files while they are written: in groups, so that memory does not grow."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Self

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import parquet

from gridtrack.common.files import atomic_write
from gridtrack.evaluation.results.columns import ParquetTable

ROW_GROUP = 64
"""Scored frames that are kept in memory before they are written."""


class StoreWriter:
    """The Parquet files of one trial while they are written; on leaving they are complete, however the trial ended."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._files = folder, ExitStack()

    def _rows_of(self, table: ParquetTable) -> RowGroups:
        """The file of a table."""
        return self._files.enter_context(RowGroups(self._folder, table))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._files.close()


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


def row_keys(stamp_ns: int, steps: int, strata: Sequence[str]) -> dict[str, Any]:
    """Stamp, step and stratum of the rows of one scored frame: steps 0..steps x strata, strata varying fastest."""
    step, stratum = np.indices((steps + 1, len(strata)), np.int16).reshape(2, -1)
    names = pa.DictionaryArray.from_arrays(stratum.astype(np.int8), list(strata))
    return {"stamp_ns": np.full(step.size, stamp_ns), "step": step, "stratum": names}


def lists_of_rows(
    table: ParquetTable, row: NDArray[np.int64], rows: int, **values: NDArray[np.integer]
) -> dict[str, Any]:
    """List columns of `table`, `rows` rows: by column the `values` (N,), with the `row` (N,) of each, in order."""
    ends = np.searchsorted(row, np.arange(rows + 1)).astype(np.int32)
    return {
        name: pa.ListArray.from_arrays(ends, pa.array(entries, table.type_of(name).value_type))
        for name, entries in values.items()
    }
