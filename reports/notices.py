"""What a reader must know before the numbers: trials that failed, thresholds for want of validation, missing intervals."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from gridtrack.reports.run import Run
from gridtrack.reports.table import HeadlineTable


@dataclass(frozen=True)
class Notice:
    """One thing to know; `serious` where it keeps a trial or a recording out of the ranking."""

    text: str
    serious: bool = False


def notices_of(runs: Sequence[Run], tables: Sequence[HeadlineTable]) -> tuple[Notice, ...]:
    """Every notice, serious ones first; what a run itself tells comes in its own words."""
    found = [*_of_runs(runs), *_of_trials(tables), *_of_thresholds(tables), *_of_intervals(tables)]
    return tuple(sorted(dict.fromkeys(found), key=lambda notice: not notice.serious))


def _of_runs(runs: Sequence[Run]) -> Iterator[Notice]:
    for run in runs:
        before = f"{run.name}: " if len(runs) > 1 else ""
        if run.summary.interrupted:
            yield Notice(f"{before}the run was interrupted: what had been scored by then is shown", serious=True)
        for text in run.summary.notices:
            yield Notice(before + text, serious=True)


def _of_trials(tables: Sequence[HeadlineTable]) -> Iterator[Notice]:
    for table in tables:
        for row in table.standing("apart"):
            what = f"{row.name} on {table.recording}: {row.trial.outcome}"
            reason = f": {row.trial.reason}" if row.trial.reason else ""
            scored = f"; {row.frames} frames scored, not ranked" if row.trial.frames_scored else "; nothing scored"
            yield Notice(what + reason + scored, serious=True)


def _of_thresholds(tables: Sequence[HeadlineTable]) -> Iterator[Notice]:
    for table in tables:
        unchosen = [r.name for r in table.rows if r.trial.frames_scored and not r.trial.threshold_chosen_on]
        if unchosen:
            yield Notice(
                f"{table.recording}: for want of a validation stretch the threshold is 0.5 at every step for"
                f" {', '.join(unchosen)}; a forecast that is blurred because it is honest loses by that"
            )


def _of_intervals(tables: Sequence[HeadlineTable]) -> Iterator[Notice]:
    without: dict[str, list[str]] = defaultdict(list)
    for table in tables:
        intervals = {s.interval for row in table.rows for s in row.trial.strata.values() if s.interval}
        for interval in intervals:
            without[interval].append(table.recording)
    for interval, recordings in without.items():
        yield Notice(
            f"{', '.join(recordings)}: {interval}; the numbers say what happened on this stretch, not that"
            " one tracker is better than another in general"
        )
