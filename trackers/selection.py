"""The trackers of a run, `[LABEL=]NAME[:key=value,...]`, and the command that starts the process of each."""

from __future__ import annotations

import hashlib
import os
import re
import shlex
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args

from pydantic import model_validator

from gridtrack.common.config import Settings, parse_pairs, validated
from gridtrack.common.entry_points import VALID_NAME
from gridtrack.common.errors import ConfigurationError, PluginError, did_you_mean
from gridtrack.common.files import read_bounded, sha256_of
from gridtrack.common.grid import Points
from gridtrack.common.untrusted import parse_toml
from gridtrack.trackers import registry

CardKind = Literal["any", "site", "general"]
"""The weights that a row may use: of the site, general, or any (of the site if there are some, else general)."""
MAX_TOML_BYTES = 1 << 20
LABEL = re.compile(r"[A-Za-z0-9]([A-Za-z0-9._ -]{0,62}[A-Za-z0-9_-])?")


@dataclass(frozen=True, slots=True)
class Selection:
    """One row of a comparison.

    `options`: of the tracker, not yet validated. `points`: the points of the frames: the centres of the occupied cells,
    or the returns of the laser (`points=raw`). `weights`: a folder of weights for this row alone (`weights=DIR`), to
    compare two trainings of a tracker. `card`: the weights to use there (`card=general`).
    """

    label: str
    name: str
    options: Mapping[str, Any] = field(default_factory=dict)
    points: Points = "centres"
    weights: Path | None = None
    card: CardKind = "any"


@dataclass(frozen=True, slots=True)
class Launch:
    """The command that starts the process of the tracker `name`: program and arguments, and the working folder.

    A tracker that is registered in this environment has no folder, and runs in this Python.
    """

    name: str
    argv: tuple[str, ...]
    cwd: Path | None = None

    @property
    def external(self) -> bool:
        """Whether a `trackers.toml` names it."""
        return self.cwd is not None

    @property
    def in_this_python(self) -> bool:
        """Whether this Python serves it, as a registered tracker."""
        return self.argv == _serve(sys.executable, self.name)

    def code_sha256(self) -> str:
        """The hash of the files that the command names; "" if it names none."""
        digests = [sha256_of(path) for path in (Path(self.cwd or "", word) for word in self.argv) if _is_file(path)]
        return hashlib.sha256("\n".join(digests).encode()).hexdigest() if digests else ""


def _is_file(path: Path) -> bool:
    """Whether `path` is a file; a word of a command may be too long for a path, or have a null byte."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def parse_selection(text: str) -> Selection:
    """Read `[LABEL=]NAME[:key=value,...]`; a value that is JSON is read as JSON. Raises ConfigurationError."""
    head, _, tail = text.partition(":")
    label, equals, name = (part.strip() for part in head.partition("="))
    if not equals:
        label = name = head.strip()
    where = f"tracker '{text}'"
    if not VALID_NAME.fullmatch(name):
        raise ConfigurationError(
            f"{where}: '{name}' is not a valid name of a tracker; expected [LABEL=]NAME[:key=value,...]"
        )
    if not LABEL.fullmatch(label):
        raise ConfigurationError(
            f"{where}: label '{label}' must be 1 to 64 of A-Z a-z 0-9 . _ - and space, with a letter or digit first"
        )
    options = parse_pairs(tail, where)
    points = options.pop("points", "centres")
    if points not in ("centres", "raw"):
        raise ConfigurationError(f"{where}: points={points}; expected centres or raw")
    weights = options.pop("weights", None)
    if not isinstance(weights, str | None) or weights == "":
        raise ConfigurationError(f"{where}: weights={weights}; expected a folder")
    card = options.pop("card", "any")
    if card not in get_args(CardKind):
        raise ConfigurationError(f"{where}: card={card}; expected {', '.join(get_args(CardKind))}")
    return Selection(label, name, options, points, Path(weights) if weights else None, card)


def parse_selections(texts: Iterable[str]) -> tuple[Selection, ...]:
    """Read several selections; their labels must differ as names of folders. Raises ConfigurationError."""
    selections = tuple(parse_selection(text) for text in texts)
    labels: set[str] = set()
    for selection in selections:
        if selection.label.casefold() in labels:
            raise ConfigurationError(
                f"two trackers are labelled '{selection.label}': give one another label, LABEL={selection.name}:..."
            )
        labels.add(selection.label.casefold())
    return selections


class ExternalTracker(Settings):
    """A table of `trackers.toml`: a tracker of another Python environment, or any program that speaks the wire.

    Either `python`, the interpreter of an environment in which gridtrack and the tracker are installed (`tracker`: its
    name there, if another), or `command`, a program with its arguments, split as by a shell and run without a shell in
    the folder of `trackers.toml`.
    """

    python: str | None = None
    tracker: str | None = None
    command: str | None = None

    @model_validator(mode="after")
    def _one_way(self) -> ExternalTracker:
        if (self.python is None) == (self.command is None):
            raise ValueError("give either python or command")
        if self.command is not None and self.tracker is not None:
            raise ValueError("tracker is an option of python, not of command")
        if self.tracker is not None and not VALID_NAME.fullmatch(self.tracker):
            raise ValueError(f"'{self.tracker}' is not a valid name of a tracker")
        return self


def is_plugin(start: Launch) -> bool:
    """Whether a tracker is of another package that is installed in gridtrack's own environment."""
    return not start.external and not registry.find(start.name).value.startswith("gridtrack.")


def read_trackers_toml(path: Path) -> dict[str, Launch]:
    """The trackers in `path`, each a table `[NAME]`; the path of a program is relative to the folder of the file.

    Raises ConfigurationError, also for the name of a registered tracker.
    """
    try:
        tables = parse_toml(read_bounded(path, MAX_TOML_BYTES, ConfigurationError))
    except FileNotFoundError as error:
        raise ConfigurationError(f"{path}: cannot be read ({error.strerror})") from None
    except ValueError as error:
        raise ConfigurationError(f"{path}: not TOML that can be read ({error})") from None
    registered = registry.entries()
    launches = {}
    for name, table in tables.items():
        where = f"{path}: [{name}]"
        if not VALID_NAME.fullmatch(name) or not isinstance(table, dict):
            raise ConfigurationError(f"{where}: expected a table named with a-z, 0-9, '.', '_' and '-', at most 64")
        if name in registered:
            raise ConfigurationError(f"{where}: {registered[name].distribution} has a tracker of this name: rename it")
        launches[name] = _external(name, validated(ExternalTracker, table, where), path.absolute().parent, where)
    return launches


def _external(name: str, external: ExternalTracker, folder: Path, where: str) -> Launch:
    if external.python is not None:
        return Launch(name, _serve(_program(external.python, folder), external.tracker or name), folder)
    try:
        words = shlex.split(external.command or "")
    except ValueError as error:
        raise ConfigurationError(f"{where}: command: {error}") from None
    if not words:
        raise ConfigurationError(f"{where}: command is empty")
    return Launch(name, (_program(words[0], folder), *words[1:]), folder)


def _program(program: str, folder: Path) -> str:
    """A path relative to `folder`; a name without a separator is searched in PATH."""
    return str(folder / Path(program).expanduser()) if os.sep in program else program


def _serve(python: str, name: str) -> tuple[str, ...]:
    return (python, "-P", "-m", "gridtrack.trackers.serve", name)


def launch(name: str, external: Mapping[str, Launch] | None = None) -> Launch:
    """How to start the tracker `name`, registered or one of the `external` trackers. Raises PluginError."""
    external = external or {}
    if name in external:
        return external[name]
    known = registry.entries()
    if name not in known:
        raise PluginError(f"there is no tracker '{name}'; {did_you_mean(name, (*known, *external))}")
    return Launch(name, _serve(sys.executable, name))
