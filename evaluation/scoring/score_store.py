"""The scores store: counts and histograms per scored frame, in two Parquet files of a trial's folder.

They hold counts, not averages: every score, curve and resampling is computed from them without running a tracker
again (`results.columns` declares the columns). `histograms` reads the second file.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray
from pyarrow import ArrowException, parquet

from gridtrack.common.errors import GridtrackError
from gridtrack.evaluation.results.columns import (
    CALIBRATION_BINS,
    CONFUSION,
    CONFUSION_AT_HALF,
    CONFUSION_LABEL_FREE,
    HISTOGRAM_TABLE,
    PROBABILITY_BINS,
    SCORES_TABLE,
    ParquetTable,
)
from gridtrack.evaluation.scoring.counting import Tally
from gridtrack.evaluation.scoring.label_free import LabelFreeThresholds
from gridtrack.evaluation.scoring.store_writer import StoreWriter, lists_of_rows, row_keys
from gridtrack.evaluation.scoring.strata import STRATA_WITH_TRUTH
from gridtrack.evaluation.scoring.thresholds import Thresholds, half

_STRATUM_INDEX = {name: i for i, name in enumerate(STRATA_WITH_TRUTH)}
_STRATA = pa.array(STRATA_WITH_TRUTH)


class ScoresError(GridtrackError):
    """A scores store that cannot be read."""


class ScoreWriter(StoreWriter):
    """Writes the counts of one trial's scored frames."""

    def __init__(self, folder: Path, steps: int, thresholds: Thresholds) -> None:
        super().__init__(folder)
        self._steps = steps
        self._strata = thresholds.strata
        self._bins = thresholds.bins
        self._half = half(steps, self._strata).bins
        self._label_free = LabelFreeThresholds(steps, self._strata)
        self._scores, self._histogram = self._rows_of(SCORES_TABLE), self._rows_of(HISTOGRAM_TABLE)

    def add(self, stamp_ns: int, delivered: str, tally: Tally, observed_ns: int) -> None:
        """Add the counts of the forecast made at `stamp_ns`, whose last frame is that of `observed_ns`.

        `delivered` is the digest of the frames delivered up to its last step. Stamps must not decrease.
        """
        rows = row_keys(stamp_ns, self._steps, self._strata)
        self._histogram.append(rows | _histogram_columns(tally))
        label_free = self._label_free.bins(stamp_ns)
        self._label_free.add(observed_ns, tally)
        counts = np.concatenate([tally.confusion(bins) for bins in (self._bins, self._half, label_free)], axis=-1)
        for i, name in enumerate(CONFUSION + CONFUSION_AT_HALF + CONFUSION_LABEL_FREE):
            rows[name] = counts[..., i].ravel()
        rows["delivered"] = [delivered] * len(rows["step"])
        rows["squared_error"] = tally.squared_error.ravel()
        rows["log_loss"] = tally.log_loss.ravel()
        self._scores.append(rows)


def _histogram_columns(tally: Tally) -> dict[str, Any]:
    """The histograms of each step and stratum: the bins that have cells, and their counts."""
    cells, positives = tally.cells.reshape(-1, PROBABILITY_BINS), tally.positives.reshape(-1, PROBABILITY_BINS)
    row, bins = np.nonzero(cells)
    columns = lists_of_rows(
        HISTOGRAM_TABLE, row, len(cells), bin=bins, count=cells[row, bins], positives=positives[row, bins]
    )
    p_sum = pa.array(tally.p_sum.ravel().astype(np.float32))
    return columns | {"p_sum": pa.FixedSizeListArray.from_arrays(p_sum, CALIBRATION_BINS)}


def read_losses(folder: Path, steps: int, strata: tuple[str, ...]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Squared error and log loss (S, K) of a trial, summed over its scored frames. Raises ScoresError."""
    sums = np.zeros((2, steps + 1, len(STRATA_WITH_TRUTH)))
    for columns in batches(folder, SCORES_TABLE, ["squared_error", "log_loss"], steps):
        for own, name in zip(sums, ("squared_error", "log_loss"), strict=True):
            np.add.at(own, columns["where"], columns[name])
    squared_error, log_loss = sums[..., [_STRATUM_INDEX[name] for name in strata]]
    return squared_error, log_loss


def read_label_free(folder: Path, steps: int, strata: tuple[str, ...]) -> NDArray[np.int64]:
    """TP, FP, FN, TN (S, K, 4) of a trial at the thresholds that need no labels. Raises ScoresError."""
    shape = steps + 1, len(STRATA_WITH_TRUTH)
    counts = np.zeros((*shape, len(CONFUSION)), np.int64)
    for columns in batches(folder, SCORES_TABLE, list(CONFUSION_LABEL_FREE), steps):
        where = np.ravel_multi_index(columns["where"], shape)
        for i, name in enumerate(CONFUSION_LABEL_FREE):
            summed = np.bincount(where, columns[name], counts[..., i].size)  # of whole numbers: exact
            counts[..., i] += summed.astype(np.int64).reshape(shape)
    return counts[:, [_STRATUM_INDEX[name] for name in strata]]


def batches(folder: Path, table: ParquetTable, names: list[str], steps: int) -> Iterator[dict[str, Any]]:
    """Columns of a file as numpy arrays, lists of one length as (rows, B), others as Arrow columns.

    With `where`: the step and the stratum, an index into STRATA_WITH_TRUTH, of each row. Raises ScoresError.
    """
    path = folder / table.file
    for batch in _read(folder, table, ["step", "stratum", *names]):
        step = batch["step"].to_numpy().astype(np.int64)
        if len(step) and not 0 <= step.min() <= step.max() <= steps:
            raise ScoresError(f"{path}: steps {step.min()} to {step.max()}, expected 0 to {steps}")
        strata = _indices(batch["stratum"], _STRATA)
        if (strata < 0).any():
            raise ScoresError(f"{path}: a stratum other than {', '.join(STRATA_WITH_TRUTH)}")
        yield {"where": (step, strata), **{name: _as_numpy(batch[name]) for name in names}}


def _indices(column: Any, among: Any) -> NDArray[np.int64]:
    """Where each value of a column stands in the array `among`; -1 for one that it lacks."""
    return np.asarray(pc.index_in(column, value_set=among).fill_null(-1), np.int64)


def _as_numpy(column: Any) -> Any:
    """A column as an array, of equally long lists as (rows, B); other lists stay an Arrow column."""
    if pa.types.is_list(column.type):
        return column
    if pa.types.is_fixed_size_list(column.type):
        return np.asarray(column.flatten()).reshape(len(column), -1)
    return np.asarray(column)


def _require_version(path: Path, table: ParquetTable, schema: Any) -> None:
    """Raises ScoresError for a file of another version of its table."""
    version = (schema.metadata or {}).get(b"version", b"1").decode(errors="replace")
    if version != str(table.version):
        raise ScoresError(
            f"{path}: version {version[:20]!r} of this file, and this gridtrack reads version {table.version}: read it"
            " with the gridtrack that wrote it, or compare again"
        )


def _read(folder: Path, table: ParquetTable, names: list[str]) -> Iterator[Any]:
    """Batches of these columns, their types checked. Raises ScoresError."""
    path = folder / table.file
    try:
        with parquet.ParquetFile(path) as file:
            _require_version(path, table, file.schema_arrow)
            for name in names:
                if file.schema_arrow.field(name).type != table.type_of(name):
                    raise ScoresError(f"{path}: column '{name}' is {file.schema_arrow.field(name).type}")
            for batch in file.iter_batches(batch_size=8192, columns=names):
                if any(column.null_count for column in batch.columns):
                    raise ScoresError(f"{path}: a value is missing; run it again")
                yield batch
    except (OSError, ArrowException, KeyError) as error:
        raise ScoresError(f"{path}: cannot be read as scores ({str(error).splitlines()[0]}); run it again") from None
