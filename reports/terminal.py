"""Output on a terminal: the progress of a run and its tables; plain lines and Markdown where there is no terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn
from rich.table import Table

from gridtrack.common.errors import printable
from gridtrack.evaluation.results.trial_record import TrialRecord
from gridtrack.reports.differences import DifferenceTable, difference_markdown, difference_table
from gridtrack.reports.run import read_runs
from gridtrack.reports.table import HeadlineTable, TableRow, headline_markdown, headline_tables, main_tables

GROUP_STYLES = {"ceiling": "italic", "ranked": "", "floor": "dim", "unranked": "yellow"}


class RunProgress:
    """The progress of a run: bars on a terminal, elsewhere one line at the end of each trial."""

    def __init__(self) -> None:
        self._console = Console(stderr=True)
        self._bars = Progress(
            TextColumn("{task.description}"), BarColumn(), TextColumn("{task.completed}/{task.total} frames"),
            TimeElapsedColumn(), console=self._console, disable=not self._console.is_terminal,
        )  # fmt: skip
        self._tasks: dict[str, TaskID] = {}

    def __enter__(self) -> Self:
        self._bars.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bars.stop()

    def note(self, text: str) -> None:
        """Print one line."""
        self._console.print(escape(text), highlight=False, soft_wrap=True)

    def started(self, trial: str, frames: int) -> None:
        """Show a bar for a trial of `frames` frames."""
        self._tasks[trial] = self._bars.add_task(escape(trial), total=frames)

    def advanced(self, trial: str) -> None:
        """Count one more frame that is delivered."""
        self._bars.advance(self._tasks[trial])

    def ended(self, trial: str, record: TrialRecord) -> None:
        """Print the outcome of a trial that has ended, or is kept from an earlier run."""
        if trial in self._tasks:
            self._bars.remove_task(self._tasks.pop(trial))
        scored = f"{record.frames_scored}/{record.frames_expected} forecasts scored"
        reason = f": {record.reason}" if record.reason else ""
        self.note(f"{trial}: {record.outcome}, {scored}, {record.times.wall_s:.1f} s{reason}")


def print_tables(run: Path) -> None:
    """Print the main tables of a run: formatted on a terminal, Markdown elsewhere. Raises RunError and
    ReportError."""
    console = Console()
    runs = read_runs([run])
    for table in main_tables(headline_tables(runs)):
        differences = difference_table(runs[0], table.recording)
        if console.is_terminal:
            console.print(_rich_headline_table(table))
            if differences:
                console.print(_rich_difference_table(differences))
            continue
        print(f"{printable(table.recording)}\n\n{headline_markdown(table)}")
        if differences:
            print(f"{_difference_title(differences)}\n\n{difference_markdown(differences)}")


def _difference_title(differences: DifferenceTable) -> str:
    return printable(
        f"scores less those of {differences.reference}, paired over {differences.units}; p of F1 corrected after Holm"
    )


def _rich_difference_table(differences: DifferenceTable) -> Table:
    shown = Table(title=escape(_difference_title(differences)), box=box.SIMPLE_HEAD)
    shown.add_column("tracker")
    for stratum, horizon_s in differences.columns:
        shown.add_column(f"{stratum}\n{horizon_s:g} s", justify="right")
    for row in differences.rows:
        cells = [f"{c.value}\n{escape(c.interval)}\n{c.p}\n{c.verdict}" for c in row.cells]
        shown.add_row(escape(f"{row.tracker}\n{row.score}"), *(cells or [escape(row.reason)]))
    return shown


def _rich_headline_table(table: HeadlineTable) -> Table:
    shown = Table(title=escape(table.recording), box=box.SIMPLE_HEAD)
    shown.add_column("tracker")
    for column in table.columns:
        shown.add_column(f"{column.group}\n{column.heading}", justify="right")
    shown.add_column("frames", justify="right")
    for row in table.rows:
        shown.add_row(*_row_texts(row), style=GROUP_STYLES[row.group])
    return shown


def _row_texts(row: TableRow) -> list[str]:
    numbers = [
        (f"[bold]{cell.text}[/bold]" if cell.best else cell.text)
        + (f"\n{escape(cell.interval_text)}" if cell.interval else "")
        for cell in row.cells
    ]
    outcome = "" if row.group != "unranked" else f" ({row.outcome})"
    return [escape(row.name) + outcome, *numbers, row.frames]


def print_rows(rows: Sequence[Mapping[str, str]]) -> None:
    """Print rows of the same keys: as a table on a terminal, tab-separated elsewhere."""
    console = Console()
    if not console.is_terminal:
        for row in rows:
            print("\t".join(row.values()))
        return
    shown = Table(box=box.SIMPLE_HEAD)
    for key in rows[0] if rows else ():
        shown.add_column(key)
    for row in rows:
        shown.add_row(*(escape(value) for value in row.values()))
    console.print(shown)
