"""Results of a study as a small JSON file, from which the pages in docs take their numbers."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from pydantic import BaseModel, ConfigDict


class ResultTable(BaseModel):
    """A table as it is printed: texts of the header, of each row, and how columns are aligned (Markdown's rule)."""

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
    """What one command measured."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    command: str
    tables: dict[str, ResultTable] = {}
    values: dict[str, str] = {}


def read_sections(path: Path) -> dict[str, ResultSection]:
    """The sections of a results file by their names. Raises OSError or pydantic's ValidationError."""
    return {name: ResultSection.model_validate(value) for name, value in json.loads(path.read_text("utf-8")).items()}


def write_section(path: Path, name: str, section: ResultSection) -> None:
    """Write one section of a results file, with the other sections kept."""
    sections = read_sections(path) if path.exists() else {}
    texts = {key: value.model_dump(mode="json") for key, value in {**sections, name: section}.items()}
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(texts, indent=1, ensure_ascii=False) + "\n", "utf-8")


def measured_table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> ResultTable:
    """A table with its first column left and the others right."""
    return ResultTable(
        columns=tuple(columns),
        alignment=("---", *["--:"] * (len(columns) - 1)),
        rows=tuple(tuple(row) for row in rows),
    )


def write_table(
    path: Path | None, section: str, table: ResultTable, command: str, values: Mapping[str, str] | None = None
) -> None:
    """Write a measured table, and values by their names, as one section of a results file; nothing without a path."""
    if path is not None:
        measured = ResultSection(command=command, tables={"table": table}, values=dict(values or {}))
        write_section(path, section, measured)
