"""The formats of an exported report, each from the same rows and columns. The page is one more: reports/page.py."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from gridtrack.common.errors import ConfigurationError, did_you_mean
from gridtrack.reports.chosen_recordings import chosen_runs
from gridtrack.reports.chosen_scores import ExportedTable, exported_tables
from gridtrack.reports.csv_table import csv_of_tables
from gridtrack.reports.junit import junit_of_tables
from gridtrack.reports.latex import latex_tables
from gridtrack.reports.print_figures import print_figure
from gridtrack.reports.pull_request import pull_request_markdown
from gridtrack.reports.run import ReportedRun, read_runs

PAGE = "html"

Render = Callable[[Sequence[ReportedRun], Sequence[ExportedTable], str], str | bytes]
"""From the runs, their tables as chosen, and the columns as the user gave them ("" for none)."""
FORMATS: dict[str, Render] = {
    "markdown": lambda runs, exported, columns: pull_request_markdown(runs, _main(exported)),
    "latex": lambda runs, exported, columns: latex_tables(_main(exported)),
    "csv": lambda runs, exported, columns: csv_of_tables(exported),
    "junit": lambda runs, exported, columns: junit_of_tables(exported),
    "svg": lambda runs, exported, columns: print_figure(runs, _main(exported), "svg", columns),
    "pdf": lambda runs, exported, columns: print_figure(runs, _main(exported), "pdf", columns),
}


FORMAT_NAMES = (PAGE, *FORMATS)


def _main(exported: Sequence[ExportedTable]) -> Sequence[ExportedTable]:
    """The table pooled over all recordings, where there is one; else all tables."""
    return [one for one in exported if one.table.pooled] or exported


def check_format(name: str) -> None:
    """Raises ConfigurationError for a format that there is not."""
    if name not in FORMAT_NAMES:
        raise ConfigurationError(f"--format '{name}': {did_you_mean(name, FORMAT_NAMES)}")


def render_as(name: str, runs: Sequence[Path], rows: str = "", columns: str = "", recordings: str = "") -> bytes:
    """The results of `runs` in the format `name` of FORMATS: `rows` and `columns` as `exported_tables` takes them,
    `recordings` as `chosen_runs`.

    Raises ConfigurationError, RunError and ReportError.
    """
    reported = chosen_runs(read_runs(runs), recordings)
    rendered = FORMATS[name](reported, exported_tables(reported, rows, columns), columns)
    return rendered if isinstance(rendered, bytes) else rendered.encode()
