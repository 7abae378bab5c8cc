"""Tables on a terminal, as wide as it is and with whole names; Markdown where there is no terminal."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from rich import box
from rich.cells import cell_len
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from gridtrack.common.errors import printable, printable_lines
from gridtrack.reports.differences import DifferenceCell, DifferenceTable, difference_markdown, difference_table
from gridtrack.reports.run import read_runs
from gridtrack.reports.table import HeadlineTable, TableCell, headline_markdown, headline_tables, main_tables

MAX_COLUMN_WIDTH = len("[-0.0123, +0.0456]")
EDGES = 3
"""Characters between two columns: padding and a divider."""
GROUP_STYLES = {"ceiling": "italic", "ranked": "", "floor": "dim", "unranked": "yellow"}


def print_tables(run: Path) -> None:
    """Print the main tables of a run: formatted on a terminal, Markdown elsewhere. Raises RunError and
    ReportError."""
    console = Console()
    runs = read_runs([run])
    for table in main_tables(headline_tables(runs)):
        differences = difference_table(runs[0], table.recording)
        if console.is_terminal:
            for part in _rich_headline_tables(table, console.width):
                console.print(part)
            for part in _rich_difference_tables(differences, console.width) if differences else ():
                console.print(part)
            continue
        print(f"{printable(table.recording)}\n\n{headline_markdown(table)}")
        if differences:
            print(f"{_difference_title(differences)}\n\n{difference_markdown(differences)}")


def _difference_title(differences: DifferenceTable) -> str:
    return printable(
        f"scores less those of {differences.reference}, paired over {differences.units}; p of F1 corrected after Holm"
    )


def _rich_difference_tables(differences: DifferenceTable, width: int) -> Iterator[Table]:
    names = [_plain(f"{row.tracker}\n{row.score}") for row in differences.rows]
    columns = [
        _Column(
            f"{stratum}\n{horizon_s:g} s",
            [
                _difference_text(row.cells[at]) if row.cells else _plain(row.reason) * (at == 0)
                for row in differences.rows
            ],
        )
        for at, (stratum, horizon_s) in enumerate(differences.columns)
    ]
    yield from _tables(escape(_difference_title(differences)), names, columns, [""] * len(names), width)


def _plain(text: str) -> str:
    """`text` for a table of rich: without characters that act on a terminal, and without markup."""
    return escape(printable_lines(text))


def _difference_text(cell: DifferenceCell) -> str:
    return f"{cell.value}\n{escape(cell.interval)}\n{cell.p}\n{cell.verdict}"


def _rich_headline_tables(table: HeadlineTable, width: int) -> Iterator[Table]:
    names = [_plain(row.name) + (f"\n({row.outcome})" if row.group == "unranked" else "") for row in table.rows]
    columns = [
        _Column(f"{column.group}\n{column.heading}", [_cell_text(row.cells[at]) for row in table.rows])
        for at, column in enumerate(table.columns)
    ]
    columns.append(_Column("frames", [row.frames for row in table.rows]))
    yield from _tables(_plain(table.recording), names, columns, [GROUP_STYLES[row.group] for row in table.rows], width)


def _cell_text(cell: TableCell) -> str:
    number = f"[bold]{cell.text}[/bold]" if cell.best else cell.text
    return f"{number}\n{escape(cell.interval_text)}" if cell.interval else number


class _Column(NamedTuple):
    """A column of numbers: its heading, and a text for each row, with markup."""

    heading: str
    cells: Sequence[str]

    @property
    def width(self) -> int:
        """The width of its longest line, at most that of an interval: a longer line is wrapped."""
        return min(max(_longest_line(text) for text in (self.heading, *self.cells)), MAX_COLUMN_WIDTH)


def _longest_line(text: str) -> int:
    """The width of the longest line of a text with markup."""
    return max(cell_len(line) for line in Text.from_markup(text).plain.split("\n"))


def _tables(
    title: str, names: Sequence[str], columns: Sequence[_Column], styles: Sequence[str], width: int
) -> Iterator[Table]:
    """Tables of at most `width` that show all columns, one after the other, each with the whole names."""
    name_width = max(_longest_line(text) for text in ("tracker", *names))
    for number, part in enumerate(_parts(columns, width - name_width - EDGES)):
        shown = Table(title=f"{title} (continued)" if number else title, box=box.SIMPLE_HEAD)
        shown.add_column("tracker", no_wrap=True, overflow="fold")
        for column in part:
            shown.add_column(column.heading, justify="right", width=column.width)
        for row, (name, style) in enumerate(zip(names, styles, strict=True)):
            shown.add_row(name, *(column.cells[row] for column in part), style=style)
        yield shown


def _parts(columns: Sequence[_Column], width: int) -> Iterator[list[_Column]]:
    """The columns in parts that fit the width, at least one in each."""
    part: list[_Column] = []
    for column in columns:
        if part and sum(one.width + EDGES for one in (*part, column)) > width:
            yield part
            part = []
        part.append(column)
    yield part


def print_rows(rows: Sequence[Mapping[str, str]]) -> None:
    """Print rows of the same keys: as a table on a terminal, tab-separated elsewhere."""
    console = Console()
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
