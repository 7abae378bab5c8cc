"""Notices above the scores: incomplete trials with the reason, warnings of the run, missing intervals."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from gridtrack.common.errors import MAX_LINE_CHARS
from gridtrack.common.notices import MOST_NAMED, NoticesOfAKind, by_kind, counted
from gridtrack.evaluation.runs.summary import TrialSummary
from gridtrack.reports.run import ReportedRun
from gridtrack.reports.table import HeadlineTable, TableRow, outcome_words


@dataclass(frozen=True)
class ShownNotice:
    """A line, and its list; `serious` if because of it a trial or a recording is not ranked, or the run did not end."""

    text: str
    members: tuple[str, ...] = ()
    serious: bool = False


def notices_of(runs: Sequence[ReportedRun], tables: Sequence[HeadlineTable]) -> list[ShownNotice]:
    """Every notice: failures with their reasons, other serious notices, then the rest. Raises RunError."""
    serious = [*_of_trials(tables), *_of_ends(runs), *_of_parity(tables)]
    return list(dict.fromkeys([*serious, *_of_code(runs), *_of_runs(runs), *_of_intervals(tables)]))


def _of_trials(tables: Sequence[HeadlineTable]) -> Iterator[ShownNotice]:
    """A line for each row without a rank and each reason; if recordings are pooled, one for all of them."""
    known: set[str] = set()
    every = [table.recording for table in tables if not table.pooled]
    found: dict[tuple[str, str], list[str]] = defaultdict(list)
    for table in sorted(tables, key=lambda table: not table.pooled):
        for row in (one for one in table.rows_in("unranked") if one.key not in known):
            why = "; ".join([*failures_of(row.trials), _scored(row)]) if table.pooled else outcome_text(row)
            found[row.name, why].append("" if table.pooled or len(tables) == 1 else table.recording)
            known |= {row.key} if table.pooled else set()
    for (name, why), recordings in found.items():
        named = list(filter(None, recordings))
        where = f" on {counted(named, 'recordings', every)}" if named else ""
        yield ShownNotice(f"{name}{where}: {why}", _list_of(named), serious=True)


def outcome_text(row: TableRow) -> str:
    """Why a row on one recording is not ranked, and the number of its scored frames."""
    return "; ".join(filter(None, (row.outcome, row.trial.reason, _scored(row))))


def _scored(row: TableRow) -> str:
    return f"{row.frames} frames scored, not ranked" if row.trial.frames_scored else "nothing scored"


def failures_of(trials: Sequence[TrialSummary], most_chars: int = MAX_LINE_CHARS) -> Iterator[str]:
    """Each outcome of the `trials` of a row that are not ranked, its number of recordings if there are several, and the
    first reason, cut to `most_chars` characters."""
    reasons: dict[str, list[str]] = defaultdict(list)
    for trial in (one for one in trials if not one.ranked):
        reasons[outcome_words(trial)].append(trial.reason)
    for outcome, found in reasons.items():
        where = f" on {len(found)} of {len(trials)} recordings" if len(trials) > 1 else ""
        others = " and others" if len(set(found)) > 1 else ""
        first = next(filter(None, found), "")
        reason = first if len(first) <= most_chars else f"{first[: most_chars - 1].rstrip()}…"
        yield f"{outcome}{where}" + (f" ({reason}{others})" if reason else "")


def _of_ends(runs: Sequence[ReportedRun]) -> Iterator[ShownNotice]:
    for run in runs:
        if run.summary.interrupted:
            before = _before([run.name], runs)
            yield ShownNotice(f"{before}the run was interrupted: the page shows the scores until then", serious=True)


def _of_parity(tables: Sequence[HeadlineTable]) -> Iterator[ShownNotice]:
    unlike = [table for table in tables if not table.comparable]
    if found := [table.recording for table in unlike if not table.pooled] or [table.recording for table in unlike]:
        where = counted(found, "recordings", [table.recording for table in tables if not table.pooled])
        text = f"{where}: the rows are not scored on the same frames, none is marked as best"
        yield ShownNotice(text, _list_of(found), serious=True)


def _of_code(runs: Sequence[ReportedRun]) -> Iterator[ShownNotice]:
    for run in runs:
        for label in run.summary.trackers:
            if (versions := len(run.code_of(label))) > 1:
                text = f"{label}: its trials ran with {versions} different versions of its code"
                yield ShownNotice(_before([run.name], runs) + text)


def _of_runs(runs: Sequence[ReportedRun]) -> Iterator[ShownNotice]:
    """The notices of the runs by kind. Those that are the same in several runs become one."""
    runs_with: dict[NoticesOfAKind, list[str]] = defaultdict(list)
    for run in runs:
        for kind in by_kind(run.summary.notices, run.recordings):
            runs_with[kind].append(run.name)
    for kind, names_of_runs in runs_with.items():
        yield ShownNotice(_before(names_of_runs, runs) + kind.text, kind.members)


def _of_intervals(tables: Sequence[HeadlineTable]) -> Iterator[ShownNotice]:
    without: dict[tuple[str, str], list[str]] = defaultdict(list)
    pooled = [table for table in tables if table.pooled]
    for table in pooled or tables:
        complete = [row for row in table.rows if row.group != "unranked"]
        for run, interval in dict.fromkeys((row.run, row.trial.interval) for row in complete if row.trial.interval):
            without[run, interval].append(table.recording)
    for (run, interval), recordings in without.items():
        where = counted(recordings, "recordings", [table.recording for table in tables])
        yield ShownNotice(
            f"{f'{run}: ' if run else ''}{where}: {interval}; the scores describe this stretch only and do not show"
            " that one tracker is better than another",
            _list_of(recordings),
        )


def _before(names: Sequence[str], runs: Sequence[ReportedRun]) -> str:
    """The names of the runs with a notice, as its beginning; empty if there is only one run."""
    return f"{' and '.join(names)}: " if len(runs) > 1 else ""


def _list_of(recordings: Sequence[str]) -> tuple[str, ...]:
    """The recordings that `counted` does not name."""
    return tuple(recordings) if len(recordings) > MOST_NAMED else ()
