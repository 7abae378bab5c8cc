"""`train` and `trackers list | show | check | new | migrate`: the registered trackers and their learned weights."""

from __future__ import annotations

import json
import shlex
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from gridtrack.cli.completion import complete_selection, complete_tracker
from gridtrack.cli.options import (
    GridOption,
    JsonOption,
    RateOption,
    SandboxOption,
    TrackersTomlOption,
    WeightsOption,
    default_of,
    with_defaults,
)
from gridtrack.common.errors import INTERRUPTED_EXIT_CODE, ConfigurationError, GridtrackError, PluginError, printable

app = typer.Typer(
    no_args_is_help=True, help="The trackers: list, show, check, new; migrate: rewrite older weights cards."
)


NameArgument = Annotated[str, typer.Argument(autocompletion=complete_tracker)]


def train_command(
    arguments: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[NAME[:KEY=VALUE,...]] RECORDING[@RANGE]...",
            help="A tracker and recordings to train it on, or folders of them; may be left out with --recipe or --like",
            show_default=False,
            autocompletion=complete_selection,
        ),
    ] = None,
    recipe: Annotated[
        Path | None, typer.Option(help="TOML file with the settings of a training; other options override it")
    ] = None,
    like: Annotated[
        Path | None, typer.Option(metavar="CARD", help="Train with the tracker, settings and seed of this card")
    ] = None,
    validation: Annotated[
        list[str] | None,
        typer.Option(help=r"RECORDING\[@RANGE]; default: the recording's own validation stretch"),
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Folder of weights; default: your own")] = None,
    seed: Annotated[int | None, typer.Option(help="Without it, the seed of the recipe or the card")] = None,
    grid: GridOption = None,
    rate: RateOption = None,
    general: Annotated[
        bool, typer.Option("--general", help="Learn for any place, from recordings of many places")
    ] = False,
    weights: Annotated[
        str | None,
        typer.Option(
            metavar="FOLDER",
            help="Folder of general weights to start from, or its URL, searched before your own and the shipped ones",
        ),
    ] = None,
    from_scratch: Annotated[bool, typer.Option("--from-scratch", help="Do not start from general weights")] = False,
) -> None:
    """Train a tracker for a site or, with --general, for any: a card with the command that repeats the training."""
    from gridtrack.evaluation.runs.recipe import complete_recipe
    from gridtrack.evaluation.runs.train import train_tracker

    given = {
        **_tracker_and_recordings(arguments or [], named_elsewhere=bool(recipe or like)),
        "validation": validation,
        "out": out,
        "seed": seed,
        "grid": grid,
        "rate_hz": rate,
        "general": general or None,
    }
    overrides = {key: value for key, value in given.items() if value is not None} | _start_given(weights, from_scratch)
    try:
        card = train_tracker(complete_recipe(_base_recipe(recipe, like), overrides), _print_line)
    except KeyboardInterrupt as stopped:
        typer.echo(f"gridtrack: {printable(str(stopped)) or 'interrupted before the training began'}", err=True)
        raise typer.Exit(INTERRUPTED_EXIT_CODE) from None
    typer.echo(f"weights: {card}")


def _print_line(text: str) -> None:
    typer.echo(printable(text))


def train_defaults() -> dict[str, str]:
    """The default of each option of `train`, as text."""
    from gridtrack.evaluation.runs.recipe import Recipe

    return {"seed": str(default_of(Recipe, "seed"))}


def _start_given(weights: str | None, from_scratch: bool) -> dict[str, Any]:
    """The fields of a recipe that say what it starts from, both where either is given. Raises ConfigurationError."""
    if weights and from_scratch:
        raise ConfigurationError("--weights and --from-scratch: give one of them")
    return {"weights": weights, "from_scratch": from_scratch} if weights or from_scratch else {}


def _tracker_and_recordings(arguments: list[str], *, named_elsewhere: bool) -> dict[str, Any]:
    """The fields of a recipe that the arguments of `train` give.

    The first argument is a tracker; where the tracker may be `named_elsewhere`, only if a tracker of this name exists.
    """
    from gridtrack.trackers import registry

    given: dict[str, Any] = {}
    if arguments and not (named_elsewhere and arguments[0].partition(":")[0] not in registry.entries()):
        chosen = _tracker_alone(arguments[0])
        given = {"tracker": chosen.name, "options": chosen.options}
        arguments = arguments[1:]
    return {**given, "recordings": arguments} if arguments else given


def _base_recipe(recipe: Path | None, like: Path | None) -> Any:
    """The recipe that the command line overrides. Raises ConfigurationError where both are given."""
    from gridtrack.evaluation.runs.recipe import Recipe, read_recipe, recipe_like

    if recipe and like:
        raise ConfigurationError("--recipe and --like: give one of them")
    if recipe:
        return read_recipe(recipe)
    return recipe_like(like) if like else Recipe()


@app.command("list")
def list_trackers(
    weights: WeightsOption = None, trackers_toml: TrackersTomlOption = None, as_json: JsonOption = False
) -> None:
    """List the trackers: ready, untrained (no weights for any site), or unavailable with the reason.

    Each is described by its own process.
    """
    from concurrent.futures import ThreadPoolExecutor

    from gridtrack.reports.terminal import print_rows
    from gridtrack.trackers import registry
    from gridtrack.trackers.selection import read_trackers_toml

    external = read_trackers_toml(trackers_toml) if trackers_toml else {}
    origins = {name: entry.distribution for name, entry in registry.entries().items()}
    origins |= dict.fromkeys(external, str(trackers_toml))
    with ThreadPoolExecutor() as pool:
        rows = list(pool.map(lambda name: _listed(name, origins[name], external, weights), origins))
    typer.echo(json.dumps(rows, indent=1)) if as_json else print_rows(rows)


def _listed(name: str, origin: str, external: Any, weights: Path | None) -> dict[str, str]:
    """The row of one tracker; `sites` are those that it has weights for, "" for one that needs none."""
    from gridtrack.evaluation.runs.learned import sites_with_weights
    from gridtrack.trackers import registry

    row = {"name": name, "from": origin}
    try:
        described = _describe(name, external)
        sites = sites_with_weights(name, weights) if described.learns else ()
    except GridtrackError as error:
        problem = "" if name in external else registry.entries()[name].problem
        return {**row, "state": "unavailable", "sites": "", "about": problem or str(error)}
    state = "untrained" if described.learns and not sites else "ready"
    return {**row, "state": state, "sites": ", ".join(sites), "about": _first_line(described.about)}


def _first_line(text: str) -> str:
    return text.partition("\n")[0]


def _describe(name: str, external: Any = None) -> Any:
    from gridtrack.evaluation.hosting.limits import Limits
    from gridtrack.evaluation.hosting.tracker_process import describe
    from gridtrack.trackers.selection import launch

    return describe(launch(name, external), {}, Limits())


@app.command("show")
def show_tracker(name: NameArgument, as_json: JsonOption = False) -> None:
    """Show the description, the role and the options of a tracker, with their defaults."""
    from gridtrack.reports.terminal import print_rows
    from gridtrack.trackers import registry

    entry, described = registry.find(name), _describe(name)
    about = {
        "name": name,
        "about": _first_line(described.about),
        "from": f"{entry.value} of {entry.distribution}",
        "role": described.role,
        "learns": described.learns,
        "moving_sensor": described.moving_sensor,
    }
    schema = described.options_schema.get("properties", {})
    options = [
        {
            "option": key,
            "default": json.dumps(value),
            "about": " ".join(schema.get(key, {}).get("description", "").split()),
        }
        for key, value in described.options.items()
    ]
    if as_json:
        typer.echo(json.dumps({**about, "options": options}, indent=1))
        return
    for key, value in about.items():
        typer.echo(printable(f"{key}: {value}"))
    print_rows(options)


def check_defaults() -> dict[str, str]:
    """The stream of `check` without a recording, as text."""
    stream = _stream(None)
    return {"recording": f"none, {stream.grid} at {1 / stream.period_s:g} Hz"}


@app.command("check", cls=with_defaults(check_defaults))
def check_command(
    tracker: Annotated[str, typer.Argument(metavar="NAME[:KEY=VALUE,...]", autocompletion=complete_selection)],
    recording: Annotated[str | None, typer.Option(help="Check with the grid, rate and site of this recording")] = None,
    weights: WeightsOption = None,
    trackers_toml: TrackersTomlOption = None,
    sandbox: SandboxOption = False,
    as_json: JsonOption = False,
) -> None:
    """Give a verdict on each clause of the plugin contract, and what to mend. Exit code 1 unless all are kept."""
    from gridtrack.evaluation.hosting.contract_suite import ClauseResult, check_tracker
    from gridtrack.evaluation.hosting.limits import Limits
    from gridtrack.evaluation.runs.learned import find_weights
    from gridtrack.reports.contract import clause_lines, contract_line
    from gridtrack.trackers.selection import launch, read_trackers_toml

    def tell(result: ClauseResult) -> None:
        typer.echo("\n".join(clause_lines(result)))

    chosen = _tracker_alone(tracker)
    stream = _stream(recording)
    found = find_weights(chosen.name, stream.site, weights, chosen.card)
    launched = launch(chosen.name, read_trackers_toml(trackers_toml) if trackers_toml else None)
    limits = Limits(sandbox=sandbox)
    if found is None:
        _refuse_untrained(launched, chosen.options, limits, stream.site)
    with_weights = replace(stream, weights=found.path if found else None)
    results = check_tracker(launched, with_weights, chosen.options, limits, report=None if as_json else tell)
    if as_json:
        typer.echo(json.dumps([result.record() for result in results], indent=1))
    else:
        typer.echo(contract_line(chosen.name, results))
    if not all(result.kept for result in results):
        raise typer.Exit(1)


@app.command("new")
def new_command(
    name: str, out: Annotated[Path | None, typer.Option(help="The new folder; default: the name")] = None
) -> None:
    """Write a complete tracker package: a small tracker, its entry point, tests, baseline and CI file."""
    from gridtrack.cli.template import new_tracker

    module = new_tracker(name, out or Path(name))
    with_tests = shlex.quote(f"{module.parent}[test]")
    typer.echo(f"tracker: {module}\nnext: pip install -e {with_tests} && gridtrack trackers check {name}")


@app.command("migrate")
def migrate_weights(cards: Annotated[list[Path], typer.Argument(metavar="CARD_OR_FOLDER...")]) -> None:
    """Rewrite weights cards of an older gridtrack in place: options and arrays get their present names."""
    from gridtrack.common.errors import WeightsError
    from gridtrack.trackers.migration import migrate_cards

    done = migrate_cards(cards)
    typer.echo(f"weights: {len(done.rewritten)} cards migrated, {len(done.unchanged)} have the present schema")
    if done.errors:
        raise WeightsError(f"{len(done.errors)} cards are left as they are; the first: {done.errors[0]}")


def _tracker_alone(text: str) -> Any:
    """A selection without `points` and `weights`, which only the row of a comparison has."""
    from gridtrack.trackers.selection import parse_selection

    chosen = parse_selection(text)
    if chosen.points != "centres" or chosen.weights is not None:
        raise ConfigurationError(f"tracker '{text}': points= and weights= are for rows of a comparison")
    return chosen


def _refuse_untrained(launched: Any, options: Any, limits: Any, site: str) -> None:
    """Raises ConfigurationError for a tracker without the weights that it needs: nothing can be checked."""
    from gridtrack.evaluation.hosting.tracker_process import describe

    where = f"of site '{site}'" if site else "here"
    with suppress(PluginError):  # a tracker that cannot be loaded fails the first check
        if describe(launched, options, limits).learns:
            raise ConfigurationError(
                f"tracker '{launched.name}' needs weights, and there are none {where}: name a recording of a site with"
                f" weights (--recording), or one of weights (--weights); `gridtrack train {launched.name} RECORDING`"
                " writes one"
            )


def _stream(recording: str | None) -> Any:
    from gridtrack.common.grid import GridSpec
    from gridtrack.recordings.stream import open_stream
    from gridtrack.trackers.contract import StreamSpec, stream_of

    return stream_of(open_stream(recording)) if recording else StreamSpec(GridSpec(), 0.125)
