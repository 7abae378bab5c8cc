"""What a map of the site and the cells' centres change for `kalman`: without the map, and with the laser's returns.

`python -m studies.map_and_returns` (ten minutes) runs studies/recipes/map-and-returns.toml in runs/returns.
"""

from __future__ import annotations

import argparse
import tomllib
from pathlib import Path

from studies.support.comparison import compare_at_junction
from studies.support.results_file import ResultSection, write_section
from studies.support.run_scores import SHOWN, RunScores

RECIPE = Path("studies/recipes/map-and-returns.toml")
RESULTS = Path("docs/results/trackers/model-free.json")
COMMAND = "make returns"
SCORES = (*SHOWN, "f1 occluded over 4 s 1 s")
PAIRED = (*SCORES[:5], "f1 visible 1 s")
"""Scores whose differences to the reference are tested; rows with other points are not compared in pairs."""


def section(scores: RunScores, reference: str) -> ResultSection:
    """Scores of the three rows, and what kalman without a map has less kalman with one."""
    rows, without = (reference, "cold", "raw"), f"cold less {reference}"
    tables = {
        "table": scores.table("F1", rows, SCORES, ["intervals"]),
        "differences": scores.table("F1", [without], PAIRED, ["intervals", "p"]),
    }
    values = {f"{row}: {column}": scores.value(row, column) for row in rows for column in SCORES}
    values |= {f"{without}: {column}": scores.value(without, column) for column in PAIRED}
    return ResultSection(command=COMMAND, tables=tables, values=values)


def main() -> None:
    argparse.ArgumentParser(description=__doc__.partition("\n")[0]).parse_args()
    recipe = tomllib.loads(RECIPE.read_text())
    reference, out = recipe["reference"], Path(recipe["out"])
    compare_at_junction(recipe["trackers"], reference, out)
    write_section(RESULTS, "map and returns", section(RunScores(out / "summary.json"), reference))


if __name__ == "__main__":
    main()
