"""Which recordings a report shows: those that a user names, and on a page no more than it holds."""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import replace

from gridtrack.reports.patterns import names_matching
from gridtrack.reports.run import ReportedRun
from gridtrack.reports.table import HeadlineTable

MOST_VALUES = 2_500_000
"""Values of all curves on a page. One takes five bytes, so that half of a page of 25 MB is left for moments."""


def chosen_runs(runs: Sequence[ReportedRun], recordings: str) -> tuple[ReportedRun, ...]:
    """The runs with nothing but the recordings that match one of `recordings`, patterns as of file names separated by
    commas, each alone and nothing pooled; a run that has none of them is left out. Without patterns the runs as they
    are. Raises ConfigurationError for a pattern that matches nothing.
    """
    if not recordings:
        return tuple(runs)
    names = list(dict.fromkeys(name for run in runs for name in run.recordings))
    chosen = names_matching(recordings, names, "--recordings", "recording")
    return tuple(_with_recordings(run, chosen) for run in runs if chosen.intersection(run.recordings))


def _with_recordings(run: ReportedRun, chosen: Set[str]) -> ReportedRun:
    described = {name: one for name, one in run.summary.recordings.items() if name in chosen}
    trackers = {
        label: row.model_copy(update={"recordings": {name: row.recordings[name] for name in own}, "pooled": None})
        for label, row in run.summary.trackers.items()
        if (own := [name for name in described if name in row.recordings])
    }
    summary = run.summary.model_copy(update={"recordings": described, "trackers": trackers})
    return replace(run, summary=summary, pooled=False)


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
