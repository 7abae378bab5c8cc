"""The decision of a comparison in two sentences: the best tracker, and whether it is better than the best floor and the
next tracker, or how much more data would decide it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import scipy

from gridtrack.common.notices import joined_names
from gridtrack.evaluation.runs.summary import PairFamily, PairTest
from gridtrack.evaluation.statistics.jackknife import ALPHA, LEVEL
from gridtrack.reports.differences import SIGNIFICANT_VERDICTS
from gridtrack.reports.run import ReportedRun
from gridtrack.reports.table import HeadlineTable, TableRow, row_key

NAMED_ROWS = 2
"""Names of rows beyond this number are counted."""
POWER = 0.8
"""Probability with which the missing data would show a difference as large as the one seen."""
MOST_TIMES = 10.0
"""More data than this many times that of the run is not worth a number."""


def lead_of(runs: Sequence[ReportedRun], table: HeadlineTable) -> str:
    """The decision in the decisive column of a table; empty if rows do not compare. `runs`: the runs of the table."""
    return " ".join(_Decision(runs, table).sentences) if table.comparable else ""


@dataclass(frozen=True)
class _Test:
    """The test of two rows in the decisive column, in a family of `family.units` units."""

    test: PairTest
    family: PairFamily

    @property
    def decided(self) -> bool:
        """Whether the rows differ significantly."""
        return self.test.verdict in SIGNIFICANT_VERDICTS

    @property
    def _undecided(self) -> int:
        """The pairs over which Holm corrects a test that nothing has decided yet."""
        return max(1, sum(one.verdict not in SIGNIFICANT_VERDICTS for one in self.family.pairs))

    @property
    def detectable(self) -> float | None:
        """The smallest difference that a test of these units shows with probability POWER; None without an interval."""
        ends = self.test.difference.interval
        if ends is None:
            return None
        freedom = self.family.units - 1
        of_interval, of_test = (
            float(scipy.special.stdtrit(freedom, 1 - alpha / 2)) for alpha in (1 - LEVEL, ALPHA / self._undecided)
        )
        error = (ends[1] - ends[0]) / 2 / of_interval
        return error * (of_test + float(scipy.special.ndtri(POWER)))

    @property
    def times_missing(self) -> float:
        """How many times the data of the run are missing to decide a difference as large as the one seen."""
        seen = abs(self.test.difference.value or 0.0)
        if self.detectable is None or not seen:
            return math.inf
        return max((self.detectable / seen) ** 2 - 1.0, 1.0 / self.family.units)


class _Decision:
    """The sentences of one table: the rows `top` have the best score, to the digits shown."""

    def __init__(self, runs: Sequence[ReportedRun], table: HeadlineTable) -> None:
        self.table, self._runs, self._column = table, runs, table.decisive
        self._at = table.columns.index(table.decisive)
        self._top, self._floor = (self._best(table.rows_in(group)) for group in ("ranked", "floor"))
        rest = [row for row in table.rows_in("ranked") if row not in self._top]
        self._next = self._best(rest)
        self._tests = dict(self._tests_of_column())

    @property
    def sentences(self) -> Iterator[str]:
        """The whole decision."""
        if not self._top:
            yield self._why_none()
            return
        shown = (row.cells[self._at].text for row in (*self._top, *self._floor))
        if self._column.better > 0 and not any(map(float, shown)):
            yield f"Every tracker has {self._column.title_with_article} of {self._text(self._top)} {self._place}."
            return
        yield self._best_score()
        yield from self._comparisons()

    def _best(self, rows: Sequence[TableRow]) -> tuple[TableRow, ...]:
        """The rows with the best score; none if no row has one."""
        texts = [row.cells[self._at].text for row in rows if row.cells[self._at].value is not None]
        best = max(texts, key=lambda text: self._column.better * float(text), default="")
        return tuple(row for row in rows if row.cells[self._at].text == best)

    @property
    def _place(self) -> str:
        return f"on {self._column.stratum} cells {self._column.heading} ahead"

    def _number(self, rows: Sequence[TableRow]) -> float:
        return rows[0].cells[self._at].value or 0.0

    def _text(self, rows: Sequence[TableRow]) -> str:
        """The score of equal rows, with its unit."""
        return self._amount(self._number(rows))

    def _amount(self, value: float) -> str:
        """A score or a difference with its unit: of 100, if the score has a saying."""
        output = self._column.output
        return f"{100 * value:.0f} of 100" if output.saying else f"{value:.{output.decimals}f} {output.unit}".rstrip()

    def _best_score(self) -> str:
        """The best score: of a tracker, or of the floor if no tracker has a better one."""
        of_tracker, of_floor = (
            float(rows[0].cells[self._at].text) if rows else 0.0 for rows in (self._top, self._floor)
        )
        beaten = self._floor and self._column.better * (of_tracker - of_floor) <= 0
        if beaten:
            alone = len(self.table.rows_in("ranked")) == 1
            best = _names(self._top) if alone else f"the best tracker, {_names(self._top)},"
            return f"No tracker beats the floors: {self._said(self._floor)}; {best} has {self._text(self._top)}."
        return f"{self._said(self._top)}."

    def _said(self, rows: Sequence[TableRow]) -> str:
        """The score of equal rows as a clause."""
        column, several = self._column, len(rows) > 1
        if column.output.saying:
            share = f"{100 * self._number(rows):.0f}"
            predicate = column.output.saying.replace("{share}", share).replace("{ahead}", column.heading)
            return f"{_names(rows)} {'each ' if several else ''}{predicate}"
        if len(self.table.rows_in("ranked")) == 1 or rows is self._floor:
            return f"{_names(rows)} has {column.title_with_article} of {self._text(rows)} {self._place}"
        verb, each = ("have", " each") if several else ("has", "")
        best = "highest" if column.better > 0 else "lowest"
        return f"{_names(rows)} {verb} the {best} {column.title} {self._place}, {self._text(rows)}{each}"

    def _comparisons(self) -> Iterator[str]:
        """Whether the best rows are better than the best floor and the next tracker."""
        floor = "the best floor" if len(self.table.rows_in("floor")) > 1 else "the floor"
        others = [(floor, self._floor), ("the next tracker", self._next)]
        rows_of = {f"{word}, {_names(rows)} ({self._text(rows)})": rows for word, rows in others if rows}
        if not rows_of:
            return
        tested = {words: self._weakest(rows) for words, rows in rows_of.items()}
        if all(test is None for test in tested.values()):
            named = ", or than ".join(tested)
            who = "it" if len(self._top) == 1 else "each"
            yield f"This run cannot decide whether {who} is better than {named}: {self._why_untested()}."
            return
        found = [(words, rows_of[words], test) for words, test in tested.items() if test is not None]
        yield from self._decided(found)
        for words, test in tested.items():
            if test is None:
                yield f"{words[:1].upper()}{words[1:]}, was not tested against it."
        known = [test for *_, test in found if test.detectable is not None]
        open_ones = [test for test in known if not test.decided]
        if known:
            which = " between them" if open_ones else ""
            least = self._amount(max(test.detectable or 0.0 for test in open_ones or known))
            yield f"The smallest difference{which} that this run can show is {least}."

    def _decided(self, tested: Sequence[tuple[str, Sequence[TableRow], _Test]]) -> Iterator[str]:
        better, worse = (
            [
                words
                for words, _, test in tested
                if test.decided and (self._column.better * self._gain(test) > 0) is is_better
            ]
            for is_better in (True, False)
        )
        subject, who = ("It is", "it is") if len(self._top) == 1 else ("Each is", "each is")
        if better:
            yield f"{subject} better than {', and than '.join(better)}."
        if worse:
            yield f"{subject} worse than {', and than '.join(worse)}."
        for words, rows, test in tested:
            if not test.decided:
                yield f"There is no evidence that {who} better than {words}: {self._missing(test)}."
                if rows is self._next and (alike := self._also_alike()):
                    yield f"Nor is there evidence that {who} better than {_names(alike)}."

    def _also_alike(self) -> list[TableRow]:
        """The trackers besides the next one from which the best rows do not differ."""
        rest = [row for row in self.table.rows_in("ranked") if row not in self._top and row not in self._next]
        found = [(row, self._weakest([row])) for row in rest]
        return [row for row, test in found if test is not None and not test.decided]

    def _gain(self, test: _Test) -> float:
        """The score of the best row less the other's."""
        value = test.test.difference.value or 0.0
        return value if test.test.tracker in {row.label for row in self._top} else -value

    def _missing(self, test: _Test) -> str:
        """The data that would decide a difference as large as the one seen."""
        would = "would decide a difference as large as the one seen"
        if test.times_missing > MOST_TIMES:
            return f"more than ten times as much data of this kind {would}"
        run = self._runs[0]
        names = run.recordings if self.table.pooled else (self.table.recording,)
        described = [run.summary.recordings[name] for name in names]
        sources = len({one.source_sha256 or name for name, one in zip(names, described, strict=True)})
        if test.family.units == sources > 1:
            recordings = math.ceil(test.times_missing * sources)
            return f"about {recordings} more recording{'s' * (recordings != 1)} of this kind {would}"
        minutes = math.ceil(test.times_missing * sum(one.frames * one.period_s for one in described) / 60)
        return f"about {minutes} more minute{'s' * (minutes != 1)} of this kind {would}"

    def _weakest(self, rows: Sequence[TableRow]) -> _Test | None:
        """The test of the best rows against these that decides least; None if no pair was tested."""
        pairs = (frozenset((one.key, row.key)) for one in self._top for row in rows)
        found = [test for pair in pairs if (test := self._tests.get(pair))]
        return min(found, key=lambda test: (test.decided, -test.times_missing), default=None)

    def _tests_of_column(self) -> Iterator[tuple[frozenset[str], _Test]]:
        """The tests of the decisive column, by the keys of their rows."""
        sought = (self.table.recording, *self._column.key, self._column.stratum, self._column.step)
        several = len(self._runs) > 1
        for run in self._runs:
            for family in run.summary.pairs:
                if (family.recordings, family.score, family.output, family.stratum, family.step) == sought:
                    for test in family.pairs:
                        rows = (row_key(run.name if several else "", one) for one in (test.tracker, test.other))
                        yield frozenset(rows), _Test(test, family)

    def _why_untested(self) -> str:
        if len(self._runs) > 1:
            return "rows of different runs are not tested against each other"
        why = next((row.trial.interval for row in self._top if row.trial.interval), "")
        return why or "these rows were not tested against each other"

    def _why_none(self) -> str:
        """The sentence if no tracker has a rank."""
        table = self.table
        if table.rows_in("ranked"):
            return (
                f"No tracker has {self._column.title_with_article} {self._place} on {table.recording}: no such cell was"
                " occupied in the observed frames."
            )
        if any(row.trial.complete for row in table.rows_in("unranked")):
            return f"No tracker is ranked on {table.recording}: each learned from its frames, or did not complete it."
        if table.rows_in("unranked"):
            others = " but the floors" if table.rows_in("floor") else ""
            return f"No tracker{others} completed {table.recording}."
        return f"Only trackers of the floor were run on {table.recording}."


def _names(rows: Sequence[TableRow]) -> str:
    """The names of rows: the first ones, and the number of the others."""
    more = len(rows) - NAMED_ROWS
    return (
        f"{', '.join(row.name for row in rows[:NAMED_ROWS])} and {more} more"
        if more > 1
        else joined_names([row.name for row in rows])
    )
