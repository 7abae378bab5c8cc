"""How much each part of the dilated ConvGRU contributes: it is trained without each of them, and all are compared.

`python -m studies.ablations` trains by the recipes in studies/recipes/ablations, 625 updates each, half an hour on a
quiet core, and compares the networks with each other and with persistence in runs/ablations.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from gridtrack.evaluation.comparison.recipe import read_recipe
from gridtrack.evaluation.comparison.train import train_tracker

from studies.support.comparison import compare_at_junction

RECIPES = Path("studies/recipes/ablations")
REFERENCE = "whole"
OUT = Path("runs/ablations")


def main() -> None:
    argparse.ArgumentParser(description=__doc__.partition("\n")[0]).parse_args()
    rows = ["persistence"]
    for path in sorted(RECIPES.glob("*.toml"), key=lambda path: (path.stem != REFERENCE, path.stem)):
        recipe = read_recipe(path)
        train_tracker(recipe)
        rows.append(f"{path.stem}={recipe.tracker}:weights={recipe.out}")
    compare_at_junction(rows, REFERENCE, OUT, "--every", "2s")


if __name__ == "__main__":
    main()
