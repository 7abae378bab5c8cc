"""Tables for LaTeX with the package booktabs, in which no name has a meaning for TeX."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from itertools import pairwise

from gridtrack.common.errors import printable
from gridtrack.reports.chosen_scores import ExportedTable
from gridtrack.reports.table import HeadlineTable, TableCell, TableRow

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
"""Two of them in a row are another sign: a dash, a quotation mark."""


def latex_text(text: str) -> str:
    """Text on one line in which no character has a meaning for TeX, and none becomes another."""
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
    yield f"    {' & '.join(['', *_group_headings(table)])} \\\\"
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


def _group_headings(table: HeadlineTable) -> Iterator[str]:
    for group, columns in table.groups:
        yield f"\\multicolumn{{{columns}}}{{c}}{{{latex_text(group)}}}"


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
