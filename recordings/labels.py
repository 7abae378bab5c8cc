"""The class of each beam, from a CSV with one row for each labelled beam: `stamp_ns,beam,class[,sensor]`."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import NamedTuple, NoReturn

import numpy as np

from gridtrack.common.errors import RecordingError, did_you_mean
from gridtrack.common.scan import Scan
from gridtrack.common.scene import UNLABELLED


class BeamLabel(NamedTuple):
    """One row of the CSV: the class of one beam."""

    stamp_ns: int
    sensor: str
    beam: int
    name: str
    line: int


def classes_in(path: Path) -> tuple[str, ...]:
    """The classes that the CSV names, sorted. Raises RecordingError."""
    names = {label.name for label in _read_labels(path)}
    if len(names) > UNLABELLED:
        raise RecordingError(f"{path}: {len(names)} classes; at most {UNLABELLED}")
    return tuple(sorted(names))


def with_labels(scans: Iterable[Scan], path: Path, classes: tuple[str, ...]) -> Iterator[Scan]:
    """`scans` with the labels of the CSV, whose rows are sorted by stamp.

    A row without a sensor labels the sensor `scan`. Raises RecordingError for a row that belongs to no scan.
    """
    index = {name: i for i, name in enumerate(classes)}
    groups = groupby(_read_labels(path), key=lambda row: (row.stamp_ns, row.sensor))
    pending: dict[tuple[int, str], list[BeamLabel]] = {}
    read_to_ns = -1
    for scan in scans:
        while read_to_ns <= scan.stamp_ns and (group := next(groups, None)) is not None:
            key, rows = group
            if key[0] < read_to_ns:
                raise RecordingError(
                    f"{path}, line {next(rows).line}: a stamp before that of the row above; sort the rows by stamp"
                )
            read_to_ns = key[0]
            pending.setdefault(key, []).extend(rows)  # rows of sensors that share a stamp may alternate
        labels = pending.pop((scan.stamp_ns, scan.sensor), None)
        yield scan if labels is None else replace(scan, labels=_labels(labels, scan, index, path))
        for key in [key for key in pending if key[0] < scan.stamp_ns]:
            _raise_no_scan(pending[key][0], path)
    for rest in pending.values():
        _raise_no_scan(rest[0], path)
    for _, rows in groups:
        _raise_no_scan(next(rows), path)


def _raise_no_scan(row: BeamLabel, path: Path) -> NoReturn:
    raise RecordingError(f"{path}, line {row.line}: no scan of sensor '{row.sensor}' is stamped {row.stamp_ns}")


def _labels(rows: list[BeamLabel], scan: Scan, index: dict[str, int], path: Path) -> np.typing.NDArray[np.uint8]:
    labels = np.full(scan.ranges.size, UNLABELLED, np.uint8)
    for row in rows:
        if row.name not in index:
            raise RecordingError(f"{path}, line {row.line}: no class '{row.name}'; {did_you_mean(row.name, index)}")
        if not 0 <= row.beam < labels.size:
            raise RecordingError(f"{path}, line {row.line}: beam {row.beam} of a scan of {labels.size} beams")
        labels[row.beam] = index[row.name]
    return labels


def _read_labels(path: Path) -> Iterator[BeamLabel]:
    try:
        with path.open(newline="", encoding="utf-8") as file:
            reader = csv.DictReader(file, restval="")
            if not {"stamp_ns", "beam", "class"} <= set(reader.fieldnames or ()):
                raise RecordingError(f"{path}: expected the columns stamp_ns, beam, class and optionally sensor")
            for row in reader:
                try:
                    stamp_ns, beam = int(row["stamp_ns"]), int(row["beam"])
                except ValueError as error:
                    raise RecordingError(f"{path}, line {reader.line_num}: {error}") from None
                yield BeamLabel(stamp_ns, row.get("sensor") or "scan", beam, row["class"], reader.line_num)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read ({error.strerror})") from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise RecordingError(f"{path}: not a CSV in UTF-8 ({error})") from None
