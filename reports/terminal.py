"""The result of a run as a table for a terminal, as wide as it is and with whole names, or else as Markdown."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from gridtrack.common.errors import printable, printable_lines
from gridtrack.evaluation.runs.finished import HEADLINE_STRATA
from gridtrack.reports.answer import answer_of
from gridtrack.reports.differences import SIGNIFICANT_VERDICTS, DifferenceTable, difference_table
from gridtrack.reports.markdown import cell_text, markdown_table
from gridtrack.reports.run import read_runs
from gridtrack.reports.table import HeadlineTable, headline_tables, main_tables

GROUP_STYLES = {"ceiling": "italic", "ranked": "", "floor": "dim", "unranked": "yellow"}
CHANCE = "°"
"""The mark of a difference that may be chance."""
UNBOUNDED_WIDTH = 10_000
"""Width in characters that no table needs."""


def print_result(run: Path) -> None:
    """Print the main result in a sentence, a row for each tracker, and the lines of the answer.

    The table is formatted on a terminal, and Markdown elsewhere. All scores are in the report. Raises RunError and
    ReportError.
    """
    runs, console = read_runs([run]), Console(emoji=False)
    answer = answer_of(runs[0])
    for lead in answer.leads:
        _print_line(console, lead)
    for table in main_tables(headline_tables(runs)):
        differences = difference_table(runs[0], table.recording)
        headings, texts = zip(*_columns(table, differences), strict=True)
        rows = list(map(list, zip(*texts, strict=True)))
        if console.is_terminal:
            console.print(_formatted(console, table, headings, rows))
        else:
            shown = [[cell_text(cell) for cell in row] for row in rows]
            print(f"\n{printable(table.recording)}\n\n{markdown_table(headings, shown, range(1, len(headings)))}")
        if differences:
            _print_line(console, f"Paired over {differences.units}. {CHANCE}: no difference shown (Holm).")
    for fact in answer.facts:
        _print_line(console, f"{fact.name}: {fact.value}")


def _print_line(console: Console, text: str) -> None:
    """Print a sentence, wrapped on a terminal only."""
    console.print(_plain(text), highlight=False, soft_wrap=not console.is_terminal)


def _columns(table: HeadlineTable, differences: DifferenceTable | None) -> Iterator[tuple[str, list[str]]]:
    """A heading, and a text for each row: the decisive score, and the headline score of other strata at its horizon."""
    decisive = table.decisive
    names = (f"{row.name} ({row.remark})" if row.remark else row.name for row in table.rows)
    yield "tracker", list(names)
    at = table.columns.index(decisive)
    scores = [f"{row.cells[at].text} {row.cells[at].interval_text}".rstrip() for row in table.rows]
    yield f"{decisive.group} {decisive.heading}", scores
    if differences:
        paired = _decisive_differences(differences, table)
        yield (
            f"{differences.headline} less {printable(differences.reference)}",
            [paired.get(row.label, "") for row in table.rows],
        )
    for at, column in enumerate(table.columns):
        beside = column.key == table.headline and column.stratum in HEADLINE_STRATA and column.step == decisive.step
        if beside and column is not decisive:
            yield column.group, [row.cells[at].text for row in table.rows]
    frames = [row.frames for row in table.rows]
    if len(set(frames)) > 1:  # else the answer has their number
        yield "frames", frames


def _decisive_differences(differences: DifferenceTable, table: HeadlineTable) -> dict[str, str]:
    """The difference of the headline score in the decisive column's stratum and horizon, by tracker."""
    horizon_s = table.horizons_s[table.decisive.step]
    nearest = min(
        (at for at, (stratum, _) in enumerate(differences.columns) if stratum == table.decisive.stratum),
        key=lambda at: abs(differences.columns[at][1] - horizon_s),
    )
    found = {}
    for row in (one for one in differences.rows if one.leads):
        cell = row.cells[nearest] if row.cells else None
        mark = "" if cell is None or cell.verdict in SIGNIFICANT_VERDICTS else CHANCE
        found[row.tracker] = "not compared" if cell is None else f"{cell.value}{mark} {cell.interval}"
    return found


def _formatted(console: Console, table: HeadlineTable, headings: Sequence[str], rows: Sequence[list[str]]) -> Table:
    """The table; if it is too wide, intervals and the words of headings are on lines of their own."""
    wide = _table_of(table, headings, rows)
    if console.measure(wide, options=console.options.update_width(UNBOUNDED_WIDTH)).maximum <= console.width:
        return wide
    folded = [[re.sub(r" (?=[\[(])", "\n", cell) for cell in row] for row in rows]
    return _table_of(table, [re.sub(r"(?<=,) | (?=\S+ s$|less )", "\n", heading) for heading in headings], folded)


def _table_of(table: HeadlineTable, headings: Sequence[str], rows: Sequence[list[str]]) -> Table:
    shown = Table(title=_plain(table.recording), box=box.SIMPLE_HEAD, pad_edge=False)
    for number, heading in enumerate(headings):
        shown.add_column(_plain(heading), justify="right" if number else "left", overflow="fold")
    for row, cells in zip(table.rows, rows, strict=True):
        shown.add_row(*map(_plain, cells), style=GROUP_STYLES[row.group])
    return shown


def _plain(text: str) -> str:
    """`text` for rich: without characters that act on a terminal, and without markup."""
    return escape(printable_lines(text))


def print_rows(rows: Sequence[Mapping[str, str]]) -> None:
    """Print rows of the same keys: as a table on a terminal, tab-separated elsewhere."""
    console = Console(emoji=False)
    if not console.is_terminal:
        for row in rows:
            print("\t".join(map(printable, row.values())))
        return
    shown = Table(box=box.SIMPLE_HEAD)
    for number, key in enumerate(rows[0] if rows else ()):
        shown.add_column(key, no_wrap=number == 0, overflow="fold")
    for row in rows:
        shown.add_row(*(_plain(value) for value in row.values()))
    console.print(shown)
