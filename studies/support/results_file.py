"""Results of a study or benchmark: its command line, tables and numbers as text, and the JSON file that pages read."""

from __future__ import annotations

import argparse
import json
import math
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from pydantic import BaseModel, ConfigDict

NONE = "–"
"""Stands for a score that is undefined, such as F1 if no cell of the stratum is occupied."""
MAY_BE_CHANCE = "°"
"""Follows a difference with a corrected p-value of 0.05 or more."""


class ResultTable(BaseModel):
    """A table as text: the header, the rows, and the alignment of the columns (Markdown's rule)."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    columns: tuple[str, ...]
    alignment: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def markdown(self) -> str:
        """The table in Markdown."""
        return "\n".join([_line(self.columns), f"|{'|'.join(self.alignment)}|", *map(_line, self.rows)])


def _line(cells: Sequence[str]) -> str:
    return "|" + "".join(f" {cell} |" if cell else " |" for cell in cells)


class ResultSection(BaseModel):
    """The results of one command."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    command: str
    version: str = ""
    """The last version with the command; empty: this one has it."""
    tables: dict[str, ResultTable] = {}
    values: dict[str, str] = {}

    def text(self) -> str:
        """Tables in Markdown, then a line for each value."""
        tables = [f"{name}\n{table.markdown()}" for name, table in self.tables.items()]
        return "\n\n".join([*tables, "\n".join(f"{name}: {value}" for name, value in self.values.items())]).strip()


def study_parser(documentation: str | None, results: str = "") -> argparse.ArgumentParser:
    """A parser that describes a module by the first line of its docstring; `--out` takes a file such as `results`."""
    parser = argparse.ArgumentParser(description=(documentation or "").partition("\n")[0])
    if results:
        parser.add_argument("--out", type=Path, help=f"results file to write, such as {results}; default: none")
    return parser


def fill_pages(
    documentation: str | None, arguments: Sequence[str] | None, pages: Mapping[Path, Callable[[str], str]]
) -> None:
    """The command of a module that fills `pages`, each by a function of its text; with --check it writes none."""
    parser = study_parser(documentation)
    parser.add_argument("--check", action="store_true", help="write nothing; exit with 1 if a page differs")
    check = parser.parse_args(arguments).check
    texts = {page: (page.read_text("utf-8"), filled) for page, filled in pages.items()}
    stale = {page: new for page, (text, filled) in texts.items() if (new := filled(text)) != text}
    for page, text in () if check else stale.items():
        page.write_text(text, "utf-8")
    print(f"{'differ' if check else 'written'}: {', '.join(page.name for page in stale) or 'none'}")
    if check and stale:
        sys.exit(1)


def read_sections(path: Path) -> dict[str, ResultSection]:
    """The sections of a results file by their names. Raises OSError or pydantic's ValidationError."""
    return {name: ResultSection.model_validate(value) for name, value in json.loads(path.read_text("utf-8")).items()}


def write_section(path: Path | None, name: str, section: ResultSection) -> None:
    """Write one section of a results file and keep its other sections; without a path nothing is written."""
    if path is None:
        return
    sections = read_sections(path) if path.exists() else {}
    texts = {key: value.model_dump(mode="json") for key, value in {**sections, name: section}.items()}
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(texts, indent=1, ensure_ascii=False) + "\n", "utf-8")


def write_table(
    path: Path | None, section: str, table: ResultTable, command: str, values: Mapping[str, str] | None = None
) -> None:
    """Write one table, and values by their names, as a section of a results file; without a path nothing is written."""
    write_section(path, section, ResultSection(command=command, tables={"table": table}, values=dict(values or {})))


def measured_table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> ResultTable:
    """A table with its first column aligned left and the others right."""
    return ResultTable(
        columns=tuple(columns),
        alignment=("---", *["--:"] * (len(columns) - 1)),
        rows=tuple(tuple(row) for row in rows),
    )


def score_text(value: float, low: float | None = None, high: float | None = None, *, signed: bool = False) -> str:
    """A score or difference: `0.693 [.670, .713]`, `-0.012 [-.020, -.004]`; no interval if that is None or NaN."""
    shown = "+.3f" if signed else ".3f"
    text = format(value, shown)
    if low is None or high is None or math.isnan(low):
        return text
    ends = (re.sub(r"^([+-]?)0\.", r"\1.", format(end, shown)) for end in (low, high))
    return f"{text} [{', '.join(ends)}]"


def chance_marked(text: str, may_be_chance: bool) -> str:
    """The text of a difference, marked with MAY_BE_CHANCE if it may be chance."""
    return f"{text} {MAY_BE_CHANCE}" if may_be_chance else text
