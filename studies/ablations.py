"""How much each part of the dilated ConvGRU contributes: it is trained without each of them, and all are compared.

`python -m studies.ablations` trains by the recipes in studies/recipes/ablations, 625 updates each, half an hour on two
quiet cores, and compares the networks with each other and with persistence in runs/ablations. Complete trainings are
kept.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path

from gridtrack.evaluation.runs.recipe import read_recipe
from gridtrack.trackers.weights import read_card

from studies.support.comparison import compare_at_junction, train
from studies.support.results_file import ResultSection, write_section
from studies.support.run_scores import SHOWN, RunScores

RECIPES = Path("studies/recipes/ablations")
REFERENCE = "whole"
FLOOR = "persistence"
OUT = Path("runs/ablations")
RESULTS = Path("docs/results/junction/ablations.json")
COMMAND = "make ablations"
DIFFERENCES = (*SHOWN[:5], "f1 visible 0.5 s", "f1 visible 2.5 s", "nll visible 1 s")


def trained() -> Mapping[str, Path]:
    """The card of each recipe's training, the whole network's first; it is made where it is missing."""
    cards = {}
    for path in sorted(RECIPES.glob("*.toml"), key=lambda path: (path.stem != REFERENCE, path.stem)):
        recipe = read_recipe(path)
        assert recipe.out is not None, path
        cards[path.stem] = recipe.out / recipe.tracker / "junction.toml"
        train(cards[path.stem], "--recipe", path)
    return cards


def section(scores: RunScores, cards: Mapping[str, Path]) -> ResultSection:
    """F1 of the networks, what each has less the whole one, and each number of these tables by its row and column."""
    without = [f"{part} less {REFERENCE}" for part in cards if part != REFERENCE]
    tables = {
        "F1": scores.table("F1", [*cards, FLOOR], SHOWN, ["intervals"]),
        "differences": scores.table("F1", without, DIFFERENCES, ["intervals", "p"]),
    }
    values = {f"{part}: {column}": scores.value(part, column) for part in (*cards, FLOOR) for column in SHOWN}
    values |= {f"{part}: {column}": scores.value(part, column) for part in without for column in DIFFERENCES}
    values |= {f"{part}: validation score": f"{_validation_score(card):.3f}" for part, card in cards.items()}
    return ResultSection(command=COMMAND, tables=tables, values=values)


def _validation_score(card: Path) -> float:
    """The best score of a training on the validation stretch: what it chose the update by."""
    return float(read_card(card).results["score"])


def main() -> None:
    argparse.ArgumentParser(description=__doc__.partition("\n")[0]).parse_args()
    cards = trained()
    rows = [FLOOR, *(f"{part}={card.parent.name}:weights={card.parents[1]}" for part, card in cards.items())]
    compare_at_junction(rows, REFERENCE, OUT, "--every", "2s")
    write_section(RESULTS, "ablations", section(RunScores(OUT / "summary.json"), cards))


if __name__ == "__main__":
    main()
