"""`trackers list | show | check | new | export`: the registered trackers and their learned weights."""

from __future__ import annotations

import json
import keyword
import math
import re
import shlex
import sys
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
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
    weights_folder,
)
from gridtrack.cli.train import tracker_alone
from gridtrack.common.errors import ConfigurationError, GridtrackError, PluginError, printable
from gridtrack.common.files import write_text
from gridtrack.common.grid import GridSpec
from gridtrack.evaluation.hosting.limits import Limits
from gridtrack.evaluation.hosting.outcome import TrialEnded
from gridtrack.evaluation.hosting.tracker_process import TrackerDescription, TrackerProcess, describe
from gridtrack.evaluation.runs.learned import find_weights, sites_with_weights
from gridtrack.recordings.stream import open_stream
from gridtrack.trackers import registry
from gridtrack.trackers.contract import StreamSpec, stream_of
from gridtrack.trackers.selection import Launch, Selection, launch, read_trackers_toml
from gridtrack.trackers.training.card import GENERAL, Card
from gridtrack.trackers.training.weights import read_card

app = typer.Typer(add_completion=False, no_args_is_help=True)

NameArgument = Annotated[str, typer.Argument(metavar="NAME", autocompletion=complete_tracker)]
DEFAULT_STREAM = StreamSpec(GridSpec(), 0.125)
"""The stream of `check` without a recording: 100x0.2 at 8 Hz."""

PLAIN, LEARNED = "example_tracker", "learned_tracker"
"""The examples that `new` copies: the name of the folder and of the module in it."""
TEMPLATE_FILES = ("README.md", "pyproject.toml", ".github/workflows/test.yml", "{}.py", "tests/test_{}.py")
BASELINE_FILE = "tests/{}.json"
"""Of PLAIN only: LEARNED has no weights before its first training."""
MAX_NAME = 60
PACKAGE_NAME = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")


@app.command("list")
def list_trackers(
    weights: WeightsOption = None, trackers_toml: TrackersTomlOption = None, as_json: JsonOption = False
) -> None:
    """List the trackers: ready, untrained (no weights for any site), or unavailable with the reason.

    Each is described by its own process.
    """
    from gridtrack.reports.terminal import print_rows

    external = read_trackers_toml(trackers_toml) if trackers_toml else {}
    origins = {name: entry.distribution for name, entry in registry.entries().items()}
    origins |= dict.fromkeys(external, str(trackers_toml))
    with ThreadPoolExecutor() as pool:
        rows = list(pool.map(lambda name: _listed(name, origins[name], external, weights), origins))
    typer.echo(json.dumps(rows, indent=1)) if as_json else print_rows(rows)


def _listed(name: str, origin: str, external: dict[str, Launch], weights: Path | None) -> dict[str, str]:
    """The row of one tracker; `sites` have weights for it, "" if it needs none."""
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


def _describe(name: str, external: dict[str, Launch] | None = None) -> TrackerDescription:
    return describe(launch(name, external), {}, Limits())


@app.command("show")
def show_tracker(name: NameArgument, as_json: JsonOption = False) -> None:
    """Show the description, the role and the options of a tracker, with their defaults."""
    from gridtrack.reports.terminal import print_rows

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


@app.command("check")
def check_command(
    tracker: Annotated[str, typer.Argument(metavar="NAME[:KEY=VALUE,...]", autocompletion=complete_selection)],
    recording: Annotated[
        str | None,
        typer.Option(
            metavar="RECORDING",
            help="Check with the grid, rate and site of this recording; default: of the site in --weights, else"
            f" {DEFAULT_STREAM.grid} at {1 / DEFAULT_STREAM.period_s:g} Hz without a site",
        ),
    ] = None,
    weights: WeightsOption = None,
    trackers_toml: TrackersTomlOption = None,
    sandbox: SandboxOption = False,
    as_json: JsonOption = False,
) -> None:
    """Give a verdict on each clause of the plugin contract, and how to fix it. Exit code 1 unless all are kept."""
    from gridtrack.evaluation.hosting.contract_suite import ClauseResult, check_tracker
    from gridtrack.reports.contract import clause_lines, contract_line

    def print_result(result: ClauseResult) -> None:
        typer.echo("\n".join(clause_lines(result)))

    chosen = tracker_alone(tracker)
    stream = stream_of(open_stream(recording)) if recording else _stream_of_weights(chosen.name, weights)
    found = find_weights(chosen.name, stream.site, weights, chosen.card)
    launched = launch(chosen.name, read_trackers_toml(trackers_toml) if trackers_toml else None)
    limits = Limits(sandbox=sandbox)
    if found is None:
        _refuse_untrained(launched, chosen.options, limits, stream.site)
    with_weights = replace(stream, weights=found.path if found else None)
    results = check_tracker(launched, with_weights, chosen.options, limits, report=None if as_json else print_result)
    if as_json:
        typer.echo(json.dumps([result.record() for result in results], indent=1))
    else:
        typer.echo(contract_line(chosen.name, results))
    if not all(result.kept for result in results):
        raise typer.Exit(1)


@app.command("export")
def export_command(
    tracker: Annotated[str, typer.Argument(metavar="NAME[:KEY=VALUE,...]", autocompletion=complete_selection)],
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="The new folder")],
    weights: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER|CARD",
            help="Folder of learned weights, or its URL, or one card (.toml); default: your own or the shipped general"
            " weights",
            parser=weights_folder,
        ),
    ] = None,
    grid: GridOption = None,
    rate: RateOption = None,
    trackers_toml: TrackersTomlOption = None,
) -> None:
    """Write a network as ONNX graphs with a manifest, for programs without gridtrack; of other trackers the settings.

    Grid and rate of general weights: --grid and --rate, by default 100x0.2 at 8 Hz.
    """
    chosen = tracker_alone(tracker)
    stream = _stream_to_export(chosen, weights)
    if grid:
        stream = replace(stream, grid=GridSpec.parse(grid))
    if rate is not None:
        stream = replace(stream, period_s=_period_s(rate))
    launched = launch(chosen.name, read_trackers_toml(trackers_toml) if trackers_toml else None)
    typer.echo(printable(export_tracker(launched, stream, chosen.options, out)))
    typer.echo(printable(f"export: {out}"))


def _period_s(rate_hz: float) -> float:
    if not 0.0 < rate_hz < math.inf:
        raise ConfigurationError(f"--rate {rate_hz:g}: it should be greater than 0")
    return 1.0 / rate_hz


def _stream_to_export(chosen: Selection, weights: Path | None) -> StreamSpec:
    """The stream of a card, or of the weights that `weights`, the user or gridtrack has. Raises WeightsError."""
    if weights is not None and weights.suffix == ".toml":
        card = read_card(weights)
        return replace(DEFAULT_STREAM if card.general else _stream_of_card(card), weights=weights.absolute())
    stream = _stream_of_weights(chosen.name, weights)
    found = find_weights(chosen.name, stream.site, weights, chosen.card)
    return replace(stream, weights=found.path.absolute() if found else None)


def export_tracker(launched: Launch, stream: StreamSpec, options: Mapping[str, Any], out: Path) -> str:
    """Let a tracker write its export into the new folder `out`; returns its line about the files.

    Raises ConfigurationError, PluginError.
    """
    if out.exists() or out.is_symlink():
        raise ConfigurationError(f"{out}: exists; choose another folder with --out")
    out.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(prefix=f".{out.name}.", dir=out.parent) as scratch:
        written = Path(scratch, "export")
        written.mkdir()
        try:
            with TrackerProcess(launched, stream, options, Limits(), Path(scratch, "stderr.log")) as process:
                about = process.export(written)
        except TrialEnded as ended:
            error = PluginError if ended.outcome in {"crashed", "unavailable"} else ConfigurationError
            raise error(f"tracker '{launched.name}': {ended.reason}") from None
        written.rename(out)
    return about


def _stream_of_weights(tracker: str, weights: Path | None) -> StreamSpec:
    """The stream of the only site that `weights` has a card of `tracker` for; DEFAULT_STREAM with a general card, or
    without `weights`.

    Raises ConfigurationError for other numbers of cards, and WeightsError.
    """
    if weights is None or not weights.is_dir():
        return DEFAULT_STREAM
    cards = {path.stem: path for path in sorted((weights / tracker).glob("*.toml"))}
    if GENERAL in cards:
        return DEFAULT_STREAM
    if len(cards) != 1:
        sites = f" for several sites, {', '.join(cards)}: name a recording of one with --recording" if cards else ""
        raise ConfigurationError(f"{weights}: {'has weights' if cards else 'has no weights'} of {tracker}{sites}")
    (path,) = cards.values()
    return _stream_of_card(read_card(path))


def _stream_of_card(card: Card) -> StreamSpec:
    """The stream that the card of a site is for."""
    assert card.period_s is not None  # of the card of a site
    return StreamSpec(GridSpec.parse(card.grid), card.period_s, site=card.site)


@app.command("new")
def new_command(
    name: str,
    out: Annotated[Path | None, typer.Option(metavar="FOLDER", help="The new folder; default: the name")] = None,
    learned: Annotated[bool, typer.Option("--learned", help="A tracker with a network that is trained")] = False,
) -> None:
    """Write a complete tracker package: a small tracker, its entry point, tests and CI file, and a baseline of its
    scores unless it is `--learned`."""
    module = new_tracker(name, out or Path(name), learned=learned)
    with_tests = shlex.quote(f"{module.parent}[test]")
    then = f"train {name} RECORDING" if learned else f"trackers check {name}"
    typer.echo(f"tracker: {module}\nnext: pip install -e {with_tests} && gridtrack {then}")


def _refuse_untrained(launched: Launch, options: Mapping[str, Any], limits: Limits, site: str) -> None:
    """Raises ConfigurationError for a tracker without the weights that it needs: nothing can be checked."""
    where = f"of site '{site}'" if site else "here"
    with suppress(PluginError):  # a tracker that cannot be loaded fails the first check
        if describe(launched, options, limits).learns:
            raise ConfigurationError(
                f"tracker '{launched.name}' needs weights, and there are none {where}: name a recording of a site with"
                f" weights (--recording), or a folder of weights (--weights); `gridtrack train {launched.name}"
                " RECORDING` writes one"
            )


def new_tracker(name: str, folder: Path, *, learned: bool = False) -> Path:
    """Write a tracker package called `name` into the new folder `folder`, and return its module.

    It can be installed, passes its tests, and keeps the contract; a `learned` one can be trained, another one has a
    baseline of its scores. Raises ConfigurationError.
    """
    from gridtrack.evaluation.regression.baseline import baseline_of, write_baseline
    from gridtrack.evaluation.regression.measurement import Baseline

    module = name.replace("-", "_")
    if len(name) > MAX_NAME or not PACKAGE_NAME.fullmatch(name) or keyword.iskeyword(module):
        raise ConfigurationError(
            f"'{name}' is not a valid name of a tracker package: use a-z, 0-9 and -, at most {MAX_NAME}, such as"
            " my-tracker"
        )
    if name in registry.entries():
        raise ConfigurationError(f"a tracker '{name}' exists: choose another name")
    if module in sys.stdlib_module_names or find_spec(module):
        raise ConfigurationError(f"a Python module '{module}' exists: choose another name")
    if folder.exists() or folder.is_symlink():
        raise ConfigurationError(f"{folder}: exists; choose another folder with --out")
    example = LEARNED if learned else PLAIN
    for file in TEMPLATE_FILES:
        write_text(_new_file(folder, file.format(module)), _renamed(_example_text(example, file), name, module))
    if not learned:
        renamed = Baseline.model_validate_json(_renamed(_example_text(example, BASELINE_FILE), name, module))
        write_baseline(_new_file(folder, BASELINE_FILE.format(module)), baseline_of(renamed.runs))
    return folder / f"{module}.py"


def _example_text(example: str, file: str) -> str:
    return files("gridtrack").joinpath("examples", example, file.format(example)).read_text("utf-8")


def _new_file(folder: Path, file: str) -> Path:
    path = folder / file
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


def _renamed(text: str, name: str, module: str) -> str:
    """The text of an example with its distribution, module, classes and registered name replaced."""
    camel = "".join(part.capitalize() for part in name.removesuffix("-tracker").split("-"))
    for example, prefix in ((PLAIN, "Fading"), (LEARNED, "Learned")):
        for old, new in (
            (example.replace("_", "-"), name),
            (example, module),
            (f"{prefix}Tracker", f"{camel}Tracker"),
            (f"{prefix}Options", f"{camel}Options"),
        ):
            text = text.replace(old, new)
    # `fading` is the registered name; the method keeps its name, fading memory
    return re.sub(r"\bfading\b(?! memory)", name, text)
