"""Variants of one tracker, compared at the junction: the dilated ConvGRU without its parts, `kalman` without a map.

`python -m studies.variants ablations` trains by the recipes in studies/recipes/ablations, 625 updates each (half an
hour on two idle cores), and compares the networks with each other and with persistence. Complete trainings are kept.

`python -m studies.variants returns` (ten minutes) compares `kalman` with the map of the site, without it, and with the
laser's own returns in place of the centres of cells.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from gridtrack.evaluation.runs.recipe import read_recipe

from studies.kept_summary import SHOWN, RunScores
from studies.support.comparison import compare_at_junction, train
from studies.support.results_file import ResultSection, study_parser, write_section

RECIPES = Path("studies/recipes/ablations")
WHOLE, FLOOR = "whole", "persistence"
ABLATIONS, OF_ABLATIONS = Path("docs/results/junction/ablations.json"), Path("runs/ablations")
ABLATED_COLUMNS = (*SHOWN[:5], "f1 visible 0.5 s", "f1 visible 2.5 s", "log_loss visible 1 s")
"""The columns of differences from the whole network."""

KALMAN = {
    "kalman": "kalman",
    "cold": "cold=kalman:background=none",
    "raw": "raw=kalman:points=raw,link_m=0.264,surface_noise_m=0.08,return_noise_m=0.03",
}
"""The settings of the last row were found by a search (docs/trackers/model-free.md)."""
RETURNS, OF_RETURNS = Path("docs/results/trackers/model-free.json"), Path("runs/returns")
RETURNS_COLUMNS = (*SHOWN, "f1 occluded over 4 s 1 s")
MAP_COLUMNS = (*SHOWN[:5], "f1 visible 1 s")
"""The columns of differences without a map; rows with other points are not compared in pairs."""


def trained() -> Mapping[str, Path]:
    """The card of each recipe, the whole network's first; a missing one is trained."""
    cards = {}
    for path in sorted(RECIPES.glob("*.toml"), key=lambda path: (path.stem != WHOLE, path.stem)):
        recipe = read_recipe(path)
        assert recipe.out is not None, path
        cards[path.stem] = recipe.out / recipe.tracker / "junction.toml"
        train(cards[path.stem], "--recipe", path)
    return cards


def ablations_section(scores: RunScores, cards: Iterable[str]) -> ResultSection:
    """F1 of the networks, and their differences from the whole one."""
    without = [f"{part} less {WHOLE}" for part in cards if part != WHOLE]
    tables = {
        "F1": scores.table("F1", [*cards, FLOOR], SHOWN, ["intervals"]),
        "differences": scores.table("F1", without, ABLATED_COLUMNS, ["intervals", "p"]),
    }
    return ResultSection(command="make ablations", tables=tables)


def returns_section(scores: RunScores) -> ResultSection:
    """Scores of `kalman` with a map, without it, and with returns; the difference without a map."""
    without = ["cold less kalman"]
    tables = {
        "table": scores.table("F1", list(KALMAN), RETURNS_COLUMNS, ["intervals"]),
        "differences": scores.table("F1", without, MAP_COLUMNS, ["intervals", "p"]),
    }
    return ResultSection(command="make returns", tables=tables)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = study_parser(__doc__)
    parser.add_argument("variants", choices=("ablations", "returns"))
    if parser.parse_args(arguments).variants == "ablations":
        cards = trained()
        rows = [FLOOR, *(f"{part}={card.parent.name}:weights={card.parents[1]}" for part, card in cards.items())]
        compare_at_junction(rows, WHOLE, OF_ABLATIONS, "--every", "2s")
        write_section(ABLATIONS, "ablations", ablations_section(RunScores(OF_ABLATIONS / "summary.json"), cards))
    else:
        compare_at_junction(KALMAN.values(), "kalman", OF_RETURNS)
        write_section(RETURNS, "map and returns", returns_section(RunScores(OF_RETURNS / "summary.json")))


if __name__ == "__main__":
    main()
