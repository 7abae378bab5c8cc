"""A reader of untrusted input: a small valid input in a folder, its damage, and how it is read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from fuzz.damage import Choices, one_of
from gridtrack.common.grid import GridSpec

GRID = GridSpec(20, 0.5)
CLASSES = ("person", "wall")


@dataclass(frozen=True)
class Reader:
    """A reader: `make` writes a valid input into an empty folder, `damage` changes it, `read` gives a few words."""

    make: Callable[[Path], object]
    damage: Callable[[Choices, Path], None]
    read: Callable[[Path], str]


def on_file(name: str, damaged: Callable[[Choices, bytes], bytes]) -> Callable[[Choices, Path], None]:
    """Damage of the only file of that name, or that matches it, in the folder."""

    def damage(choices: Choices, folder: Path) -> None:
        path = one_of(choices, sorted(folder.glob(name)))
        path.write_bytes(damaged(choices, path.read_bytes()))

    return damage
