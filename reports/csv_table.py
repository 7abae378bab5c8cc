"""The scores of a run as CSV, a row for each tracker on each recording, for spreadsheets and scripts."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence

from gridtrack.common.errors import printable
from gridtrack.reports.chosen_scores import ExportedTable
from gridtrack.reports.table import TableRow

FORMULA = ("=", "+", "-", "@")
"""What a spreadsheet takes for the start of a formula."""


def csv_of_tables(exported: Sequence[ExportedTable]) -> str:
    """Columns: `recording`, `run` (empty for one), `tracker`, `outcome`, `frames_scored`, `frames_expected`, and each
    score with the ends of its interval as `... low` and `... high`; empty where undefined.

    A name that begins as a formula has an apostrophe before it. Columns that only some recordings have are empty for
    the others.
    """
    rows = [dict(_fields(one, row)) for one in exported for row in one.table.rows]
    columns = list(dict.fromkeys(column for row in rows for column in row))
    written = io.StringIO()
    writer = csv.DictWriter(written, columns, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return written.getvalue()


def _fields(one: ExportedTable, row: TableRow) -> Iterator[tuple[str, str | int | float | None]]:
    yield "recording", _text(one.table.recording)
    yield "run", _text(row.run)
    yield "tracker", _text(row.label)
    yield "outcome", _text(row.outcome)
    yield "frames_scored", row.trial.frames_scored
    yield "frames_expected", row.trial.frames_expected
    for at, (column, cell) in enumerate(zip(one.table.columns, row.cells, strict=True)):
        name = f"{column.score} {column.stratum} {one.table.horizons_s[column.step]:g} s"
        yield name, cell.value
        if any(other.cells[at].interval for other in one.table.rows):
            low, high = cell.interval or (None, None)
            yield f"{name} low", low
            yield f"{name} high", high


def _text(text: str) -> str:
    text = printable(text)
    return f"'{text}" if text.lstrip().startswith(FORMULA) else text
