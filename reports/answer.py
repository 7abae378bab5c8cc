"""The answer of a run: its decision, and lines on recordings, weights, speed and missing ranks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from gridtrack.evaluation.runs.summary import TrackerSummary, TrialSummary
from gridtrack.reports.decision import lead_of
from gridtrack.reports.measurements import keeps_up_of
from gridtrack.reports.notices import failures_of
from gridtrack.reports.run import ReportedRun
from gridtrack.reports.run_description import Fact
from gridtrack.reports.table import HeadlineTable, headline_tables, main_tables, name_in

MOST_NAMES = 8
"""Further names of a line are counted, if they are more than one."""
MOST_CHARS = 300
"""A longer reason is cut."""
WEIGHTS_WORDS = {"site": "of the site", "general": "general", "general, site": "general or of the site", "": "none"}
KEEPS_UP = "Keeps up with the sensor"
UNTIMED = "not measured: gridtrack compare --latency measures it"
FLOORS = "Floors are simple rules that a tracker must beat."
CEILING = "The oracle knows the future: an upper limit."
KEEPING_UP = ("no", "updates only", "yes")
"""The worst first: a tracker has the worst verdict of its recordings."""


@dataclass(frozen=True)
class Answer:
    """The decision of one run for each main table, words on its rows, and the lines below it that are not empty."""

    run: str
    leads: tuple[str, ...]
    words: str
    facts: tuple[Fact, ...]

    @property
    def summary(self) -> str:
        """A line on the recordings, and on whether trackers keep up with the sensor."""
        compared = f"{self.facts[0].name} {self.facts[0].value}"
        (timed,) = (fact for fact in self.facts if fact.name == KEEPS_UP)
        if timed.value == UNTIMED:
            return f"{compared}. Time of updates and forecasts: not measured"
        return f"{compared}. {timed.name}: {timed.value}"


def answer_of(run: ReportedRun) -> Answer:
    """The answer of one run. Raises ReportError."""
    tables = main_tables(headline_tables([run]))
    leads = (lead_of([run], table) for table in tables)
    facts = (_compared(run), *_of_trial(run, tables), _weights(run), _keeps_up(run), _not_ranked(run))
    return Answer(run.name, tuple(filter(None, leads)), _words(run), tuple(fact for fact in facts if fact.value))


def _words(run: ReportedRun) -> str:
    """What a floor and the oracle are, if the run has them."""
    rows = run.summary.trackers.values()
    floors, ceiling = any(row.floor for row in rows), any(row.ceiling for row in rows)
    return " ".join(([FLOORS] if floors else []) + ([CEILING] if ceiling else []))


def _compared(run: ReportedRun) -> Fact:
    recordings = [run.summary.recordings[name] for name in run.recordings]
    frames, scored = sum(one.frames for one in recordings), sum(_most_scored(run, name) for name in run.recordings)
    where = recordings[0].stretch or run.recordings[0] if len(recordings) == 1 else f"{len(recordings)} recordings"
    furthest_s = [one.horizons_s[-1] for one in recordings]
    ahead = " to ".join(dict.fromkeys(f"{s:.3g}" for s in (min(furthest_s), max(furthest_s))))
    forecasts = f"{scored} forecast{'s' * (scored != 1)} scored, of {frames} frames"
    return Fact("Compared on", f"{where}: {forecasts}, the longest forecast {ahead} s ahead")


def _of_trial(run: ReportedRun, tables: Sequence[HeadlineTable]) -> Iterator[Fact]:
    """The virtual robot, and the outputs of its score that are the same for every tracker, for each table."""
    for table in tables:
        column = table.decisive
        outputs = [output for output in column.score.outputs if output.of_trial]
        trial = next((row.trial for row in table.rows if row.trial.complete), None)
        if outputs and trial is not None:
            shown = [replace(column, output=output) for output in outputs]
            numbers = ", ".join(f"{one.title} {one.cell(trial).text}" for one in shown)
            where = f"{table.recording}: " if len(tables) > 1 else ""
            yield Fact("Robot", f"{where}{run.record.configuration.robot}; {column.heading} ahead, {numbers}")


def _most_scored(run: ReportedRun, recording: str) -> int:
    """The largest number of forecasts of a row scored on a recording: some rows may have failed."""
    rows = (row.recordings.get(recording) for row in run.summary.trackers.values() if not row.ceiling)
    return max((trial.frames_scored for trial in rows if trial is not None), default=0)


def _weights(run: ReportedRun) -> Fact:
    cards = {
        label: ", ".join(sorted({trial.card for trial in _trials(row, run)} - {""}))
        for label, row in run.summary.trackers.items()
        if not row.ceiling
    }
    return Fact("Weights", _grouped({label: WEIGHTS_WORDS.get(card, card) for label, card in cards.items()}))


def _keeps_up(run: ReportedRun) -> Fact:
    """Whether each tracker keeps up on all of its recordings."""
    verdicts = {}
    for label, row in run.summary.trackers.items():
        trials = {name: trial for name, trial in row.recordings.items() if name in run.recordings}
        verdicts_of = (keeps_up_of(one, run.summary.recordings[name].period_s * 1e3) for name, one in trials.items())
        if found := list(filter(None, verdicts_of)):
            verdicts[name_in(run, label, run.recordings[0])] = min(found, key=KEEPING_UP.index)
    return Fact(KEEPS_UP, _grouped(verdicts) or UNTIMED)


def _not_ranked(run: ReportedRun) -> Fact:
    reasons = {
        label: "; ".join(failures_of(tuple(_trials(row, run)), MOST_CHARS))
        for label, row in run.summary.trackers.items()
    }
    found = _by_words({label: why for label, why in reasons.items() if why})
    return Fact("Not ranked", _listed([f"{_listed(labels)}: {why}" for why, labels in found.items()], "; "))


def _trials(row: TrackerSummary, run: ReportedRun) -> Iterator[TrialSummary]:
    return (trial for name, trial in row.recordings.items() if name in run.recordings)


def _grouped(words: Mapping[str, str]) -> str:
    """Labels, grouped by their words."""
    return "; ".join(f"{one}: {_listed(labels)}" for one, labels in _by_words(words).items())


def _by_words(words: Mapping[str, str]) -> dict[str, list[str]]:
    """The labels with the same words, by these words."""
    found: dict[str, list[str]] = {}
    for label, one in words.items():
        found.setdefault(one, []).append(label)
    return found


def _listed(names: Sequence[str], separator: str = ", ") -> str:
    shown = names if len(names) == MOST_NAMES + 1 else names[:MOST_NAMES]
    more = len(names) - len(shown)
    return separator.join(shown) + (f" and {more} more" if more else "")
