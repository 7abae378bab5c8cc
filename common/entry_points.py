"""Entry points of one group over all installed distributions, listed without importing any of them."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import Distribution, EntryPoint, distributions
from pathlib import Path

VALID_NAME = re.compile(r"[a-z0-9][a-z0-9._-]{0,63}")


@dataclass(frozen=True, slots=True)
class Registration:
    """An entry point of a distribution; `problem` is the reason why it cannot be used, if that is known already."""

    name: str
    value: str
    distribution: str
    """Name and version, for messages."""
    problem: str = ""

    @property
    def distribution_name(self) -> str:
        """The name without the version."""
        return self.distribution.split(" ", maxsplit=1)[0]


PathState = tuple[tuple[str, int], ...]
"""The folders of the import path, each with the time of its last change, ns; 0 for one that does not exist."""


def registrations(group: str) -> dict[str, Registration]:
    """All entry points of `group` by name, sorted. An unusable one has a `problem`."""
    return dict(_found(group, tuple((folder, _changed_ns(folder)) for folder in sys.path)))


def _changed_ns(folder: str) -> int:
    try:
        return Path(folder).stat().st_mtime_ns
    except OSError:
        return 0


@lru_cache(maxsize=32)
def _found(group: str, path: PathState) -> dict[str, Registration]:
    """The registrations while `path` is the state of the import path: a run asks often, and each file is read."""
    found: dict[str, Registration] = {}
    for entry in _registered(group):
        known = found.get(entry.name)
        found[entry.name] = entry if known is None else _registered_twice(known, entry)
    return dict(sorted(found.items()))


def _registered_twice(one: Registration, other: Registration) -> Registration:
    both = f"{one.distribution} and {other.distribution}"
    return Registration(one.name, "", both, f"registered by two distributions, {both}: uninstall one")


def _registered(group: str) -> Iterator[Registration]:
    seen: set[str] = set()
    for distribution in distributions():
        text = distribution.read_text("entry_points.txt") or ""
        if group not in text:
            continue
        name = distribution.metadata["Name"] or "a distribution without a name"
        if name in seen:  # further along the path: hidden from import as well
            continue
        seen.add(name)
        yield from _registrations_of(distribution, f"{name} {distribution.metadata['Version']}", group)


def _registrations_of(distribution: Distribution, label: str, group: str) -> list[Registration]:
    try:
        points = list(distribution.entry_points.select(group=group))
    except (TypeError, ValueError, AttributeError) as error:
        # the parser of the standard library has no specific error for a damaged file
        return [Registration(f"({label})", "", label, f"its entry_points.txt cannot be read ({error})")]
    return [_registration(point, label) for point in points]


def _registration(point: EntryPoint, label: str) -> Registration:
    problem = ""
    if not VALID_NAME.fullmatch(point.name):
        problem = f"'{point.name}' is not a valid name: use a-z, 0-9, '.', '_' and '-', at most 64 characters"
    return Registration(point.name, point.value, label, problem)
