"""The sums of a trial: one long Parquet table, from which every score and every resampling follows without a tracker.

A row is one scored frame, step, stratum and score; `part` and `value` list the sums that are not 0. `delivered` is the
hash of every frame delivered up to the last step: equal for two trackers that received the same frames. The metadata of
the table names the strata, parts and steps of each score.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final, Self

import numba
import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import ArrowException, parquet

from gridtrack.common.errors import GridtrackError
from gridtrack.common.files import atomic_write
from gridtrack.evaluation.scores.definition import Floats, Sums

SUMS_FILE = "sums.parquet"
SUMS_VERSION: Final = 2
ROW_GROUP = 64
"""Scored frames that are kept in memory before they are written."""
MAX_VALUES = 1 << 26
"""Limit of the values of a row group, which are read together: 512 MiB."""
READ_ROWS_BYTES = 256 << 20
"""Rows of all trials of a run that are kept once they are read; the others are read again."""
_NAME = pa.dictionary(pa.int16(), pa.string())
COLUMNS: dict[str, tuple[Any, str]] = {
    "stamp_ns": (pa.int64(), "stamp of frame t, from which the forecast was made"),
    "delivered": (pa.string(), "hash of every frame delivered up to t+steps"),
    "step": (pa.int16(), "n, 0 to steps"),
    "stratum": (_NAME, "name of the stratum"),
    "score": (_NAME, "name of the score"),
    "part": (pa.list_(pa.uint16()), "the parts that are not 0, as indices into `parts` of the score in the metadata"),
    "value": (pa.list_(pa.float64()), "the sum of each of these parts"),
}
"""Type and meaning of each column."""
_OF_FRAMES = ["stamp_ns", "delivered"]
_OF_SUMS = [name for name in COLUMNS if name not in ("delivered", "score")]
_METADATA = b"gridtrack"


class ScoresError(GridtrackError):
    """Sums of a trial that cannot be read."""


@dataclass(frozen=True, slots=True)
class Layout:
    """The strata (K), parts (P) and steps (S) of a score in a trial."""

    strata: tuple[str, ...]
    parts: tuple[str, ...]
    steps: tuple[int, ...]

    @property
    def rows(self) -> int:
        """Number of rows of a frame."""
        return len(self.steps) * len(self.strata)


class SumsWriter:
    """Writes the sums of one trial; on leaving the file is complete, however the trial ended."""

    def __init__(self, folder: Path, layouts: Mapping[str, Layout], steps: int) -> None:
        self._layouts = layouts
        described = {
            "version": SUMS_VERSION,
            "steps": steps,
            "scores": {name: asdict(one) for name, one in layouts.items()},
        }
        fields = [(name, kind) for name, (kind, _) in COLUMNS.items()]
        self._schema = pa.schema(fields, metadata={_METADATA: json.dumps(described)})
        self._waiting: dict[str, list[_Counted]] = {name: [] for name in layouts}
        self._file = ExitStack()
        file = self._file.enter_context(atomic_write(folder / SUMS_FILE))
        self._writer = parquet.ParquetWriter(
            file,
            self._schema,
            compression="zstd",
            use_dictionary=[name for name in COLUMNS if name not in ("part", "value")],
            use_byte_stream_split=["value.list.element"],
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        with self._file:
            for score in self._waiting:
                self._flush(score)
            self._writer.close()

    def add(self, stamp_ns: int, delivered: str, score: str, sums: Floats) -> None:
        """Add the sums (S, K, P) of a score for the forecast made at `stamp_ns`. Stamps must increase."""
        waiting = self._waiting[score]
        waiting.append(_Counted(stamp_ns, delivered, *_entries(sums.reshape(-1, sums.shape[-1]))))
        if len(waiting) == ROW_GROUP:
            self._flush(score)

    def _flush(self, score: str) -> None:
        """Write the waiting frames of a score as a row group of its own, so that scores are read one by one."""
        frames, layout = self._waiting[score], self._layouts[score]
        if not frames:
            return
        rows = len(frames) * layout.rows
        ends = np.concatenate([[0], *(frame.entries for frame in frames)]).cumsum(dtype=np.int32)
        step = np.repeat(np.array(layout.steps, np.int16), len(layout.strata))
        stratum = np.tile(np.arange(len(layout.strata), dtype=np.int16), len(layout.steps))
        columns = [
            np.repeat([frame.stamp_ns for frame in frames], step.size),
            np.repeat([frame.delivered for frame in frames], step.size),
            np.tile(step, len(frames)),
            pa.DictionaryArray.from_arrays(np.tile(stratum, len(frames)), list(layout.strata)),
            pa.DictionaryArray.from_arrays(np.zeros(rows, np.int16), [score]),
            pa.ListArray.from_arrays(ends, np.concatenate([frame.parts for frame in frames])),
            pa.ListArray.from_arrays(ends, np.concatenate([frame.values for frame in frames])),
        ]
        self._writer.write_table(pa.table(columns, schema=self._schema), row_group_size=rows)
        frames.clear()


@dataclass(frozen=True, slots=True)
class _Counted:
    """The sums of a frame until they are written: of each row its number of `entries`, and their `parts` and `values`;
    most of the sums of a histogram are 0."""

    stamp_ns: int
    delivered: str
    entries: NDArray[np.int32]
    parts: NDArray[np.uint16]
    values: Floats


@numba.njit(cache=True, nogil=True)
def _entries(sums):  # type: ignore[no-untyped-def]
    """Of each row of `sums` (N, P) the number (N,) of sums that are not 0, and their parts and values, in order."""
    numbers = np.zeros(sums.shape[0], np.int32)
    for row in range(sums.shape[0]):
        for part in range(sums.shape[1]):
            numbers[row] += sums[row, part] != 0.0
    parts, values = np.empty(numbers.sum(), np.uint16), np.empty(numbers.sum())
    entry = 0
    for row in range(sums.shape[0]):
        for part in range(sums.shape[1]):
            if sums[row, part] != 0.0:
                parts[entry], values[entry] = part, sums[row, part]
                entry += 1
    return numbers, parts, values


@dataclass(frozen=True, slots=True)
class ScoredFrames:
    """The F scored frames of a trial: `stamps_ns` (F,) increase, `delivered` (F,) are the hashes of the frames
    delivered up to each forecast's last step."""

    stamps_ns: NDArray[np.int64]
    delivered: NDArray[np.str_]

    def at(self, frames: NDArray[Any]) -> ScoredFrames:
        """The chosen frames."""
        return ScoredFrames(self.stamps_ns[frames], self.delivered[frames])

    def common_with(self, other: ScoredFrames) -> NDArray[np.bool_]:
        """Which of these frames (F,) the other has too: with the same stamp, after the same frames."""
        known = dict(zip(other.stamps_ns.tolist(), other.delivered.tolist(), strict=True))
        mine = zip(self.stamps_ns.tolist(), self.delivered.tolist(), strict=True)
        return np.fromiter((known.get(stamp) == digest for stamp, digest in mine), np.bool_, len(self.stamps_ns))


class KeptRows:
    """Rows that have been read, of several trials: up to READ_ROWS_BYTES of them, the first ones."""

    def __init__(self) -> None:
        self._rows: dict[tuple[Path, int], _Rows] = {}
        self._left = READ_ROWS_BYTES

    def get(self, path: Path, group: int) -> _Rows | None:
        """The rows of a row group, if they are kept."""
        return self._rows.get((path, group))

    def keep(self, path: Path, group: int, rows: _Rows) -> None:
        """Keep the rows of a row group, if there is room."""
        if (size := rows.nbytes) <= self._left:
            self._left -= size
            self._rows[path, group] = rows

    def clear(self) -> None:
        """Let go of all rows."""
        self._rows, self._left = {}, READ_ROWS_BYTES


class TrialSums:
    """The sums in the folder of a trial, read score by score; every method raises ScoresError.

    `kept`: rows that have been read, for several trials together; None: nothing is kept.
    """

    def __init__(self, folder: Path, kept: KeptRows | None = None) -> None:
        self.path, self._kept = folder / SUMS_FILE, kept
        with _opened(self.path) as file:
            self._metadata = file.metadata
            self.steps, self.layouts = _layouts_of(self.path, file.schema_arrow)

    @property
    def scores(self) -> tuple[str, ...]:
        """The scores that have rows."""
        return tuple(name for name in self.layouts if name in self._groups)

    @cached_property
    def frames(self) -> ScoredFrames:
        """The scored frames; none if nothing was scored. A score may leave out frames: one with all of them tells."""
        if not self.scores:
            return ScoredFrames(np.zeros(0, np.int64), np.zeros(0, np.str_))
        score = min(self.scores, key=lambda name: (-self._number_of_frames(name), self.layouts[name].rows))
        found = [self._frames_in(group, self.layouts[score].rows) for group in self._groups[score]]
        stamps, delivered = (np.concatenate(own) for own in zip(*found, strict=True))
        if (np.diff(stamps) <= 0).any():
            raise ScoresError(f"{self.path}: the frames of {score} do not follow in time; run it again")
        return ScoredFrames(stamps, delivered)

    def by_unit(
        self,
        score: str,
        units: NDArray[np.int64],
        steps: Sequence[int],
        strata: Sequence[str],
        parts: Sequence[str] = (),
    ) -> Sums:
        """The sums (U, S, K, P) of the units from 0 to the highest in `units` (F,); frames in unit -1 are left out.

        At these steps, strata and `parts` (none: all), each in its order; 0 at a step that the score does not have.
        """
        layout = self.layouts.get(score, Layout((), (), ()))
        parts = tuple(parts) or layout.parts
        if not {*strata} <= {*layout.strata} or not {*parts} <= {*layout.parts}:
            raise ScoresError(f"{self.path}: no sums of {score} in {', '.join(strata)}; run it again")
        number, shape = int(units.max(initial=-1)) + 1, (len(steps), len(strata))
        place = np.full((self.steps + 1, len(layout.strata)), -1)
        chosen = np.ix_(steps, [layout.strata.index(name) for name in strata])
        place[chosen] = np.arange(shape[0] * shape[1]).reshape(shape)
        place = place[list(layout.steps)]
        column = np.full(len(layout.parts), -1)
        places = {part: at for at, part in enumerate(layout.parts)}
        column[[places[part] for part in parts]] = np.arange(len(parts))
        total = np.zeros((number, shape[0] * shape[1], len(parts)))
        of_frame = dict(zip(self.frames.stamps_ns.tolist(), units.tolist(), strict=True))
        for rows in self._row_groups(score):
            unit = np.array([of_frame.get(stamp, -1) for stamp in rows.stamps_ns.tolist()])
            self._require_parts(rows, layout)
            _add(np.repeat(unit, place.size), np.tile(place.ravel(), len(unit)), *rows.entries, column, total)
        return Sums(total.reshape(number, *shape, len(parts)), parts)

    def by_frame(self, score: str, steps: Sequence[int], strata: Sequence[str], parts: Sequence[str]) -> Sums:
        """The sums (F, S, K, P) of each scored frame."""
        return self.by_unit(score, np.arange(len(self.frames.stamps_ns)), steps, strata, parts)

    @cached_property
    def _groups(self) -> dict[str, list[int]]:
        """The row groups of each score."""
        groups: dict[str, list[int]] = {}
        column = list(COLUMNS).index("score")
        for group in range(self._metadata.num_row_groups):
            found = self._metadata.row_group(group).column(column).statistics
            name = found.min if found is not None and found.has_min_max and found.min == found.max else None
            if name not in self.layouts:
                raise ScoresError(f"{self.path}: a part of the table that is not of one known score; run it again")
            self._refuse_large(group, self.layouts[name])
            groups.setdefault(name, []).append(group)
        return groups

    def _refuse_large(self, group: int, layout: Layout) -> None:
        """Raise ScoresError for a row group that is larger than the writer's: a small file can unpack to gigabytes."""
        found = self._metadata.row_group(group)
        rows = ROW_GROUP * layout.rows
        values = max(found.column(column).num_values for column in range(found.num_columns))
        if found.num_rows > rows or values > min(MAX_VALUES, rows * max(1, len(layout.parts))):
            raise ScoresError(
                f"{self.path}: {found.num_rows} rows and {values} values together, more than a trial writes: refused"
            )

    def _number_of_frames(self, score: str) -> float:
        rows: int = sum(self._metadata.row_group(group).num_rows for group in self._groups[score])
        return rows / max(1, self.layouts[score].rows)

    def _frames_in(self, group: int, rows_of_frame: int) -> tuple[NDArray[np.int64], NDArray[np.str_]]:
        """Stamp and hash of each frame of a row group, without its sums."""
        with _opened(self.path, self._metadata) as file:
            table = file.read_row_group(group, columns=_OF_FRAMES, use_threads=False).combine_chunks()
        stamps, delivered = (table.column(name).combine_chunks() for name in _OF_FRAMES)
        if not rows_of_frame or len(table) % rows_of_frame or stamps.null_count or delivered.null_count:
            raise ScoresError(f"{self.path}: a value or a row is missing; run it again")
        own = delivered.to_numpy(zero_copy_only=False)[::rows_of_frame].astype(np.str_)
        return stamps.to_numpy()[::rows_of_frame], own

    def _row_groups(self, score: str) -> Iterator[_Rows]:
        for group in self._groups.get(score, ()):
            rows = self._kept.get(self.path, group) if self._kept else None
            if rows is None:
                rows = self._read(group, self.layouts[score])
                if self._kept:
                    self._kept.keep(self.path, group, rows)
            yield rows

    def _read(self, group: int, layout: Layout) -> _Rows:
        with _opened(self.path, self._metadata) as file:
            table = file.read_row_group(group, columns=_OF_SUMS, use_threads=False)  # most are small
        return _rows(self.path, table, layout)

    def _require_parts(self, rows: _Rows, layout: Layout) -> None:
        if rows.entries[1].max(initial=0) >= len(layout.parts):
            raise ScoresError(f"{self.path}: a part beyond the {len(layout.parts)} of its score; run it again")


@dataclass(frozen=True, slots=True)
class _Rows:
    """Rows of one score: the stamp of each frame, and of each row where its entries end, and their parts and values."""

    stamps_ns: NDArray[np.int64]
    entries: tuple[NDArray[np.int64], NDArray[np.uint16], Floats]

    @property
    def nbytes(self) -> int:
        """The memory that they take, bytes."""
        return sum(own.nbytes for own in (self.stamps_ns, *self.entries))


def _rows(path: Path, table: Any, layout: Layout) -> _Rows:
    """The rows of a row group, checked: every frame has all steps, each with all strata in order."""
    table, rows_of_frame = table.combine_chunks(), layout.rows
    columns = {name: table.column(name).combine_chunks() for name in _OF_SUMS}
    frames = len(table) // rows_of_frame if rows_of_frame else 0
    if any(column.null_count for column in columns.values()) or len(table) != frames * rows_of_frame:
        raise ScoresError(f"{path}: a value or a row is missing; run it again")
    step = np.repeat(layout.steps, len(layout.strata))
    stamps = columns["stamp_ns"].to_numpy().reshape(frames, rows_of_frame)
    names, own = columns["stratum"].dictionary.to_pylist(), columns["stratum"].indices.to_numpy()
    expected = [names.index(name) if name in names else -1 for name in layout.strata]
    whole = (
        (columns["step"].to_numpy().reshape(frames, rows_of_frame) == step).all()
        and (own.reshape(frames, rows_of_frame) == np.tile(expected, len(layout.steps))).all()
        and (stamps == stamps[:, :1]).all()
    )
    ends, ends_of_values = (columns[name].offsets.to_numpy().astype(np.int64) for name in ("part", "value"))
    if not whole or not np.array_equal(ends - ends[0], ends_of_values - ends_of_values[0]):
        raise ScoresError(
            f"{path}: not {len(layout.steps)} steps of {', '.join(layout.strata)} at every frame; run it again"
        )
    parts, values = (columns[name].flatten().to_numpy() for name in ("part", "value"))
    return _Rows(stamps[:, 0], (ends - ends[0], parts, values))


@numba.njit(cache=True, nogil=True)
def _add(unit, place, ends, parts, values, column, total):  # type: ignore[no-untyped-def]
    """Add the entries of each row (R,) to its `unit` and `place` in `total` (U, N, P); an index of -1: to none."""
    for row in range(unit.size):
        if unit[row] >= 0 and place[row] >= 0:
            for i in range(ends[row], ends[row + 1]):
                if column[parts[i]] >= 0:
                    total[unit[row], place[row], column[parts[i]]] += values[i]


@contextmanager
def _opened(path: Path, metadata: Any = None) -> Iterator[Any]:
    """The Parquet file; every failure to read it in the block is a ScoresError.

    `metadata` spares reading them again. A thread that reads ahead costs more than it gains.
    """
    try:
        with parquet.ParquetFile(path, metadata=metadata, pre_buffer=False) as file:
            yield file
    except (OSError, ArrowException) as error:
        raise _unreadable(path, error) from None


def _layouts_of(path: Path, schema: Any) -> tuple[int, dict[str, Layout]]:
    """The steps and the layout of each score, of a table with the columns of this version."""
    columns = {name: schema.field(name).type for name in schema.names}
    if columns != {name: kind for name, (kind, _) in COLUMNS.items()}:
        raise ScoresError(f"{path}: columns {', '.join(schema.names)}; expected {', '.join(COLUMNS)}: run it again")
    try:
        described = json.loads((schema.metadata or {})[_METADATA])
        if described["version"] != SUMS_VERSION:
            raise ScoresError(
                f"{path}: version {described['version']} of this table, and this gridtrack reads version"
                f" {SUMS_VERSION}: read it with the gridtrack that wrote it, or compare again"
            )
        scores = described["scores"].items()
        steps = int(described["steps"])
        return steps, {name: _layout(one, steps) for name, one in scores}
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise _unreadable(path, error) from None


def _layout(described: Mapping[str, Any], last: int) -> Layout:
    """A layout of the metadata. Raises KeyError, TypeError and ValueError."""
    strata, parts, steps = (tuple(described[name]) for name in ("strata", "parts", "steps"))
    if any(type(step) is not int or not 0 <= step <= last for step in steps):
        raise ValueError(f"a step that is not from 0 to {last}")
    return Layout(strata, parts, steps)


def _unreadable(path: Path, error: Exception) -> ScoresError:
    return ScoresError(f"{path}: cannot be read as sums ({str(error).splitlines()[0]}); run it again")
