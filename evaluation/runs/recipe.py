"""The recipe of a training: tracker, options, recordings and seed, from a TOML file, a card or the command line."""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, model_validator

from gridtrack.common.config import Settings, validated
from gridtrack.common.errors import ConfigurationError
from gridtrack.common.files import read_bounded
from gridtrack.common.options import Option, option_words
from gridtrack.common.remote_files import local_folder
from gridtrack.common.untrusted import parse_toml
from gridtrack.recordings.read_options import PoseSource
from gridtrack.recordings.stretches import fetched
from gridtrack.trackers.training.weights import read_card

MAX_RECIPE_BYTES = 1 << 20


class Recipe(Settings):
    """One training of one tracker. Paths are relative to the working directory, as on the command line; recordings and
    weights may be named by URLs.

    A recipe file may leave `tracker` and `recordings` to the command line, and name no `validation`, `grid` or
    `rate_hz`: they are then the recordings'.
    """

    tracker: str = ""
    options: dict[str, Any] = Field(default_factory=dict)
    """Options of the tracker"""
    recordings: tuple[str, ...] = ()
    """To train on: RECORDING[@range], or a folder for all recordings in it"""
    validation: Annotated[tuple[str, ...], Option(metavar="RECORDING[@RANGE]")] = ()
    """Recording, or folder of recordings, to validate on; repeat for several; default: the validation stretch of each
    recording"""
    seed: int = Field(1, ge=0, lt=2**31)
    """Seed of the training; without it, the seed of the recipe or the card"""
    grid: Annotated[str | None, Option(metavar="CELLSxMETRES[@X,Y]")] = None
    """Grid, such as 100x0.2; default: the grid of the recordings"""
    rate_hz: float | None = Field(None, gt=0.0, le=1000.0)
    """Frames per second; default: the rate of the recordings"""
    format: Annotated[str | None, Option(metavar="NAME")] = None
    """Recording format of another package, which is loaded only by this name"""
    ego_motion: Annotated[PoseSource, Option(metavar="SOURCE")] = "recorded"
    """Source of the poses: recorded; kiss-icp, from the scans alone; refined, from the scans with the recorded motion
    as a prior"""
    general: bool = False
    """Learn for any site, from recordings of many sites"""
    from_scratch: bool = False
    """Do not start from general weights"""
    weights: Annotated[str | None, Option(metavar="FOLDER")] = None
    """Folder of general weights to start from, or its URL, searched before your own and the shipped ones; a general
    training starts from general weights only if this names them"""
    out: Annotated[Path | None, Option(metavar="FOLDER")] = None
    """Folder of weights to write to; default: your own"""

    @model_validator(mode="after")
    def _one_start(self) -> Recipe:
        if self.weights and self.from_scratch:
            raise ValueError("weights (the folder to start from) and from_scratch: leave one of them out")
        return self

    @property
    def command(self) -> str:
        """The command line that repeats this training; it does not need the recipe file."""
        options = ",".join(f"{key}={_option_text(value)}" for key, value in self.options.items())
        words = ["gridtrack", "train", f"{self.tracker}:{options}" if options else self.tracker, *self.recordings]
        without = {"tracker", "options", "recordings", *(["ego_motion"] if self.ego_motion == "recorded" else [])}
        words += option_words(Recipe, self.model_dump(exclude=without))
        return shlex.join(words)


def with_local_copies(recipe: Recipe, note: Callable[[str], None]) -> Recipe:
    """The recipe with local copies of the files that it names by URLs. Raises StoreError.

    Its `command` is for this machine only: the command of `recipe` repeats the training anywhere.
    """
    return recipe.model_copy(
        update={
            "recordings": tuple(fetched(text, note) for text in recipe.recordings),
            "validation": tuple(fetched(text, note) for text in recipe.validation),
            "weights": recipe.weights and str(local_folder(recipe.weights, "weights", note)),
        }
    )


def _option_text(value: Any) -> str:
    """An option's value as `parse_pairs` reads it: a plain word as it is, anything else as JSON."""
    if isinstance(value, str) and re.fullmatch("[a-z-]+", value) and value not in ("true", "false", "null"):
        return value
    return json.dumps(value, separators=(",", ":"))


def read_recipe(path: Path) -> Recipe:
    """The recipe in the TOML file `path`. Raises ConfigurationError, also for an unknown key."""
    try:
        fields = parse_toml(read_bounded(path, MAX_RECIPE_BYTES, ConfigurationError))
    except FileNotFoundError:
        raise ConfigurationError(f"{path}: no such recipe") from None
    except ValueError as error:
        raise ConfigurationError(f"{path}: not TOML that can be read ({error})") from None
    return validated(Recipe, fields, str(path))


def recipe_like(path: Path) -> Recipe:
    """Tracker, settings, seed and start of the training that wrote the card at `path`. Raises WeightsError.

    The user names recordings and grid: a card has no folders, and its grid belongs to its site.
    """
    card = read_card(path)
    from_scratch = card.started_from is None
    return Recipe(tracker=card.tracker, options=card.settings, seed=card.seed, from_scratch=from_scratch)


def complete_recipe(base: Recipe, overrides: Mapping[str, Any]) -> Recipe:
    """`base` with the fields in `overrides` replaced; `options` are replaced one by one.

    Raises ConfigurationError if a field is invalid, or no tracker or recording is named.
    """
    fields = base.model_dump(exclude_unset=True) | dict(overrides)
    fields["options"] = {**base.options, **overrides.get("options", {})}
    recipe = validated(Recipe, fields, "training")
    if not recipe.tracker:
        raise ConfigurationError("no tracker to train: name one, as in `gridtrack train NAME RECORDING`")
    if not recipe.recordings:
        raise ConfigurationError(f"no recording to train {recipe.tracker} on: name one after the tracker")
    return recipe
