"""The table of the label budget: its columns, and how its rows are read and appended."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path

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
