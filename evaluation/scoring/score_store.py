"""The scores store: counts and histograms per scored frame, in two Parquet files of a trial's folder.

They hold counts, not averages: every score, curve and resampling is computed from them without running a tracker
again (`results.columns` declares the columns).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
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
from gridtrack.evaluation.scoring.strata import STRATA, STRATA_WITH_TRUTH
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


def read_tally(folder: Path, steps: int, strata: tuple[str, ...] = STRATA) -> Tally:
    """Counts of a trial in `strata`, pooled over its scored frames. Raises ScoresError."""
    if not set(strata) <= set(STRATA_WITH_TRUTH):
        raise ScoresError(f"{folder}: strata {', '.join(strata)}; expected some of {', '.join(STRATA_WITH_TRUTH)}")
    tally = Tally.empty(steps, STRATA_WITH_TRUTH)
    for columns in _batches(folder, SCORES_TABLE, ["squared_error", "log_loss"], steps):
        np.add.at(tally.squared_error, columns["where"], columns["squared_error"])
        np.add.at(tally.log_loss, columns["where"], columns["log_loss"])
    for columns in _batches(folder, HISTOGRAM_TABLE, ["bin", "count", "positives", "p_sum"], steps):
        np.add.at(tally.p_sum, columns["where"], columns["p_sum"])
        step, stratum = columns["where"]
        histogram = step * len(STRATA_WITH_TRUTH) + stratum
        _add_entries(folder, columns, histogram, tally.cells.reshape(-1), tally.positives.reshape(-1))
    return tally.of(strata)


def read_called(
    folder: Path, stamps_ns: NDArray[np.int64], steps: int, stratum: str, bins: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Cells of a stratum that are called occupied at thresholds `bins` (T, S), and those of them occupied.

    (T, F, S, 2) at the scored frames `stamps_ns` (F,) and steps 0..steps. Raises ScoresError.
    """
    called = np.zeros((len(bins), len(stamps_ns), steps + 1, 2), np.int64)
    path = folder / HISTOGRAM_TABLE.file
    for columns in _batches(folder, HISTOGRAM_TABLE, ["stamp_ns", "bin", "count", "positives"], steps):
        frame = np.searchsorted(stamps_ns, columns["stamp_ns"]).clip(max=len(stamps_ns) - 1)
        if (stamps_ns[frame] != columns["stamp_ns"]).any():
            raise ScoresError(f"{path}: other frames than in {SCORES_TABLE.file}; run it again")
        row, entries, *counts = _histogram_entries(path, columns)
        step, strata = columns["where"]
        for t, threshold in enumerate(bins):
            over = (strata[row] == _STRATUM_INDEX[stratum]) & (entries >= threshold[step[row]])
            where = frame[row[over]], step[row[over]]
            np.add.at(called[t], where, np.stack([count[over] for count in counts], axis=-1))
    return called


def read_label_free(folder: Path, steps: int, strata: tuple[str, ...]) -> NDArray[np.int64]:
    """TP, FP, FN, TN (S, K, 4) of a trial at the thresholds that need no labels. Raises ScoresError."""
    counts = np.zeros((steps + 1, len(STRATA_WITH_TRUTH), len(CONFUSION)), np.int64)
    for columns in _batches(folder, SCORES_TABLE, list(CONFUSION_LABEL_FREE), steps):
        of_row = np.stack([columns[name] for name in CONFUSION_LABEL_FREE], axis=-1)
        np.add.at(counts, columns["where"], of_row)
    return counts[:, [_STRATUM_INDEX[name] for name in strata]]


def add_histograms(
    folder: Path,
    chosen: Sequence[tuple[int, str]],
    unit_of: Mapping[int, int],
    cells: NDArray[np.int64],
    positives: NDArray[np.int64],
) -> None:
    """Add a trial's histograms to `cells` and `positives` (U, N, B) of units, at the N `chosen` steps and strata.

    `unit_of` has the unit of each frame by its stamp; frames that it lacks are left out. Raises ScoresError.
    """
    steps = max(step for step, _ in chosen)
    number_of = np.full((steps + 1, len(STRATA_WITH_TRUTH)), -1)
    for number, (step, stratum) in enumerate(chosen):
        number_of[step, _STRATUM_INDEX[stratum]] = number
    stamps = pa.array(list(unit_of), pa.int64())
    numbers_of_units = np.array([*unit_of.values(), -1], np.int64)  # the last is that of a frame that it lacks
    for batch in _read(folder, HISTOGRAM_TABLE, ["stamp_ns", "step", "stratum", "bin", "count", "positives"]):
        units = numbers_of_units[_indices(batch["stamp_ns"], stamps)]
        step_of = batch["step"].to_numpy().astype(np.int64)
        strata = _indices(batch["stratum"], _STRATA)
        numbers = np.where(step_of <= steps, number_of[np.clip(step_of, 0, steps), strata], -1)
        counted = (units >= 0) & (numbers >= 0)
        columns = {name: batch[name].filter(pa.array(counted)) for name in ("bin", "count", "positives")}
        histogram = units[counted] * len(chosen) + numbers[counted]
        _add_entries(folder, columns, histogram, cells.reshape(-1), positives.reshape(-1))


def _add_entries(
    folder: Path,
    columns: Mapping[str, Any],
    histogram: NDArray[np.int64],
    cells: NDArray[np.int64],
    positives: NDArray[np.int64],
) -> None:
    """Add the entries of rows (R,) to the histograms, by number, in `cells` and `positives` (histograms * B,)."""
    row, bins, cells_of_bin, positives_of_bin = _histogram_entries(folder / HISTOGRAM_TABLE.file, columns)
    where = histogram[row] * PROBABILITY_BINS + bins
    np.add.at(cells, where, cells_of_bin)
    np.add.at(positives, where, positives_of_bin)


def _histogram_entries(path: Path, columns: Mapping[str, Any]) -> tuple[NDArray[np.int64], ...]:
    """Row, bin, cells and positives (N,) of the bins that have cells. Raises ScoresError for a bin that is none."""
    lengths = [columns[name].value_lengths().to_numpy() for name in ("bin", "count", "positives")]
    bins, cells, positives = (
        columns[name].flatten().to_numpy().astype(np.int64) for name in ("bin", "count", "positives")
    )
    if any((length != lengths[0]).any() for length in lengths) or (bins < 0).any() or (bins >= PROBABILITY_BINS).any():
        raise ScoresError(f"{path}: not histograms of {PROBABILITY_BINS} bins; run it again")
    return np.repeat(np.arange(len(lengths[0])), lengths[0]), bins, cells, positives


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
            yield from file.iter_batches(batch_size=8192, columns=names)
    except (OSError, ArrowException, KeyError) as error:
        raise ScoresError(f"{path}: cannot be read as scores ({str(error).splitlines()[0]}); run it again") from None
