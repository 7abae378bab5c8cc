"""The main result of a run in a sentence: the highest score, and from which rows the tests tell it apart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

from gridtrack.evaluation.statistics.jackknife import LEAST_UNITS
from gridtrack.reports.run import ReportedRun
from gridtrack.reports.table import HeadlineTable, TableRow, joined_names, row_key
from gridtrack.reports.tiers import TOLD_APART

NAMED_ROWS = 2
"""Names of rows beyond this number are counted."""

Told = Literal["apart", "alike", ""]
"""What the tests say of a row beside those at the top: told apart, not told apart, not tested."""


def lead_of(runs: Sequence[ReportedRun], table: HeadlineTable) -> str:
    """The main result: the highest score in the decisive column, the floor's, and which rows the tests tell apart;
    empty if rows do not compare.

    `runs`: those of the table. No tracker is called the best. Where the rows were not tested, a second sentence says
    that their order may be chance.
    """
    if not table.comparable:
        return ""
    at = table.columns.index(table.decisive)
    top, floor = (_highest(table.rows_in(group), at) for group in ("ranked", "floor"))
    if not top:
        return _why_no_result(table)
    value, of_floor = (rows[0].cells[at].text if rows else "0" for rows in (top, floor))
    ahead = f"{table.decisive.stratum} cells {table.decisive.heading} ahead"
    if not max(float(value), float(of_floor)):
        return f"On {ahead} every tracker has {_with_article(table.decisive.score_name)} of {value}."
    compared = [row for row in (*table.rows_in("ranked"), *table.rows_in("floor")) if row not in top]
    standings = _standings(runs, table, top, compared)
    chance = f" {_may_be_chance(runs, table)}" if compared else ""
    if floor and float(value) <= float(of_floor):
        told = {"apart": "; these are told apart.", "alike": "; these are not told apart.", "": f".{chance}"}
        return f"{_unbeaten(table, top, floor, ahead)}{told[_of_floor(standings, floor)]}"
    result = _highest_of(table, top, value, ahead)
    if not any(standings.values()):
        return f"{result}; {_against_floor(floor, of_floor)}.{chance}"
    return f"{result}; {_told_apart(standings, compared, floor, of_floor, several=len(top) > 1)}."


def _highest_of(table: HeadlineTable, top: Sequence[TableRow], value: str, ahead: str) -> str:
    """The trackers with the highest score; of a single tracker its score."""
    name = table.decisive.score_name
    if len(table.rows_in("ranked")) == 1:
        return f"{top[0].name} has {_with_article(name)} of {value} on {ahead}"
    have, each = ("have", " each") if len(top) > 1 else ("has", "")
    return f"{_names(top)} {have} the highest {name} on {ahead}, {value}{each}"


def _unbeaten(table: HeadlineTable, top: Sequence[TableRow], floor: Sequence[TableRow], ahead: str) -> str:
    """That the floor has the highest score."""
    at = table.columns.index(table.decisive)
    alone = len(table.rows_in("ranked")) == 1
    highest = _names(top) if alone else f"the highest of the trackers, {_names(top)},"
    of_floor, value = (rows[0].cells[at].text for rows in (floor, top))
    best = f"{_names(floor)} at {_with_article(table.decisive.score_name)} of {of_floor}, {highest} at {value}"
    return f"No tracker beats the floor on {ahead}: {best}"


def _standings(
    runs: Sequence[ReportedRun], table: HeadlineTable, top: Sequence[TableRow], others: Sequence[TableRow]
) -> dict[str, Told]:
    """Whether the tests by the decisive score tell each of the `others`, by its key, apart from all rows at the top."""
    verdicts = _verdicts(runs, table)
    found: dict[str, Told] = {}
    for row in others:
        own = [told for one in top if (told := verdicts.get(frozenset((one.key, row.key))))]
        found[row.key] = "" if not own else "apart" if all(told in TOLD_APART for told in own) else "alike"
    return found


def _verdicts(runs: Sequence[ReportedRun], table: HeadlineTable) -> dict[frozenset[str], str]:
    """The verdict on each pair of rows that was tested by the decisive score, by their keys."""
    decisive = table.decisive
    sought = (table.recording, decisive.score, decisive.stratum, decisive.step)
    return {
        frozenset(row_key(run.name if len(runs) > 1 else "", one) for one in (test.tracker, test.other)): test.verdict
        for run in runs
        for family in run.summary.pairs
        if (family.recordings, family.score, family.stratum, family.step) == sought
        for test in family.pairs
    }


def _of_floor(standings: Mapping[str, Told], floor: Sequence[TableRow]) -> Told:
    """The standing of the best rows of the floor together: one that is not told apart decides."""
    found = {standings[row.key] for row in floor}
    return "alike" if "alike" in found else "apart" if "apart" in found else ""


def _against_floor(floor: Sequence[TableRow], of_floor: str) -> str:
    return f"the floor, {_names(floor)}, reaches {of_floor}" if floor else "no tracker of the floor was run"


def _told_apart(
    standings: Mapping[str, Told],
    compared: Sequence[TableRow],
    floor: Sequence[TableRow],
    of_floor: str,
    several: bool,
) -> str:
    """What the rows at the top are told apart from, and by name what they are not; `several` are at the top."""
    rest = [row for row in compared if row not in floor]
    apart, alike, untested = ([row for row in rest if standings[row.key] == one] for one in ("apart", "alike", ""))
    is_apart, is_not = ("all of these are", "not all of these are") if several else ("it is", "it is not")
    every = f"every other tracker{' that was tested with it' if untested else ''}"
    match _of_floor(standings, floor):
        case "apart":
            end = f", but not from {_some(alike)}" if alike else f", and from {every}" if apart else ""
            told = f"{is_apart} told apart from the floor, {_names(floor)} at {of_floor}{end}"
        case "alike":
            end = f", nor from {_some(alike)}" if alike else f", but from {every}" if apart else ""
            told = f"{is_not} told apart from the floor, {_names(floor)} at {of_floor}{end}"
        case _:
            told = f"{is_not} told apart from {_some(alike)}" if alike else f"{is_apart} told apart from {every}"
            told = f"{_against_floor(floor, of_floor)}; {told}"
    return told + (f"; not tested: {_some(untested)}" if untested else "")


def _may_be_chance(runs: Sequence[ReportedRun], table: HeadlineTable) -> str:
    """That the order of rows that were not tested may be chance, and why they were not."""
    why = "these rows were not tested against each other"
    if not table.has_intervals:
        why = f"there are fewer than the {LEAST_UNITS} units that a test needs"
    elif len(runs) > 1:
        why = "rows of different runs are not tested against each other"
    return f"The order may be chance: {why}."


def _with_article(score: str) -> str:
    return f"{'an' if score == 'F1' else 'a'} {score}"


def _why_no_result(table: HeadlineTable) -> str:
    """The result where no tracker has a score to be ranked by."""
    if table.rows_in("ranked"):
        return (
            f"No tracker has {_with_article(table.decisive.score_name)} on {table.decisive.stratum} cells"
            f" {table.decisive.heading} ahead on {table.recording}: no such cell was occupied in the observed frames."
        )
    if any(row.trial.complete for row in table.rows_in("unranked")):
        return f"No tracker is ranked on {table.recording}: each learned from its frames, or did not complete it."
    if table.rows_in("unranked"):
        others = " but those of the floor" if table.rows_in("floor") else ""
        return f"No tracker{others} completed {table.recording}."
    return f"Only trackers of the floor were run on {table.recording}."


def _highest(rows: Sequence[TableRow], at: int) -> tuple[TableRow, ...]:
    """The rows with the highest score in the column `at`, to the digits shown; none where no row has one."""
    defined = [row for row in rows if row.cells[at].value is not None]
    top = max((row.cells[at].text for row in defined), key=float, default="")
    return tuple(row for row in defined if row.cells[at].text == top)


def _names(rows: Sequence[TableRow]) -> str:
    return joined_names([row.name for row in rows])


def _some(rows: Sequence[TableRow]) -> str:
    """The first of the names, and how many more there are."""
    more = len(rows) - NAMED_ROWS
    return f"{', '.join(row.name for row in rows[:NAMED_ROWS])} and {more} more" if more > 1 else _names(rows)
