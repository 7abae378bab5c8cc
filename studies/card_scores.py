"""The scores on the cards of the junction's searches: each searched tracker with each seed.

`python -m studies.card_scores --out docs/results/trackers/card-scores.json` (a second) reads the weights that ship and
those in studies/trainings. Thresholds are the best of the stretch itself, so that the scores compare searches of one
tracker, and are no scores of a test.
"""

from __future__ import annotations

import argparse
import statistics
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from gridtrack.trackers.training.card import Card
from gridtrack.trackers.training.weights import read_card

from studies.support.results_file import ResultTable, measured_table, write_table
from studies.support.shipped import WEIGHTS

COMMAND = "python -m studies.card_scores"
SEARCHED = "kalman", "factor-graph", "dogma"
FURTHER = Path("studies/trainings")
HORIZONS = "0.5s", "1s", "2s"
HEADER = "mean F1", "dynamic 0.5 s", "dynamic 1 s", "dynamic 2 s"

F1 = Mapping[str, Mapping[str, float]]
"""F1 by stratum and horizon."""


def cards_of(tracker: str) -> Iterator[Card]:
    """The cards of the junction's searches of one tracker, by their seed."""
    folders = [WEIGHTS, *sorted(FURTHER.glob("seed-*"))]
    paths = (folder / tracker / "junction.toml" for folder in folders)
    yield from sorted((read_card(path) for path in paths if path.exists()), key=lambda card: card.seed)


def searched_f1(card: Card, use: str) -> F1:
    """Mean F1 over the stretches of `use` (`train`: the excerpts of the search, `validation`)."""
    stretches: list[dict[str, Any]] = card.results[use]
    return {
        name: {at: statistics.fmean(one[f"{name}_f1"][at] for one in stretches) for at in HORIZONS}
        for name in ("dynamic", "visible")
    }


def cells(f1: F1) -> list[str]:
    """The cells of HEADER: the mean over strata and horizons is what a search maximises."""
    mean = statistics.fmean(value for by_horizon in f1.values() for value in by_horizon.values())
    return [f"{value:.3f}" for value in (mean, *f1["dynamic"].values())]


def searched_table(tracker: str) -> ResultTable:
    """The searches of one tracker, a row each: mean F1 on the excerpts, and all of HEADER on validation."""
    rows = [
        [f"seed {card.seed}", cells(searched_f1(card, "train"))[0], *cells(searched_f1(card, "validation"))]
        for card in cards_of(tracker)
    ]
    return measured_table((tracker, "mean F1 on the excerpts", *(f"validation: {HEADER[0]}", *HEADER[1:])), rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, help="results file for the tables")
    arguments = parser.parse_args()
    for name in SEARCHED:
        table = searched_table(name)
        print(table.markdown(), end="\n\n")
        write_table(arguments.out, name, table, COMMAND)


if __name__ == "__main__":
    main()
