"""The table of the label budget: its columns, how its rows are read and appended, and its summary."""

from __future__ import annotations

import csv
import statistics
from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path

from studies.support.results_file import ResultTable

DRAWINGS = ("spread", "consecutive")
"""How the labelled scans are drawn."""
BUDGETS = (50, 100, 200, 400, 800)
"""Numbers of labelled scans."""
COLUMNS = {"visible now": (0, "visible"), "visible 1 s": (1, "visible"), "occluded now": (0, "occluded")}
"""What is scored: of the two scored steps, now and one second ahead, the first or second, and the cells' visibility."""


def read_rows(path: Path) -> list[dict[str, str]]:
    """The rows measured so far; none where the file does not exist."""
    if not path.exists():
        return []
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def append_row(path: Path, row: Mapping[str, object]) -> None:
    """Append one row to the table, and create the file with its header where it does not exist."""
    new = not path.exists()
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a", newline="") as file:
        writer = csv.DictWriter(file, list(row))
        if new:
            writer.writeheader()
        writer.writerow(row)


def budget_table(path: Path) -> ResultTable:
    """Mean over the draws and, in brackets, least and most, for each method, drawing and number of labelled scans."""
    rows = read_rows(path)
    methods = list(dict.fromkeys(row["method"] for row in rows))
    lines = []
    for drawing, method, budget in product(DRAWINGS, methods, BUDGETS):
        own = [row for row in rows if (row["drawing"], row["method"], int(row["scans"])) == (drawing, method, budget)]
        if own:
            texts = [_mean_and_range([float(row[column]) for row in own]) for column in COLUMNS]
            lines.append((drawing, method, str(budget), str(len(own)), *texts))
    columns = ("drawing", "method", "scans", "draws", *COLUMNS)
    return ResultTable(columns=columns, alignment=("---", "---", *["--:"] * (len(columns) - 2)), rows=tuple(lines))


def _mean_and_range(values: Sequence[float]) -> str:
    return f"{statistics.fmean(values):.3f} [{min(values):.3f}, {max(values):.3f}]"
