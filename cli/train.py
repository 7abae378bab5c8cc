"""`train`: train a tracker by a recipe, which options override."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from gridtrack.cli.completion import complete_selection
from gridtrack.cli.options import settings_options
from gridtrack.common.errors import INTERRUPTED_EXIT_CODE, ConfigurationError, printable
from gridtrack.evaluation.runs.recipe import Recipe, complete_recipe, read_recipe, recipe_like
from gridtrack.trackers import registry
from gridtrack.trackers.selection import Selection, parse_selection

app = typer.Typer(add_completion=False)


@app.command()
@settings_options(Recipe, "tracker", "options", "recordings")
def train_command(
    values: dict[str, Any],
    arguments: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[NAME[:OPTIONS]] RECORDING[@RANGE]",
            help="A tracker, with options KEY=VALUE,..., and recordings to train it on, or folders of them; may be left"
            " out with --recipe or --like",
            show_default=False,
            autocompletion=complete_selection,
        ),
    ] = None,
    recipe: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="TOML file with the settings of a training; other options override it"),
    ] = None,
    like: Annotated[
        Path | None, typer.Option(metavar="CARD", help="Train with the tracker, settings and seed of this card")
    ] = None,
) -> None:
    """Train a tracker for a site or, with --general, for any site.

    The card of the weights has the command that repeats the training.
    """
    from gridtrack.evaluation.runs.train import train_tracker

    if values.get("weights") and values.get("from_scratch"):
        raise ConfigurationError("--weights and --from-scratch: give one of them")
    if values.get("weights") or values.get("from_scratch"):
        values = {"weights": None, "from_scratch": False, **values}
    given = _tracker_and_recordings(arguments or [], named_elsewhere=bool(recipe or like)) | values
    try:
        card = train_tracker(complete_recipe(_base_recipe(recipe, like), given), _print_line)
    except KeyboardInterrupt as stopped:
        typer.echo(f"gridtrack: {printable(str(stopped)) or 'interrupted before the training began'}", err=True)
        raise typer.Exit(INTERRUPTED_EXIT_CODE) from None
    typer.echo(f"weights: {card}")


def _print_line(text: str) -> None:
    typer.echo(printable(text))


def _tracker_and_recordings(arguments: list[str], *, named_elsewhere: bool) -> dict[str, Any]:
    """The fields of a recipe that the arguments of `train` give.

    The first argument is a tracker; if the tracker may be `named_elsewhere`, only if a tracker of this name exists.
    """
    given: dict[str, Any] = {}
    known = bool(arguments) and arguments[0].partition(":")[0] in registry.entries()
    if arguments and (known or not named_elsewhere):
        if not known and ("/" in arguments[0].partition(":")[0] or Path(arguments[0].partition("@")[0]).exists()):
            raise ConfigurationError(f"name the tracker before the recordings: gridtrack train NAME {arguments[0]}")
        chosen = tracker_alone(arguments[0])
        given = {"tracker": chosen.name, "options": chosen.options}
        arguments = arguments[1:]
    return {**given, "recordings": arguments} if arguments else given


def _base_recipe(recipe: Path | None, like: Path | None) -> Recipe:
    """The recipe that the command line overrides. Raises ConfigurationError for two."""
    if recipe and like:
        raise ConfigurationError("--recipe and --like: give one of them")
    if recipe:
        return read_recipe(recipe)
    return recipe_like(like) if like else Recipe()


def tracker_alone(text: str) -> Selection:
    """NAME[:KEY=VALUE,...] without `points` and `weights`, which only a tracker of a comparison has.

    Raises ConfigurationError.
    """
    chosen = parse_selection(text)
    if chosen.points != "centres" or chosen.weights is not None:
        raise ConfigurationError(f"tracker '{text}': points= and weights= are for rows of a comparison")
    return chosen
