"""Members: trackers inside the weights of another tracker, which combines their forecasts.

Its card carries the cards of the members that learn, and its arrays their files of arrays, byte by byte; the data that
they were trained on stands with its own. Nothing else is read to start them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.config import validated
from gridtrack.common.errors import ConfigurationError, WeightsError
from gridtrack.common.files import sha256_of
from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, shift_between
from gridtrack.trackers import registry
from gridtrack.trackers.contract import StreamSpec, Tracker
from gridtrack.trackers.training.card import GENERAL, Card
from gridtrack.trackers.training.weights import (
    ARRAYS_SUFFIX,
    Weights,
    arrays_content,
    card_text,
    read_card,
)

MEMBER_PREFIX = "members/"
"""The name of a member's file of arrays, as an array of bytes: MEMBER_PREFIX and the name of the member."""


@dataclass(frozen=True, slots=True)
class Member:
    """A member: its registered name, and the card and the file of arrays of its weights, if it learns."""

    name: str
    card: Card | None = None
    arrays: bytes = b""


def find_member(name: str, folder: Path, site: str) -> Member:
    """The tracker `name` with its weights in `folder`: of the site, else general ones.

    Raises PluginError for an unknown tracker, ConfigurationError without weights, WeightsError for damaged ones.
    """
    if not registry.load(name).learns:
        return Member(name)
    paths = [folder / name / f"{one}.toml" for one in dict.fromkeys((site, GENERAL))]
    path = next((path for path in paths if path.is_file()), None)
    if path is None:
        general = " --general" if site == GENERAL else ""
        raise ConfigurationError(
            f"{paths[0]}: missing, and {name} is to be a member: train it first, with `gridtrack train {name}"
            f" RECORDING...{general} --out {folder}`, or copy its weights there"
        )
    card = read_card(path)
    if card.tracker != name:
        raise WeightsError(f"{path}: made for tracker {card.tracker}, but this is {name}: train for this one")
    sha256 = card.arrays_sha256
    return Member(name, card, arrays_content(path.with_suffix(ARRAYS_SUFFIX), sha256) if sha256 else b"")


def with_members(card: Card, members: Iterable[Member]) -> Card:
    """The card with the cards of the members, and with their training and validation data beside its own."""
    cards = {member.name: member.card for member in members if member.card is not None}
    bare: dict[str, Any] = {"train": (), "validation": (), "thresholds": None, "results": {}}
    return card.model_copy(
        update={
            "members": {name: one.model_copy(update=bare) for name, one in cards.items()},
            "train": tuple(dict.fromkeys([*card.train, *(data for one in cards.values() for data in one.train)])),
            "validation": tuple(
                dict.fromkeys([*card.validation, *(data for one in cards.values() for data in one.validation)])
            ),
        }
    )


def arrays_of(members: Iterable[Member]) -> dict[str, NDArray[Any]]:
    """The files of arrays of the members, for the arrays of the tracker that combines them."""
    return {
        f"{MEMBER_PREFIX}{member.name}": np.frombuffer(member.arrays, np.uint8) for member in members if member.arrays
    }


def members_in(weights: Weights, names: Sequence[str]) -> list[Member]:
    """The members `names` of the weights of the tracker that combines them."""
    cards = weights.card.members or {}
    files = {name: weights.arrays.get(f"{MEMBER_PREFIX}{name}") for name in names}
    return [Member(name, cards.get(name), b"" if (file := files[name]) is None else file.tobytes()) for name in names]


class RunningMembers:
    """Members on one stream."""

    def __init__(self, trackers: Sequence[Tracker], stream: StreamSpec) -> None:
        self.trackers, self._stream = trackers, stream
        self._still = [registry.registered_name(type(one)) for one in trackers if not one.moving_sensor]
        self.reset(seed=0)

    def reset(self, seed: int) -> None:
        """Reset each member with the same seed."""
        for tracker in self.trackers:
            tracker.reset(seed)
        self._window: SE2 | None = None

    def update(self, frame: GridFrame) -> None:
        """Update each member. Raises ConfigurationError if the sensor moves and a member does not follow it."""
        shift = shift_between(self._window or frame.world_T_grid, frame.world_T_grid, self._stream.grid.cell_m)
        if shift and self._still:
            raise ConfigurationError(
                f"the sensor moves, and the member {self._still[0]} does not follow it: train a pool without"
                f" {', '.join(self._still)}"
            )
        self._window = frame.world_T_grid
        for tracker in self.trackers:
            tracker.update(frame)

    def probabilities(self, steps: int) -> NDArray[np.float32]:
        """P(occupied) (N, steps+1, M, M) by each of the N members."""
        return np.stack([tracker.predict(steps).occupancy for tracker in self.trackers])


def started(members: Iterable[Member], stream: StreamSpec, combining: type[Tracker]) -> RunningMembers:
    """The members on `stream`, with their default options, for a tracker of the class `combining`.

    Their weights lie in a temporary folder until all of them are made. Raises PluginError, WeightsError and
    ConfigurationError, which name the member.
    """
    with TemporaryDirectory(prefix="gridtrack-members-") as folder:
        return RunningMembers([_started(member, stream, combining, Path(folder)) for member in members], stream)


def _started(member: Member, stream: StreamSpec, combining: type[Tracker], folder: Path) -> Tracker:
    kind = registry.load(member.name)
    if kind.role == "recorded" or issubclass(kind, combining):
        what = "it reads forecasts from a file" if kind.role == "recorded" else "it has members itself"
        raise ConfigurationError(f"{member.name} cannot be a member: {what}")
    card = _unpacked(member, folder)
    own = replace(stream, weights=card, weights_sha256=sha256_of(card) if card else "", velocity_scored=False)
    try:
        return kind(own, validated(kind.Options, {}, member.name))
    except WeightsError as error:
        raise WeightsError(f"member {member.name}: {error}") from None


def _unpacked(member: Member, folder: Path) -> Path | None:
    """The card of the member in `folder`, with its file of arrays beside it; None if it learns nothing."""
    if member.card is None:
        return None
    path = folder / f"{member.name}.toml"
    path.write_text(card_text(member.card))
    if member.arrays:
        path.with_suffix(ARRAYS_SUFFIX).write_bytes(member.arrays)
    return path
