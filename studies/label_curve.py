"""Label budget: the table that `studies/label_budget.py` measures, its summary and its curves.

`python -m studies.label_curve [TABLE]` (a second) draws the curves beside the table and writes the summary of
docs/results/trackers/one-shot.json.
"""

from __future__ import annotations

import csv
import statistics
from collections import defaultdict
from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import NamedTuple

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from studies.support.drawings import COLOURS, SETTINGS, write_svg
from studies.support.results_file import ResultSection, ResultTable, study_parser, write_section

TABLE = Path("docs/results/junction/label-budget.csv")
RESULTS = Path("docs/results/trackers/one-shot.json")
BUDGETS = (50, 100, 200, 400, 800)
"""Numbers of labelled scans."""
DASHES = {"spread": "-", "consecutive": "--"}
"""How the labelled scans are drawn, and the line of each way."""
COLUMNS = {"visible now": (0, "visible"), "visible 1 s": (1, "visible"), "occluded now": (0, "occluded")}
"""The scores of a row: of the two scored steps, now and one second ahead, the first or second, and the visibility."""


class Losses(NamedTuple):
    """The losses of the draws of one number of labelled scans, nats per scan."""

    mean: float
    least: float
    most: float
    draws: int


Curves = dict[tuple[str, str], dict[int, Losses]]
"""By drawing and method, then by number of labelled scans."""


def read_rows(path: Path) -> list[dict[str, str]]:
    """The rows measured so far; none if the file does not exist."""
    if not path.exists():
        return []
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def append_row(path: Path, row: Mapping[str, object]) -> None:
    """Append one row to the table; a new file begins with its header."""
    new = not path.exists()
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a", newline="") as file:
        writer = csv.DictWriter(file, list(row))
        if new:
            writer.writeheader()
        writer.writerow(row)


def curves(rows: Sequence[Mapping[str, str]], column: str) -> Curves:
    """One column of the table as curves."""
    values: dict[tuple[str, str], dict[int, list[float]]] = defaultdict(lambda: defaultdict(list))
    for row in rows:
        values[row["drawing"], row["method"]][int(row["scans"])].append(float(row[column]))
    return {
        line: {scans: Losses(statistics.fmean(own), min(own), max(own), len(own)) for scans, own in of_scans.items()}
        for line, of_scans in values.items()
    }


def summary(rows: Sequence[Mapping[str, str]]) -> ResultSection:
    """Mean and range over the draws as a table, and each mean as a value."""
    of_columns = {column: curves(rows, column) for column in COLUMNS}
    measured = of_columns[next(iter(COLUMNS))]
    methods = dict.fromkeys(row["method"] for row in rows)
    lines: list[tuple[str, ...]] = []
    values: dict[str, str] = {}
    for drawing, method, scans in product(DASHES, methods, BUDGETS):
        if scans in measured.get((drawing, method), {}):
            losses = {column: found[drawing, method][scans] for column, found in of_columns.items()}
            texts = [f"{one.mean:.3f} [{one.least:.3f}, {one.most:.3f}]" for one in losses.values()]
            lines.append((drawing, method, str(scans), str(measured[drawing, method][scans].draws), *texts))
            values |= {f"{drawing}, {method}, {scans}, {name}": f"{one.mean:.2f}" for name, one in losses.items()}
    columns = ("drawing", "method", "scans", "draws", *COLUMNS)
    table = ResultTable(columns=columns, alignment=("---", "---", *["--:"] * (len(columns) - 2)), rows=tuple(lines))
    return ResultSection(command="python -m studies.label_curve", tables={"table": table}, values=values)


def draw(rows: Sequence[Mapping[str, str]], path: Path) -> None:
    """Draw the mean and the range over the draws of each method, a panel for each column."""
    colours = dict(zip(sorted({row["method"] for row in rows}), COLOURS, strict=False))
    with matplotlib.rc_context(SETTINGS):
        figure = Figure((9.0, 3.2), layout="constrained")
        panels = figure.subplots(1, len(COLUMNS), sharey=True)
        for axes, column in zip(panels, COLUMNS, strict=True):
            draw_panel(axes, curves(rows, column), colours)
            axes.set(title=column, xlabel="labelled scans (dashed: consecutive)")
        panels[0].set_ylabel("log loss, nats per scan")
        keys = [panels[0].plot([], [], color=colour)[0] for colour in colours.values()]
        figure.legend(keys, list(colours), loc="outside lower center", ncols=len(colours))
        write_svg(figure, path)


def draw_panel(axes: Axes, lines: Curves, colours: Mapping[str, str]) -> None:
    """Draw the curves of one column."""
    for (drawing, method), points in lines.items():
        scans = sorted(points)
        axes.plot(scans, [points[n].mean for n in scans], DASHES[drawing], color=colours[method])
        ends = [points[n].least for n in scans], [points[n].most for n in scans]
        axes.fill_between(scans, *ends, color=colours[method], alpha=0.13, linewidth=0)
    axes.set(xscale="log", yscale="log", ylim=(0.08, 2.2))
    axes.set_xticks(BUDGETS, [str(n) for n in BUDGETS])
    axes.set_yticks((0.1, 0.2, 0.5, 1.0, 2.0), ("0.1", "0.2", "0.5", "1", "2"))
    axes.minorticks_off()
    axes.grid(axis="y", color="#ddd")


def main(arguments: Sequence[str] | None = None) -> None:
    parser = study_parser(__doc__)
    parser.add_argument("table", type=Path, nargs="?", default=TABLE)
    parser.add_argument("--out", type=Path, default=RESULTS, help=f"results file, default: {RESULTS}")
    given = parser.parse_args(arguments)
    rows = read_rows(given.table)
    draw(rows, given.table.with_suffix(".svg"))
    write_section(given.out, "how many labels", summary(rows))


if __name__ == "__main__":
    main()
