"""Completion of values in the shell: trackers and their options, values of a fixed set, and keys of KEY=VALUE,...

Modules are imported for a completion and not for every command. Typer keeps the values that begin with the typed text.
"""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stdout
from typing import Any, get_args

BREAKS = frozenset(":=@")
"""Characters at which bash ends a word; a completion replaces the text after the last of them."""


@contextmanager
def words_as_typed() -> Iterator[None]:
    """If bash asks for a completion, give typer whole words, as zsh and fish do, and bash the part that it replaces."""
    if os.environ.get("_GRIDTRACK_COMPLETE") != "complete_bash":
        yield
        return
    broken, at = os.environ["COMP_WORDS"].split("\n"), int(os.environ["COMP_CWORD"])
    words = _joined(broken[: at + 1])
    replaced = "" if BREAKS.issuperset(broken[at]) else broken[at]
    os.environ |= {"COMP_WORDS": "\n".join(words), "COMP_CWORD": str(len(words) - 1)}
    completions = io.StringIO()
    try:
        with redirect_stdout(completions):
            yield
    finally:
        kept = words[-1].removesuffix(replaced)
        sys.stdout.writelines(line.removeprefix(kept) for line in completions.getvalue().splitlines(keepends=True))


def _joined(broken: Sequence[str]) -> list[str]:
    """The whole words: bash breaks words at its BREAKS."""
    words: list[str] = []
    continues = False
    for part in broken:
        is_break = bool(part) and BREAKS.issuperset(part)
        if words and part and (continues or is_break):
            words[-1] += part
        else:
            words.append(part)
        continues = is_break
    return words


def complete_tracker(incomplete: str) -> Iterator[str]:
    """The registered trackers that begin with `incomplete`."""
    from gridtrack.trackers import registry

    yield from (name for name in registry.entries() if name.startswith(incomplete))


def complete_selection(incomplete: str) -> Iterator[str]:
    """A tracker, or its options after `NAME:`."""
    return _complete_selection(incomplete, {})


def complete_row(incomplete: str) -> Iterator[str]:
    """A tracker of a comparison, [LABEL=]NAME[:KEY=VALUE,...]: the label stays as typed."""
    from gridtrack.common.grid import Points
    from gridtrack.trackers.selection import CardKind

    label, equals, _ = incomplete.partition(":")[0].rpartition("=")
    own = {"points": get_args(Points), "card": get_args(CardKind), "weights": ()}
    rows = _complete_selection(incomplete.removeprefix(label + equals), own)
    yield from (f"{label}{equals}{row}" for row in rows)


def _complete_selection(incomplete: str, own: Mapping[str, Sequence[str]]) -> Iterator[str]:
    """NAME, or the last part of NAME:KEY=VALUE,... among the options of that tracker and the options `own`."""
    name, colon, typed = incomplete.partition(":")
    if not colon:
        yield from complete_tracker(name)
        return
    yield from (f"{name}:{part}" for part in _complete_pairs(typed, {**_options_of(name), **own}))


def _options_of(name: str) -> dict[str, Sequence[str]]:
    """The options of a tracker, and the values of an option with few values; none if it cannot be described."""
    from gridtrack.common.errors import GridtrackError
    from gridtrack.evaluation.hosting.limits import Limits
    from gridtrack.evaluation.hosting.tracker_process import describe
    from gridtrack.trackers.selection import launch

    try:
        described = describe(launch(name), {}, Limits())
    except GridtrackError:
        return {}
    schemas = described.options_schema.get("properties", {})
    return {key: _values_of(schemas.get(key, {})) for key in described.options}


def _values_of(schema: Mapping[str, Any]) -> Sequence[str]:
    if schema.get("type") == "boolean":
        return ("true", "false")
    return [value for value in schema.get("enum", ()) if isinstance(value, str)]


def complete_format() -> Sequence[str]:
    """The formats of a report."""
    from gridtrack.reports.formats import FORMAT_NAMES

    return FORMAT_NAMES


def complete_values(kind: Any, values: Sequence[str]) -> Callable[[str], Iterable[str]] | None:
    """A completion among `values`, or of KEY=VALUE,... for the settings `kind`; None for neither."""
    from gridtrack.common.config import Settings, field_names

    if isinstance(kind, type) and issubclass(kind, Settings):
        keys = dict.fromkeys(field_names(kind), ())
        return lambda incomplete: _complete_pairs(incomplete, keys)
    return (lambda incomplete: values) if values else None


def _complete_pairs(incomplete: str, values: Mapping[str, Iterable[str]]) -> Iterator[str]:
    """The last part of KEY=VALUE,...: a key of `values` that is not given yet, with its `=`, or a value of its key."""
    before, comma, last = incomplete.rpartition(",")
    key, equals, _ = last.partition("=")
    if equals:
        yield from (f"{before}{comma}{key}={value}" for value in values.get(key, ()))
        return
    given = {part.partition("=")[0] for part in before.split(",")}
    yield from (f"{before}{comma}{key}=" for key in values if key not in given)
