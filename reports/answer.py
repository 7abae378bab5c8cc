"""The answer beside the ranking, a line each: what was compared, with which weights, who keeps up, who failed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from gridtrack.evaluation.results.summary import TrackerSummary
from gridtrack.evaluation.results.trial_summary import TrialSummary
from gridtrack.reports.run import ReportedRun
from gridtrack.reports.run_description import Fact, lead_of
from gridtrack.reports.table import headline_tables, main_tables
from gridtrack.reports.times import keeps_up_of

MOST_NAMES = 8
"""Further names of a line are counted."""
WEIGHTS_WORDS = {"site": "of the site", "general": "general", "general, site": "general or of the site", "": "none"}
VERDICTS = ("no", "updates only", "yes")
"""From the worst: a tracker has the worst of its recordings."""


@dataclass(frozen=True)
class Answer:
    """The main result of one run in a sentence for each main table, and the lines below, where they say something."""

    run: str
    leads: tuple[str, ...]
    facts: tuple[Fact, ...]


def answer_of(run: ReportedRun) -> Answer:
    """The answer of one run. Raises ReportError."""
    leads = map(lead_of, main_tables(headline_tables([run])))
    facts = (_compared(run), _weights(run), _keeps_up(run), _not_ranked(run))
    return Answer(run.name, tuple(filter(None, leads)), tuple(fact for fact in facts if fact.value))


def _compared(run: ReportedRun) -> Fact:
    recordings = [run.summary.recordings[name] for name in run.recordings]
    frames = sum(one.frames for one in recordings)
    where = run.recordings[0] if len(recordings) == 1 else f"{len(recordings)} recordings"
    ahead = ", ".join(f"{s:.3g}" for s in sorted({one.horizons_s[-1] for one in recordings}))
    return Fact("Compared on", f"{where}: {frames} frames, forecasts up to {ahead} s ahead")


def _weights(run: ReportedRun) -> Fact:
    cards = {
        label: ", ".join(sorted({trial.card for trial in _trials(row, run)} - {""}))
        for label, row in run.summary.trackers.items()
        if not row.ceiling
    }
    return Fact("Weights", _grouped({label: WEIGHTS_WORDS.get(card, card) for label, card in cards.items()}))


def _keeps_up(run: ReportedRun) -> Fact:
    """By the 99th percentiles of its times against the period of each recording."""
    verdicts = {}
    for label, row in run.summary.trackers.items():
        trials = {name: trial for name, trial in row.recordings.items() if name in run.recordings}
        verdicts_of = (keeps_up_of(one, run.summary.recordings[name].period_s * 1e3) for name, one in trials.items())
        if found := list(filter(None, verdicts_of)):
            verdicts[label] = min(found, key=VERDICTS.index)
    return Fact("Keeps up with the sensor", _grouped(verdicts) or "latency not measured: --latency")


def _not_ranked(run: ReportedRun) -> Fact:
    found = [f"{label} ({why})" for label, row in run.summary.trackers.items() if (why := ", ".join(_why(row, run)))]
    return Fact("Not ranked", _listed(found))


def _why(row: TrackerSummary, run: ReportedRun) -> Sequence[str]:
    outcomes = (trial.outcome if not trial.complete else "leak" for trial in _trials(row, run) if not trial.ranked)
    return list(dict.fromkeys(outcomes))


def _trials(row: TrackerSummary, run: ReportedRun) -> Iterator[TrialSummary]:
    return (trial for name, trial in row.recordings.items() if name in run.recordings)


def _grouped(words: Mapping[str, str]) -> str:
    """Labels by what is said of them."""
    by_words: dict[str, list[str]] = {}
    for label, one in words.items():
        by_words.setdefault(one, []).append(label)
    return "; ".join(f"{one}: {_listed(labels)}" for one, labels in by_words.items())


def _listed(names: Sequence[str]) -> str:
    more = f" and {len(names) - MOST_NAMES} more" if len(names) > MOST_NAMES else ""
    return ", ".join(names[:MOST_NAMES]) + more
