"""The scores store: counts per scored frame, histograms per second, in two Parquet files of a trial's folder.

They hold counts, not averages, so every score, curve and resampling follows from them without running a tracker again
(docs/run-folder.md lists the columns). Rows are written in groups as they come, so memory does not grow.
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
from gridtrack.evaluation.scoring.counting import PROBABILITY_BINS, Tally
from gridtrack.evaluation.scoring.strata import STRATA, STRATA_WITH_TRUTH
from gridtrack.evaluation.scoring.thresholds import Thresholds, half

SCORES, HISTOGRAM = "scores.parquet", "histogram.parquet"
ROW_GROUP = 64
"""Scored frames, or seconds of histogram, that are held in memory before they are written."""

CONFUSION = ("tp", "fp", "fn", "tn")
CONFUSION_AT_HALF = tuple(f"{name}_half" for name in CONFUSION)

_STRATUM = pa.dictionary(pa.int8(), pa.string())
_STRATUM_INDEX = {name: i for i, name in enumerate(STRATA_WITH_TRUTH)}
_SCORES_SCHEMA = pa.schema(
    [("stamp_ns", pa.int64()), ("delivered", pa.string()), ("step", pa.int16()), ("stratum", _STRATUM)]
    + [(name, pa.int32()) for name in CONFUSION + CONFUSION_AT_HALF]
    + [("squared_error", pa.float64()), ("log_loss", pa.float64())]
)
_BINS_OF_COUNTS, _BINS_OF_SUMS = pa.list_(pa.int32(), PROBABILITY_BINS), pa.list_(pa.float64(), PROBABILITY_BINS)
_HISTOGRAM_SCHEMA = pa.schema(
    [
        ("second", pa.int64()),
        ("step", pa.int16()),
        ("stratum", _STRATUM),
        ("count", _BINS_OF_COUNTS),
        ("positives", _BINS_OF_COUNTS),
        ("p_sum", _BINS_OF_SUMS),
    ]
)


class ScoresError(GridtrackError):
    """A scores store that cannot be read."""


class ScoreWriter:
    """Writes the counts of one trial's scored frames; closing it leaves two whole files, however the trial ended."""

    def __init__(self, folder: Path, steps: int, thresholds: Thresholds) -> None:
        self._steps = steps
        self._strata = thresholds.strata
        self._bins = thresholds.bins
        self._half = half(steps, self._strata).bins
        self._second: int | None = None
        self._in_second = Tally.empty(steps, self._strata)
        self._files = ExitStack()
        self._scores = self._files.enter_context(RowGroups(folder / SCORES, _SCORES_SCHEMA))
        self._histogram = self._files.enter_context(RowGroups(folder / HISTOGRAM, _HISTOGRAM_SCHEMA))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._files:
            self._close_second()

    def add(self, stamp_ns: int, delivered: str, tally: Tally) -> None:
        """Take in what was counted for the forecast made at `stamp_ns`.

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
        """The columns that name each row: steps x strata, strata running fastest."""
        steps, strata = np.indices((self._steps + 1, len(self._strata)), np.int16).reshape(2, -1)
        names = pa.DictionaryArray.from_arrays(strata.astype(np.int8), list(self._strata))
        return {"step": steps, "stratum": names}

    def _close_second(self) -> None:
        if self._second is None:
            return
        rows = self._rows()
        rows["second"] = np.full(len(rows["step"]), self._second)
        for name, values, kind in (
            ("count", self._in_second.cells, pa.int32()),
            ("positives", self._in_second.positives, pa.int32()),
            ("p_sum", self._in_second.p_sum, pa.float64()),
        ):
            rows[name] = pa.FixedSizeListArray.from_arrays(pa.array(values.ravel(), kind), PROBABILITY_BINS)
        self._histogram.append(rows)
        self._in_second = Tally.empty(self._steps, self._strata)
        self._second = None


class RowGroups:
    """A Parquet file under a temporary name until it is whole, written one row group at a time."""

    def __init__(self, path: Path, schema: Any) -> None:
        self._path = path
        self._partial = path.with_name(path.name + ".partial")
        self._schema = schema
        self._writer = parquet.ParquetWriter(self._partial, schema, compression="zstd")
        self._batches: list[Any] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._flush()
        self._writer.close()
        self._partial.replace(self._path)

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
    """Everything that a trial counted in `strata`, pooled over its scored frames. Raises ScoresError."""
    if not set(strata) <= set(STRATA_WITH_TRUTH):
        raise ScoresError(f"{folder}: strata {', '.join(strata)}; expected some of {', '.join(STRATA_WITH_TRUTH)}")
    tally = Tally.empty(steps, STRATA_WITH_TRUTH)
    for columns in _batches(folder / SCORES, ["squared_error", "log_loss"], steps):
        np.add.at(tally.squared_error, columns["where"], columns["squared_error"])
        np.add.at(tally.log_loss, columns["where"], columns["log_loss"])
    for columns in _batches(folder / HISTOGRAM, ["count", "positives", "p_sum"], steps):
        np.add.at(tally.cells, columns["where"], columns["count"])
        np.add.at(tally.positives, columns["where"], columns["positives"])
        np.add.at(tally.p_sum, columns["where"], columns["p_sum"])
    return tally.of(strata)


def read_deliveries(folder: Path) -> dict[int, str]:
    """Per scored frame: its stamp, and the digest of the frames delivered for it. Raises ScoresError."""
    deliveries: dict[int, str] = {}
    for batch in _read(folder / SCORES, ["stamp_ns", "delivered"]):
        deliveries.update(zip(batch["stamp_ns"].to_pylist(), batch["delivered"].to_pylist(), strict=True))
    return deliveries


def _batches(path: Path, names: list[str], steps: int) -> Iterator[dict[str, Any]]:
    """Columns as numpy arrays, lists as (rows, B), with `where`: the rows' (step, stratum) as an index."""
    for batch in _read(path, ["step", "stratum", *names]):
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


def _read(path: Path, names: list[str]) -> Iterator[Any]:
    """Batches of these columns, their types checked. Raises ScoresError."""
    expected = {**{f.name: f.type for f in _SCORES_SCHEMA}, **{f.name: f.type for f in _HISTOGRAM_SCHEMA}}
    try:
        with parquet.ParquetFile(path) as file:
            for name in names:
                if file.schema_arrow.field(name).type != expected[name]:
                    raise ScoresError(f"{path}: column '{name}' is {file.schema_arrow.field(name).type}")
            yield from file.iter_batches(batch_size=8192, columns=names)
    except (OSError, ArrowException, KeyError) as error:
        raise ScoresError(f"{path}: cannot be read as scores ({str(error).splitlines()[0]}); run it again") from None
