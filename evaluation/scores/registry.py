"""The registry of scores: every score of this package, and scores of other packages that are asked for by name.

A module of this package that has a ScoreDefinition is a built-in score. A score of another package is an entry point
`gridtrack.scores` and is loaded only where its name is given (`--score NAME`): an installed package runs no code in a
comparison that did not ask for it.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.metadata import EntryPoint

from gridtrack.common.entry_points import registrations
from gridtrack.common.errors import ConfigurationError, did_you_mean
from gridtrack.evaluation import scores as package
from gridtrack.evaluation.scores.definition import Output, ScoreDefinition

GROUP = "gridtrack.scores"


@cache
def built_in() -> tuple[ScoreDefinition, ...]:
    """The scores of this package, by their position."""
    modules = (
        importlib.import_module(f"{package.__name__}.{one.name}") for one in pkgutil.iter_modules(package.__path__)
    )
    found = {id(one): one for module in modules for one in vars(module).values() if isinstance(one, ScoreDefinition)}
    return tuple(sorted(found.values(), key=lambda score: score.position))


def scores(foreign: Sequence[str] = ()) -> tuple[ScoreDefinition, ...]:
    """The built-in scores, then the scores of other packages with these names. Raises ConfigurationError."""
    known = {score.name for score in built_in()}
    return (*built_in(), *(_foreign(name) for name in dict.fromkeys(foreign) if name not in known))


def _foreign(name: str) -> ScoreDefinition:
    """A score of another package. Raises ConfigurationError for one that is not registered or cannot be loaded."""
    installed = registrations(GROUP)
    if name not in installed:
        known = [*installed, *(score.name for score in built_in())]
        raise ConfigurationError(f"--score: no score '{name}' is installed: {did_you_mean(name, known)}")
    entry = installed[name]
    if entry.problem:
        raise ConfigurationError(f"--score {name}: {entry.problem}")
    try:
        found = EntryPoint(name, entry.value, GROUP).load()
    except Exception as error:
        raise ConfigurationError(f"--score {name}: {entry.distribution} cannot be loaded: {error!r}") from error
    if not isinstance(found, ScoreDefinition) or found.name != name:
        raise ConfigurationError(f"--score {name}: {entry.value} is not a ScoreDefinition with this name")
    return found


def find_output(text: str, among: Sequence[ScoreDefinition]) -> tuple[ScoreDefinition, Output]:
    """The score and output of `f1` (the leading output) or `f1.recall`. Raises ConfigurationError."""
    name, output = output_named(text, {one.name: [own.name for own in one.outputs] for one in among})
    score = next(one for one in among if one.name == name)
    return score, score.output(output)


def output_named(text: str, known: Mapping[str, Sequence[str]]) -> tuple[str, str]:
    """The names of the score and output of `f1` or `f1.recall`; `known`: outputs by score, the leading one first.

    Raises ConfigurationError.
    """
    name, _, output = text.partition(".")
    if name not in known:
        raise ConfigurationError(f"no score '{name}': {did_you_mean(name, known)}")
    if output and output not in known[name]:
        raise ConfigurationError(f"score {name} has no output '{output}': {did_you_mean(output, known[name])}")
    return name, output or known[name][0]
