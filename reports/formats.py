"""The formats of an exported report, all from the same rows and columns, except the page (reports/page.py)."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path

from gridtrack.common.errors import ConfigurationError, did_you_mean, printable
from gridtrack.reports.chosen_scores import ExportedTable, exported_tables
from gridtrack.reports.differences import difference_markdown
from gridtrack.reports.junit import junit_of_tables
from gridtrack.reports.markdown import escaped
from gridtrack.reports.notices import notices_of
from gridtrack.reports.print_figures import print_figure
from gridtrack.reports.run import ReportedRun, chosen_runs, read_runs
from gridtrack.reports.run_description import title_of
from gridtrack.reports.table import HeadlineTable, TableCell, TableRow, headline_markdown

PAGE = "html"
FORMULA = ("=", "+", "-", "@")
"""The first sign of a formula in a spreadsheet."""
SPECIAL = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    '"': r"\textquotedbl{}",
    "`": r"\textasciigrave{}",
    "'": r"\textquotesingle{}",
    **{sign: f"\\{sign}" for sign in "{}$&#%_"},
}
LIGATURE = re.compile("([-,])(?=\\1)")
"""TeX turns two of these in a row into another sign: a dash, a quotation mark."""

Render = Callable[[Sequence[ReportedRun], Sequence[ExportedTable], str], str | bytes]
"""From the runs, the chosen tables, and the user's option for columns ("" if not given)."""


def check_format(name: str) -> None:
    """Raises ConfigurationError for an unknown format."""
    if name not in FORMAT_NAMES:
        raise ConfigurationError(f"--format '{name}': {did_you_mean(name, FORMAT_NAMES)}")


def render_as(name: str, runs: Sequence[Path], rows: str = "", columns: str = "", recordings: str = "") -> bytes:
    """The results of `runs` in the format `name` of FORMATS; `rows` and `columns` as in `exported_tables`,
    `recordings` as in `chosen_runs`.

    Raises ConfigurationError, RunError and ReportError.
    """
    reported = chosen_runs(read_runs(runs), recordings)
    rendered = FORMATS[name](reported, exported_tables(reported, rows, columns), columns)
    return rendered if isinstance(rendered, bytes) else rendered.encode()


def _main(exported: Sequence[ExportedTable]) -> Sequence[ExportedTable]:
    """The table pooled over all recordings, if there is one; else all tables."""
    return [one for one in exported if one.table.pooled] or exported


def pull_request_markdown(runs: Sequence[ReportedRun], exported: Sequence[ExportedTable]) -> str:
    """The main result in a sentence, the scores, paired differences and notices."""
    parts = [f"## gridtrack: {escaped(title_of(runs))}"]
    for one in exported:
        parts += _of_table(one, len(exported) > 1)
    notices = notices_of(runs, [one.table for one in exported])
    parts += ["\n".join(f"- {escaped(notice.text)}" for notice in notices)] if notices else []
    return "\n\n".join(parts) + "\n"


def _of_table(one: ExportedTable, titled: bool) -> Iterator[str]:
    if titled:
        yield f"### {escaped(one.table.recording)}"
    if one.lead:
        yield escaped(one.lead)
    yield headline_markdown(one.table).rstrip("\n")
    if one.differences:
        yield (
            f"Scores less {escaped(one.differences.reference)}, paired over {one.differences.units}; p of"
            f" {one.differences.headline} corrected after Holm:"
        )
        yield difference_markdown(one.differences).rstrip("\n")


def csv_of_tables(exported: Sequence[ExportedTable]) -> str:
    """A row for each tracker on each recording, for spreadsheets and scripts.

    Columns: `recording`, `run` (empty for one), `tracker`, `outcome`, `frames_scored`, `frames_expected`, and each
    score with the ends of its interval as `... low` and `... high`; empty if undefined. A name that begins as a
    formula has an apostrophe before it. Columns that only some recordings have are empty for the others.
    """
    rows = [dict(_fields(one, row)) for one in exported for row in one.table.rows]
    columns = list(dict.fromkeys(column for row in rows for column in row))
    written = io.StringIO()
    writer = csv.DictWriter(written, columns, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return written.getvalue()


def _fields(one: ExportedTable, row: TableRow) -> Iterator[tuple[str, str | int | float | None]]:
    yield "recording", _text(one.table.recording)
    yield "run", _text(row.run)
    yield "tracker", _text(row.label)
    yield "outcome", _text(row.outcome)
    yield "frames_scored", row.trial.frames_scored
    yield "frames_expected", row.trial.frames_expected
    for at, (column, cell) in enumerate(zip(one.table.columns, row.cells, strict=True)):
        name = f"{column.name} {column.stratum} {one.table.horizons_s[column.step]:g} s"
        yield name, cell.value
        if any(other.cells[at].interval for other in one.table.rows):
            low, high = cell.interval or (None, None)
            yield f"{name} low", low
            yield f"{name} high", high


def _text(text: str) -> str:
    text = printable(text)
    return f"'{text}" if text.lstrip().startswith(FORMULA) else text


def latex_text(text: str) -> str:
    """Text on one line, escaped so that TeX shows every character as it is."""
    return LIGATURE.sub(r"\1{}", "".join(SPECIAL.get(sign, sign) for sign in printable(text)))


def latex_tables(exported: Sequence[ExportedTable]) -> str:
    """A table environment for each; the best values are bold, intervals are small."""
    head = "% needs \\usepackage{booktabs} and \\usepackage[T1]{fontenc}; names with signs beyond Latin: lualatex\n"
    return head + "\n".join("\n".join(_lines(one.table)) + "\n" for one in exported)


def _lines(table: HeadlineTable) -> Iterator[str]:
    caption = f"{latex_text(table.recording)}{{}}: scores with 95\\,\\% confidence intervals"
    yield "\\begin{table}"
    yield "  \\centering"
    yield f"  \\caption{{{caption if table.has_intervals else caption.partition(' with')[0]}}}"
    yield f"  \\begin{{tabular}}{{l{'r' * len(table.columns)}}}"
    yield "    \\toprule"
    groups = (f"\\multicolumn{{{columns}}}{{c}}{{{latex_text(group)}}}" for group, columns in table.groups)
    yield f"    {' & '.join(['', *groups])} \\\\"
    yield f"    {' '.join(_rules(table))}"
    yield f"    {' & '.join(['tracker', *(latex_text(column.heading) for column in table.columns)])} \\\\"
    yield "    \\midrule"
    for above, row in pairwise([None, *table.rows]):
        if row is not None:
            if above is not None and above.group != row.group:
                yield "    \\midrule"
            yield f"    {' & '.join([_name(row), *map(_number, row.cells)])} \\\\"
    yield "    \\bottomrule"
    yield "  \\end{tabular}"
    yield "\\end{table}"


def _rules(table: HeadlineTable) -> Iterator[str]:
    first = 2
    for _, columns in table.groups:
        yield f"\\cmidrule(lr){{{first}-{first + columns - 1}}}"
        first += columns


def _name(row: TableRow) -> str:
    """The name in braces: at the start of a line a bracket or a star would be an argument of the line before."""
    name = row.name if row.group != "unranked" else f"{row.name} ({row.outcome})"
    return f"{{{latex_text(name)}}}"


def _number(cell: TableCell) -> str:
    text = "--" if cell.value is None else cell.text.replace("-", "$-$")
    number = f"\\textbf{{{text}}}" if cell.best else text
    return f"{number} {{\\scriptsize {cell.interval_text.replace('-', '$-$')}}}" if cell.interval else number


FORMATS: dict[str, Render] = {
    "markdown": lambda runs, exported, columns: pull_request_markdown(runs, _main(exported)),
    "latex": lambda runs, exported, columns: latex_tables(_main(exported)),
    "csv": lambda runs, exported, columns: csv_of_tables(exported),
    "junit": lambda runs, exported, columns: junit_of_tables(exported),
    "svg": lambda runs, exported, columns: print_figure(runs, _main(exported), "svg", columns),
    "pdf": lambda runs, exported, columns: print_figure(runs, _main(exported), "pdf", columns),
}


FORMAT_NAMES = (PAGE, *FORMATS)
