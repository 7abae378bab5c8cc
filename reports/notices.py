"""Notices above the scores: warnings of the run, trials that are not complete, missing intervals."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from gridtrack.reports.run import ReportedRun
from gridtrack.reports.table import HeadlineTable, TableRow, outcome_words


@dataclass(frozen=True)
class Notice:
    """One notice; `serious` where a trial or a recording is not ranked because of it, or the run itself gave it."""

    text: str
    serious: bool = False


def notices_of(runs: Sequence[ReportedRun], tables: Sequence[HeadlineTable]) -> list[Notice]:
    """Every notice, serious ones first."""
    found = [*_of_runs(runs), *_of_parity(tables), *_of_trials(tables), *_of_intervals(tables)]
    return sorted(dict.fromkeys(found), key=lambda notice: not notice.serious)


def _of_runs(runs: Sequence[ReportedRun]) -> Iterator[Notice]:
    for run in runs:
        before = f"{run.name}: " if len(runs) > 1 else ""
        if run.summary.interrupted:
            yield Notice(f"{before}the run was interrupted: the page shows what was scored until then", serious=True)
        for text in run.summary.notices:
            yield Notice(before + text, serious=True)


def _of_parity(tables: Sequence[HeadlineTable]) -> Iterator[Notice]:
    for table in tables:
        if not table.comparable:
            yield Notice(
                f"{table.recording}: the rows are not scored on the same frames, none is marked as best",
                serious=True,
            )


def _of_trials(tables: Sequence[HeadlineTable]) -> Iterator[Notice]:
    """A line for each row that is not ranked; where recordings are pooled, one for all of them."""
    told: set[str] = set()
    for table in sorted(tables, key=lambda table: not table.pooled):
        for row in (one for one in table.rows_in("unranked") if one.key not in told):
            where = f" on {table.recording}" if len(tables) > 1 and not table.pooled else ""
            why = "; ".join([*_pooled_reasons(row), _scored(row)]) if table.pooled else outcome_text(row)
            yield Notice(f"{row.name}{where}: {why}", serious=True)
            told |= {row.key} if table.pooled else set()


def outcome_text(row: TableRow) -> str:
    """Why a row on one recording is not ranked, and how much of it was scored."""
    return "; ".join(filter(None, (row.outcome, row.trial.reason, _scored(row))))


def _scored(row: TableRow) -> str:
    return f"{row.frames} frames scored, not ranked" if row.trial.frames_scored else "nothing scored"


def _pooled_reasons(row: TableRow) -> Iterator[str]:
    """Each outcome for which trials of a pooled row are not ranked, on how many recordings, and the first reason."""
    reasons: dict[str, list[str]] = defaultdict(list)
    for trial in (one for one in row.trials if not one.ranked):
        reasons[outcome_words(trial)].append(trial.reason)
    for outcome, found in reasons.items():
        others = " and others" if len(set(found)) > 1 else ""
        words = f" ({found[0]}{others})" if found[0] else ""
        yield f"{outcome} on {len(found)} of {len(row.trials)} recordings{words}"


def _of_intervals(tables: Sequence[HeadlineTable]) -> Iterator[Notice]:
    without: dict[str, list[str]] = defaultdict(list)
    pooled = [table for table in tables if table.pooled]
    for table in pooled or tables:
        complete = [row.trial for row in table.rows if row.group != "unranked"]
        intervals = {s.interval for trial in complete for s in trial.strata.values() if s.interval}
        for interval in intervals:
            without[interval].append(table.recording)
    for interval, recordings in without.items():
        yield Notice(
            f"{', '.join(recordings)}: {interval}; the scores describe this stretch only and do not show that"
            " one tracker is better than another"
        )
