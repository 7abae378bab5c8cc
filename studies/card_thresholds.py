"""Thresholds of the shipped cards, chosen again after a change of the scored cells.

`python -m studies.card_thresholds [TRACKER/SITE...]` (half an hour; default: every card with thresholds) chooses them
as `gridtrack train` does at its end: on the validation stretches of the recipe that writes the card.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from gridtrack.evaluation.runs.card_thresholds import choose_card_thresholds
from gridtrack.evaluation.runs.fit_regions import cell_kinds_for
from gridtrack.evaluation.runs.recipe import Recipe, read_recipe
from gridtrack.recordings import recordings_at
from gridtrack.recordings.stream import GridStream, open_stream
from gridtrack.trackers.training.progress import Progress
from gridtrack.trackers.training.weights import add_thresholds, read_card

from studies.support.results_file import study_parser
from studies.support.shipped import WEIGHTS

RECIPES = Path("studies/recipes/weights")


def recipe_of(card: str) -> Recipe:
    """The last recipe that writes the card TRACKER/SITE. Raises ValueError without one."""
    found = sorted(RECIPES.glob(f"{card.replace('/', '-')}*.toml"))
    if not found:
        raise ValueError(f"{card}: no recipe in {RECIPES}")
    return read_recipe(found[-1])


def validation_of(recipe: Recipe) -> Iterator[tuple[GridStream, list[GridStream]]]:
    """Each validation stretch of a recipe, with the stretches of its recording that the training knows."""
    for text in recipe.validation:
        path, _, stretch = text.partition("@")
        for found in recordings_at(Path(path), None):
            stream = open_stream(f"{found}@{stretch}" if stretch else str(found))
            yield stream, [stream]
    for path in recipe.recordings if not recipe.validation else ():
        stream = open_stream(f"{path}@validation")
        yield stream, [open_stream(f"{path}@train"), stream]


def main(arguments: Sequence[str] | None = None) -> None:
    parser = study_parser(__doc__)
    parser.add_argument("cards", nargs="*", metavar="TRACKER/SITE")
    given = parser.parse_args(arguments).cards
    known = {f"{path.parent.name}/{path.stem}": path for path in sorted(WEIGHTS.glob("*/*.toml"))}
    for name in given or [name for name, path in known.items() if read_card(path).thresholds]:
        streams = [(stream, cell_kinds_for(stream, beside)) for stream, beside in validation_of(recipe_of(name))]
        thresholds = choose_card_thresholds(name.partition("/")[0], known[name], streams, Progress())
        changed = thresholds is not None and thresholds != read_card(known[name]).thresholds
        if thresholds is not None and changed:
            add_thresholds(known[name], thresholds)
        print(f"{name}: {'other thresholds' if changed else 'unchanged'}, of {len(streams)} stretches", flush=True)


if __name__ == "__main__":
    main()
