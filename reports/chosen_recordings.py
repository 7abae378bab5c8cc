"""Which recordings a report shows: those that a user names, and on a page no more than it holds."""

from __future__ import annotations

from collections.abc import Sequence
from fnmatch import fnmatchcase

from gridtrack.common.errors import ConfigurationError, did_you_mean
from gridtrack.reports.table import HeadlineTable

MOST_VALUES = 2_500_000
"""Values of all curves on a page. One takes five bytes, so that half of a page of 25 MB is left for moments."""


def chosen_tables(tables: Sequence[HeadlineTable], recordings: str) -> Sequence[HeadlineTable]:
    """The tables of the recordings that match one of `recordings`, patterns as of file names separated by commas, and
    nothing that is pooled; without patterns all tables. Raises ConfigurationError for a pattern that matches nothing.
    """
    if not recordings:
        return tables
    patterns = [pattern.strip() for pattern in recordings.split(",")]
    single = [table for table in tables if not table.pooled]
    for pattern in patterns:
        if not any(fnmatchcase(table.recording, pattern) for table in single):
            near = did_you_mean(pattern, [table.recording for table in single])
            raise ConfigurationError(f"--recordings '{pattern}': no such recording: {near}")
    return [table for table in single if any(fnmatchcase(table.recording, pattern) for pattern in patterns)]


def tables_of_page(tables: Sequence[HeadlineTable]) -> tuple[list[HeadlineTable], int]:
    """The tables that fit on a page, in their order, and how many do not.

    What is pooled comes first, then the recordings on which the trackers differ most in the score that decides. One
    table is there whatever its size.
    """
    kept: set[str] = set()
    values = 0
    for table in sorted(tables, key=lambda table: (not table.pooled, -_range(table))):
        values += _values(table)
        if kept and values > MOST_VALUES:
            break
        kept.add(table.recording)
    return [table for table in tables if table.recording in kept], len(tables) - len(kept)


def _range(table: HeadlineTable) -> float:
    """How far apart the best and the worst of the complete trials are."""
    at = table.columns.index(table.decisive)
    rows = (*table.rows_in("ranked"), *table.rows_in("floor"))
    scores = [value for row in rows if (value := row.cells[at].value) is not None]
    return max(scores) - min(scores) if scores else 0.0


def _values(table: HeadlineTable) -> int:
    """The values of all curves of its rows."""
    curves = (curve for row in table.rows for scores in row.trial.strata.values() for _, curve in scores)
    return sum(len(curve) for curve in curves if isinstance(curve, tuple))
