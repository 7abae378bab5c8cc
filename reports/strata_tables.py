"""Tables of scores outside the main table: on hidden cells, and in further strata."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from gridtrack.evaluation.referee.strata import OCCLUDED
from gridtrack.evaluation.runs.summary import TrackerDifference
from gridtrack.reports.differences import DifferenceCell
from gridtrack.reports.run import ReportedRun
from gridtrack.reports.table import (
    MAIN_STRATUM,
    HeadlineTable,
    TableCell,
    TableColumn,
    TableRow,
    grouped,
    horizon_text,
    name_in,
)


@dataclass(frozen=True)
class StrataTable:
    """Every tracker with a score in the columns, and if there is one, its difference from the reference."""

    title: str
    about: str
    """Its caption."""
    columns: tuple[TableColumn, ...]
    rows: tuple[tuple[TableRow, tuple[tuple[TableCell, DifferenceCell | None], ...]], ...]
    reference: str
    """The other row of the differences; empty without differences."""
    why_no_interval: str
    """Why the scores have no interval; empty if they have one."""
    thresholds_matter: bool = False
    """Whether the order of ranked rows depends on the threshold."""

    @property
    def has_p(self) -> bool:
        """Whether any difference has a p-value."""
        return any(less is not None and less.p for _, cells in self.rows for _, less in cells)

    @property
    def groups(self) -> tuple[tuple[str, int], ...]:
        """The headings of the groups of columns, and the number of columns in each."""
        return grouped(self.columns)


def strata_tables(table: HeadlineTable, run: ReportedRun | None) -> Iterator[StrataTable]:
    """The tables of one recording; `run`: the only run on the page, else there are no differences."""
    if hidden := _made(table, run, "Hidden cells by threshold", "", list(_hidden_columns(table))):
        yield hidden
    for score in dict.fromkeys(column.score.name for column in _own_columns(table)):
        columns = [column for column in _own_columns(table) if column.score.name == score]
        if made := _made(table, run, columns[0].score.title, columns[0].score.about.replace("`", ""), columns):
            yield made


def _hidden_columns(table: HeadlineTable) -> Iterator[TableColumn]:
    """The tested scores on hidden cells at the detail horizon, at every tested threshold."""
    step, heading = table.decisive.step, table.decisive.heading
    for score in (one for one in table.scores if one.compared_with == "occupancy"):
        for output in score.outputs if score.thresholded else (score.lead,):
            if output.tested:
                yield TableColumn(f"{OCCLUDED}, {heading}", output.heading, OCCLUDED, score, output, step)


def _own_columns(table: HeadlineTable) -> Iterator[TableColumn]:
    """The scores that are undefined on the cells of the main table, in each of their strata.

    Each has its leading output; a loss also has an output with better higher values. Scores of classes are also at step
    0, because the class of a visible cell may be wrong too.
    """
    trials = [row.trial for row in table.rows]
    for score in table.scores:
        strata = dict.fromkeys(name for trial in trials for name in trial.strata if score.name in trial.strata[name])
        if MAIN_STRATUM in strata or set(strata) <= {OCCLUDED}:
            continue
        steps = (0, table.decisive.step) if score.compared_with == "classes" else (table.decisive.step,)
        beside = [one for one in score.outputs if one.direction > 0 > score.lead.direction]
        for output in (score.lead, *beside):
            for step in steps:
                when = horizon_text(table.horizons_s[step]) if step else "now"
                for stratum in strata:
                    yield TableColumn(f"{output.heading}, {when}", stratum, stratum, score, output, step)


def _made(
    table: HeadlineTable, run: ReportedRun | None, title: str, about: str, columns: Sequence[TableColumn]
) -> StrataTable | None:
    """The table of the columns with a score in any row; None without such columns."""
    shown = tuple(column for column in columns if any(column.cell(row.trial).value is not None for row in table.rows))
    if not shown:
        return None
    compared = run.differences_on(table.recording) if run else []
    rows = []
    reference = ""
    for row in table.rows:
        cells = []
        for column in shown:
            found = [
                (one, less) for one in compared if one.tracker == row.label for less in [_less(one, column)] if less
            ]
            reference = reference or (name_in(run, found[0][0].reference, table.recording) if run and found else "")
            cells.append((column.cell(row.trial), found[0][1] if found else None))
        if any(cell.value is not None for cell, _ in cells):
            rows.append((row, tuple(cells)))
    return StrataTable(
        title,
        about,
        shown,
        tuple(rows),
        reference,
        next((row.trial.interval for row, _ in rows if row.trial.interval), ""),
        _thresholds_matter(table, shown),
    )


def _less(difference: TrackerDifference, column: TableColumn) -> DifferenceCell | None:
    """The difference of a tracker in a column, with its uncorrected p-value; None if there is none."""
    found = difference.at(column.stratum, *column.key, column.step)
    return None if found.value is None else DifferenceCell.of(found, column.output.decimals, found.p, "")


def _thresholds_matter(table: HeadlineTable, columns: Sequence[TableColumn]) -> bool:
    """Whether two thresholds order ranked rows differently, for one score on the same cells."""
    by_score: dict[tuple[str, str, int], list[TableColumn]] = {}
    for column in columns:
        if column.score.thresholded:
            by_score.setdefault((column.score.name, column.stratum, column.step), []).append(column)
    return any(len(_orders(table, alike)) > 1 for alike in by_score.values())


def _orders(table: HeadlineTable, columns: Sequence[TableColumn]) -> set[tuple[int, ...]]:
    """The orders of the ranked rows that have a value in every column."""
    rows = [[column.cell(row.trial).value for column in columns] for row in table.rows_in("ranked")]
    known = [[value for value in values if value is not None] for values in rows]
    whole = [values for values in known if len(values) == len(columns)]
    return {
        tuple(sorted(range(len(whole)), key=lambda row: -columns[i].better * whole[row][i]))
        for i in range(len(columns))
    }
