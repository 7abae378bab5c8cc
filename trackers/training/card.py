"""The card of learned weights: tracker, site, grid, period, training recordings, seed, command, settings and results.

The weights of a site are used there only. General weights were learned at many places, and are used at sites without
weights: their card has no site and no grid, but the ranges of cell and period of their training.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator, model_validator

from gridtrack.common.config import Settings
from gridtrack.common.entry_points import VALID_NAME
from gridtrack.common.errors import WeightsError
from gridtrack.common.geometry import SE2
from gridtrack.common.scan import MAX_POSITION_M
from gridtrack.trackers.contract import FitTask, FrameSource

CARD_SCHEMA = 2
GENERAL = "general"
"""The site on the card of general weights, and the name of its file."""

Coordinate = Annotated[float, Field(ge=-MAX_POSITION_M, le=MAX_POSITION_M)]
TrackerName = Annotated[str, Field(pattern=f"^{VALID_NAME.pattern}$")]
Range = tuple[Annotated[float, Field(gt=0.0)], Annotated[float, Field(gt=0.0)]]


class TrainingData(Settings):
    """A stretch of a recording that weights were trained on."""

    recording: str
    sha256: str
    site: str = ""
    """Of the recording; "" if unknown."""
    source_sha256: str = ""
    """Of the file that the recording was first imported from; "" if unknown."""
    start_ns: int = 0
    end_ns: int = 0
    """Stamps of the frames: from `start_ns` on, `end_ns` excluded; 0 if `source_sha256` is unknown."""


class StartedFrom(Settings):
    """The general weights that a training started from."""

    name: str
    """`<tracker>/general.toml`."""
    sha256: str
    """Of that card, which has the hash of its arrays."""


class CardThresholds(Settings):
    """Thresholds for recordings without a validation stretch, chosen on the validation stretches of the training.

    `values`: by stratum, at horizons of 0, 1, 2, ... times `step_s`.
    """

    step_s: float = Field(gt=0.0)
    values: dict[str, tuple[Annotated[float, Field(ge=0.0, le=1.0)], ...]]

    def at(self, stratum: str, horizons_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """The thresholds (S,) of a stratum at these horizons (S,), of the nearest known horizon; 0.5 by default."""
        known = np.asarray(self.values.get(stratum) or (0.5,))
        return np.asarray(known[np.minimum(np.rint(horizons_s / self.step_s).astype(np.int64), len(known) - 1)])


class Card(Settings):
    """The readable half of a tracker's weights."""

    schema_version: int = CARD_SCHEMA
    tracker: str
    site: str
    grid: str = ""
    """Of the recordings; "" on a general card."""
    period_s: float | None = Field(None, gt=0.0)
    """Of the recordings; None on a general card."""
    cells_m: Range | None = None
    """On a general card: the smallest and the largest cell of the recordings, metres."""
    periods_s: Range | None = None
    """On a general card: the shortest and the longest period of the recordings, seconds."""
    seed: int
    command: str
    started_from: StartedFrom | None = None
    """None: from scratch."""
    train: tuple[TrainingData, ...]
    """The training data of this training, then of the general weights that it `started_from`."""
    validation: tuple[TrainingData, ...] = ()
    arrays_sha256: str = ""
    classes: tuple[str, ...] = ()
    """The classes of the tracker, in its order; scores match them by name with the classes of a recording."""
    world_T_grid: tuple[Coordinate, Coordinate] | None = None
    """Pose of the arrays with a value per cell: x and y of their grid frame, metres; its axes are parallel to the
    world frame. None on a general card."""
    thresholds: CardThresholds | None = None
    """None if the training did not choose any, for example because it was interrupted."""
    interrupted: str = ""
    """The last step of an interrupted training, such as "update 200 of 1000"; empty if it finished."""
    settings: dict[str, Any] = Field(default_factory=dict)
    results: dict[str, Any] = Field(default_factory=dict)
    members: dict[TrackerName, Card] | None = None
    """The cards of other trackers, by their names, whose forecasts this one combines; the data that these were trained
    on is in `train` and `validation`, and their arrays are among this card's."""

    @field_validator("classes")
    @classmethod
    def _distinct(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        if len(set(names)) != len(names):
            raise ValueError("a class is named twice")
        return names

    @model_validator(mode="after")
    def _of_a_site_or_general(self) -> Card:
        if self.general != (self.cells_m is not None) or self.general != (self.periods_s is not None):
            raise ValueError(f"site '{GENERAL}' has cells_m and periods_s, and no other site has them")
        if not self.general and (not self.grid or self.period_s is None or self.world_T_grid is None):
            raise ValueError("the card of a site has its grid, period_s and world_T_grid")
        return self

    @field_validator("members")
    @classmethod
    def _without_members(cls, members: dict[str, Card] | None) -> dict[str, Card] | None:
        if any(card.members for card in (members or {}).values()):
            raise ValueError("a member has members of its own")
        return members

    @property
    def general(self) -> bool:
        """Whether these weights were learned at many places, for any place."""
        return self.site == GENERAL

    @property
    def labelled_scans(self) -> int | None:
        """The number of labelled scans that the classes were learned from; None without classes, or if unknown."""
        number = self.settings.get("labelled_scans") if self.classes else None
        return number if isinstance(number, int) and number > 0 else None

    def beyond_training(self, cell_m: float, period_s: float) -> str:
        """How a stream differs from the training of general weights, as text; "" if it lies within."""
        ranges = (("cells", cell_m, self.cells_m, "m"), ("periods", period_s, self.periods_s, "s"))
        return " and ".join(
            f"{name} of {known[0]:g} to {known[1]:g} {unit}, not {value:g} {unit}"
            for name, value, known, unit in ranges
            if known is not None and not 0.999 * known[0] <= value <= 1.001 * known[1]
        )

    @property
    def map_pose(self) -> SE2 | None:
        """`world_T_grid` of the arrays with a value per cell; None on a general card."""
        return None if self.world_T_grid is None else SE2(*self.world_T_grid)


def card_for(
    tracker: str, task: FitTask, settings: Mapping[str, Any], results: Mapping[str, Any] | None = None
) -> Card:
    """The card of the tracker registered as `tracker` for this task, with its settings and results.

    Settings that are None are left out, because TOML cannot hold None; it is their default. Arrays with a value per
    cell lie in the window of the first frame. Raises WeightsError if the training stretches of a site differ in grid,
    period or site.
    """
    return Card(
        tracker=tracker,
        **_place_of(tracker, task),
        seed=task.seed,
        command=task.command,
        train=_data_of(task.train),
        validation=_data_of(task.validation),
        settings={name: value for name, value in settings.items() if value is not None},
        results=dict(results or {}),
    )


def _place_of(tracker: str, task: FitTask) -> dict[str, Any]:
    """The fields of a card about the place of its training; of a general one, about its ranges. Raises WeightsError."""
    if task.general:
        cells, periods = ([source.grid.cell_m for source in task.train], [source.period_s for source in task.train])
        return {
            "site": GENERAL,
            "cells_m": (min(cells), max(cells)),
            "periods_s": (min(periods), max(periods)),
        }
    kinds = {(str(s.grid), s.period_s, s.site) for s in task.train}
    if len(kinds) != 1:
        raise WeightsError(
            f"{tracker}: train on recordings of one grid, period and site, or for any place with --general; found"
            f" {sorted(kinds)}"
        )
    (grid, period_s, site) = kinds.pop()
    first = next((frame.world_T_grid for source in task.train for frame in source), None)
    return {
        "site": site,
        "grid": grid,
        "period_s": period_s,
        "world_T_grid": None if first is None else (first.x, first.y),
    }


def with_classes(
    card: Card, classes: tuple[str, ...], task: FitTask, settings: Mapping[str, Any], results: Mapping[str, Any]
) -> Card:
    """The card of an earlier training, with classes added by `task` (`stage=classes`)."""
    return card.model_copy(
        update={
            "classes": classes,
            "train": tuple(dict.fromkeys([*card.train, *_data_of(task.train)])),
            "validation": tuple(dict.fromkeys([*card.validation, *_data_of(task.validation)])),
            "settings": card.settings | {"stage": "both"} | dict(settings),
            "results": card.results | {"classes": dict(results)},
        }
    )


def _data_of(sources: Iterable[FrameSource]) -> tuple[TrainingData, ...]:
    return tuple(TrainingData(recording=source.name, sha256=source.sha256) for source in sources)
