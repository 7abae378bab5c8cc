"""The answer of a run: its main result in a sentence, and lines on recordings, weights, speed and missing ranks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from gridtrack.common.notices import joined_names
from gridtrack.evaluation.runs.summary import TrackerSummary, TrialSummary
from gridtrack.evaluation.statistics.jackknife import LEAST_UNITS
from gridtrack.reports.differences import SIGNIFICANT_VERDICTS
from gridtrack.reports.measurements import keeps_up_of
from gridtrack.reports.notices import failures_of
from gridtrack.reports.run import ReportedRun
from gridtrack.reports.run_description import Fact
from gridtrack.reports.table import HeadlineTable, TableRow, headline_tables, main_tables, row_key

NAMED_ROWS = 2
"""Names of rows in the main result beyond this number are counted."""
MOST_NAMES = 8
"""Further names of a line are counted, if they are more than one."""
MOST_CHARS = 300
"""A longer reason is cut."""
WEIGHTS_WORDS = {"site": "of the site", "general": "general", "general, site": "general or of the site", "": "none"}
UNTIMED = "not measured: gridtrack compare --latency measures it"
KEEPING_UP = ("no", "updates only", "yes")
"""The worst first: a tracker has the worst verdict of its recordings."""

RowStanding = Literal["different", "alike", ""]
"""The tests of a row against the rows at the top: significantly different, not significantly, or not tested."""


@dataclass(frozen=True)
class Answer:
    """The main result of one run in a sentence for each main table, and the lines below it that are not empty."""

    run: str
    leads: tuple[str, ...]
    facts: tuple[Fact, ...]


def answer_of(run: ReportedRun) -> Answer:
    """The answer of one run. Raises ReportError."""
    leads = (lead_of([run], table) for table in main_tables(headline_tables([run])))
    facts = (_compared(run), _weights(run), _keeps_up(run), _not_ranked(run))
    return Answer(run.name, tuple(filter(None, leads)), tuple(fact for fact in facts if fact.value))


def lead_of(runs: Sequence[ReportedRun], table: HeadlineTable) -> str:
    """The main result: the best score in the decisive column, the floor's, and the rows that differ significantly.

    Empty if rows do not compare. `runs`: the runs of the table. No tracker is called the best. Without tests a second
    sentence says that the order may be chance.
    """
    return _MainResult(runs, table).sentence if table.comparable else ""


class _MainResult:
    """The sentence of one table: the rows `top` have the best score, to the digits shown."""

    def __init__(self, runs: Sequence[ReportedRun], table: HeadlineTable) -> None:
        self.table, self._runs, self._column = table, runs, table.decisive
        self._at = table.columns.index(table.decisive)
        self._top, self._floor = (self._best(table.rows_in(group)) for group in ("ranked", "floor"))
        others = (*table.rows_in("ranked"), *table.rows_in("floor"))
        self._compared = [row for row in others if row not in self._top]
        self._standings = self._standings_of(self._compared)
        self._place = f"{self._column.stratum} cells {self._column.heading} ahead"

    @property
    def sentence(self) -> str:
        """The whole result."""
        if not self._top:
            return self._why_none()
        value, of_floor = (self._text(rows) if rows else "" for rows in (self._top, self._floor))
        if self._column.better > 0 and not float(value) and not float(of_floor or 0):
            return f"Every tracker has {self._column.title_with_article} of {value} on {self._place}."
        chance = f" {self._may_be_chance()}" if self._compared else ""
        if of_floor and self._column.better * (float(value) - float(of_floor)) <= 0:
            ends = {"different": "; they differ significantly.", "alike": "; they do not differ significantly."}
            return f"{self._unbeaten()}{ends.get(self._of_floor(), f'.{chance}')}"
        if not any(self._standings.values()):
            return f"{self._best_score(value)}; {self._against_floor()}.{chance}"
        return f"{self._best_score(value)}; {self._significance()}."

    def _best(self, rows: Sequence[TableRow]) -> tuple[TableRow, ...]:
        """The rows with the best score; none if no row has one."""
        texts = [row.cells[self._at].text for row in rows if row.cells[self._at].value is not None]
        best = max(texts, key=lambda text: self._column.better * float(text), default="")
        return tuple(row for row in rows if row.cells[self._at].text == best)

    def _text(self, rows: Sequence[TableRow]) -> str:
        return rows[0].cells[self._at].text

    def _best_score(self, value: str) -> str:
        """The trackers with the best score; the score of a single tracker."""
        if len(self.table.rows_in("ranked")) == 1:
            return f"{self._top[0].name} has {self._column.title_with_article} of {value} on {self._place}"
        verb, each = ("have", " each") if len(self._top) > 1 else ("has", "")
        return f"{_names(self._top)} {verb} the {self._best_word} {self._column.title} on {self._place}, {value}{each}"

    @property
    def _best_word(self) -> str:
        return "highest" if self._column.better > 0 else "lowest"

    def _unbeaten(self) -> str:
        """The sentence if the floor has the best score."""
        alone = len(self.table.rows_in("ranked")) == 1
        best = _names(self._top) if alone else f"the {self._best_word} of the trackers, {_names(self._top)},"
        floor = f"{_names(self._floor)} has {self._column.title_with_article} of {self._text(self._floor)}"
        return f"No tracker beats the floor on {self._place}: {floor}, {best} {self._text(self._top)}"

    def _standings_of(self, others: Sequence[TableRow]) -> dict[str, RowStanding]:
        """The standing of each row, by its key, against all rows at the top, in the tests of the decisive score."""
        verdicts = self._verdicts()
        found: dict[str, RowStanding] = {}
        for row in others:
            own = [verdict for one in self._top if (verdict := verdicts.get(frozenset((one.key, row.key))))]
            found[row.key] = (
                "" if not own else "different" if all(one in SIGNIFICANT_VERDICTS for one in own) else "alike"
            )
        return found

    def _verdicts(self) -> dict[frozenset[str], str]:
        """The verdict on each pair of rows that was tested by the decisive score, by their keys."""
        sought = (self.table.recording, *self._column.key, self._column.stratum, self._column.step)
        several = len(self._runs) > 1
        return {
            frozenset(row_key(run.name if several else "", one) for one in (test.tracker, test.other)): test.verdict
            for run in self._runs
            for family in run.summary.pairs
            if (family.recordings, family.score, family.output, family.stratum, family.step) == sought
            for test in family.pairs
        }

    def _of_floor(self) -> RowStanding:
        """The standing of the best rows of the floor together: `alike` if any of them is."""
        found = {self._standings[row.key] for row in self._floor}
        return "alike" if "alike" in found else "different" if "different" in found else ""

    def _against_floor(self) -> str:
        if not self._floor:
            return "no tracker of the floor was run"
        return f"the floor, {_names(self._floor)}, has {self._text(self._floor)}"

    def _significance(self) -> str:
        """Rows that differ significantly from the rows at the top, and the names of the others."""
        rest = [row for row in self._compared if row not in self._floor]
        different, alike, untested = (
            [row for row in rest if self._standings[row.key] == one] for one in ("different", "alike", "")
        )
        differs, not_so = ("differs", "does not differ") if len(self._top) == 1 else ("all differ", "not all differ")
        subject = "it " if len(self._top) == 1 else ""
        every = f"every other tracker{' that was tested with it' if untested else ''}"
        match self._of_floor():
            case "different":
                end = f", but not from {_some(alike)}" if alike else f", and from {every}" if different else ""
                text = f"{subject}{differs} significantly from the floor, {self._named_floor}{end}"
            case "alike":
                end = f", nor from {_some(alike)}" if alike else f", but from {every}" if different else ""
                text = f"{subject}{not_so} significantly from the floor, {self._named_floor}{end}"
            case _:
                verb, whom = (not_so, _some(alike)) if alike else (differs, every)
                text = f"{self._against_floor()}; {subject}{verb} significantly from {whom}"
        return text + (f"; not tested: {_some(untested)}" if untested else "")

    @property
    def _named_floor(self) -> str:
        return f"{_names(self._floor)} at {self._text(self._floor)}"

    def _may_be_chance(self) -> str:
        """The sentence on rows without tests: their order may be chance, and why they were not tested."""
        why = "these rows were not tested against each other"
        if not self.table.has_intervals:
            why = f"there are fewer than the {LEAST_UNITS} units that a test needs"
        elif len(self._runs) > 1:
            why = "rows of different runs are not tested against each other"
        return f"The order may be chance: {why}."

    def _why_none(self) -> str:
        """The result if no tracker has a rank."""
        table = self.table
        if table.rows_in("ranked"):
            return (
                f"No tracker has a score on {self._place} on {table.recording}: no such cell was occupied in the"
                " observed frames."
            )
        if any(row.trial.complete for row in table.rows_in("unranked")):
            return f"No tracker is ranked on {table.recording}: each learned from its frames, or did not complete it."
        if table.rows_in("unranked"):
            others = " but the floors" if table.rows_in("floor") else ""
            return f"No tracker{others} completed {table.recording}."
        return f"Only trackers of the floor were run on {table.recording}."


def _names(rows: Sequence[TableRow]) -> str:
    return joined_names([row.name for row in rows])


def _some(rows: Sequence[TableRow]) -> str:
    """The first of the names, and the number of the others."""
    more = len(rows) - NAMED_ROWS
    return f"{', '.join(row.name for row in rows[:NAMED_ROWS])} and {more} more" if more > 1 else _names(rows)


def _compared(run: ReportedRun) -> Fact:
    recordings = [run.summary.recordings[name] for name in run.recordings]
    frames, scored = sum(one.frames for one in recordings), sum(_most_scored(run, name) for name in run.recordings)
    where = recordings[0].stretch or run.recordings[0] if len(recordings) == 1 else f"{len(recordings)} recordings"
    furthest_s = [one.horizons_s[-1] for one in recordings]
    ahead = " to ".join(dict.fromkeys(f"{s:.3g}" for s in (min(furthest_s), max(furthest_s))))
    forecasts = f"{scored} forecast{'s' * (scored != 1)} scored, of {frames} frames"
    return Fact("Compared on", f"{where}: {forecasts}, the longest forecast {ahead} s ahead")


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
            verdicts[label] = min(found, key=KEEPING_UP.index)
    return Fact("Keeps up with the sensor", _grouped(verdicts) or UNTIMED)


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
