"""Migration of weights cards of earlier schemas: options and arrays get their present names, schema by schema."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from gridtrack.common.errors import WeightsError
from gridtrack.trackers.card import Card
from gridtrack.trackers.weights import parse_card, read_arrays, save_weights


class Renames(NamedTuple):
    """Old name -> new name, of the options of a tracker and of the arrays in its weights."""

    options: Mapping[str, str] = {}
    arrays: Mapping[str, str] = {}


MODEL_FREE = Renames(
    options={
        "unforeseen_share": "untracked_share",
        "return_s": "rate_recovery_s",
        "sink_above": "static_above",
        "sink_s": "adaptation_s",
        "map_s": "map_weight_s",
        "surge": "speed_noise",
        "agility": "manoeuvre_noise",
        "steady_s": "steady_duration_s",
        "agile_s": "manoeuvre_duration_s",
        "surface_m": "surface_noise_m",
        "birth_probability": "initiation_probability",
        "false_alarm": "clutter_probability",
        "life_s": "mean_lifetime_s",
        "dead_below": "delete_below",
        "settle_s": "background_merge_s",
        "merge_s": "track_merge_s",
        "dwell_speed": "residence_speed",
    },
    arrays={
        "rate": "occupancy_rate",
        "solid": "neighbourhood_rate",
        "dwell": "residence",
        "class_shares": "class_mixture_weights",
        "class_place": "class_cell_prior",
    },
)
DOGMA = Renames(
    options={
        "hit_mass": "occupied_mass",
        "crossed_mass": "free_mass",
        "life_s": "mean_lifetime_s",
        "free_s": "free_decay_s",
        "rest_share": "static_share",
        "creep_speed": "start_stop_speed",
        "start_s": "time_to_start_s",
        "stop_s": "time_to_stop_s",
    },
    arrays={"usual": "occupancy_rate"},
)
RECURRENT = Renames(
    options={
        "shown": "observed_frames",
        "blank": "blank_frames",
        "cycles": "repetitions",
        "reverse": "time_reversal",
        "superpose": "superposition",
    }
)
RENAMES: Mapping[int, Mapping[str, Renames]] = {
    2: {
        "kalman": MODEL_FREE,
        "factor-graph": MODEL_FREE,
        "dogma": DOGMA,
        "dilated-convgru": RECURRENT,
        "deep-tracking-rnn": RECURRENT,
    }
}
"""For each schema up to CARD_SCHEMA the renames of each tracker from the schema before; other trackers have none."""

OPTION = re.compile(r"(?<=[:,])\w+(?==)")
"""The name of an option in a training command: `kalman:link_m=0.4,reach_m=0.5`."""


class Migration(NamedTuple):
    """The cards that were rewritten, those that had the present schema, and for each other card the error."""

    rewritten: list[Path]
    unchanged: list[Path]
    errors: list[str]


def migrate_cards(cards_or_folders: Iterable[Path]) -> Migration:
    """Migrate each card, and each card in each folder. Raises WeightsError where there is no card."""
    done = Migration([], [], [])
    for path in _cards_in(cards_or_folders):
        try:
            (done.rewritten if migrate_card(path) else done.unchanged).append(path)
        except WeightsError as error:
            done.errors.append(str(error))
    return done


def _cards_in(cards_or_folders: Iterable[Path]) -> list[Path]:
    cards: list[Path] = []
    for path in cards_or_folders:
        found = sorted(path.rglob("*.toml")) if path.is_dir() else [path]
        if not found:
            raise WeightsError(f"{path}: no weights card (.toml) in this folder")
        cards += found
    return list(dict.fromkeys(cards))


def migrate_card(path: Path, steps: Mapping[int, Mapping[str, Renames]] = RENAMES) -> bool:
    """Rewrite the card at `path` and its arrays in the last schema of `steps`; False where the card has it already.

    A card of any earlier schema is taken through each step. `steps` has the renames of each tracker, by schema.
    Both files are written whole before either is replaced, the card last. Raises WeightsError, and leaves both files as
    they are, where the card or its arrays are damaged or the card is of a later schema.
    """
    card = parse_card(path)
    first, last = min(steps) - 1, max(steps)
    if card.schema_version == last:
        return False
    if not first <= card.schema_version < last:
        raise WeightsError(f"{path}: schema {card.schema_version}; this gridtrack migrates {first} to {last}")
    arrays = read_arrays(path.with_suffix(".safetensors"), card.arrays_sha256)
    for schema in range(card.schema_version + 1, last + 1):
        renames = steps[schema].get(card.tracker, Renames())
        card, arrays = _migrated(card, schema, renames), _renamed(arrays, renames.arrays)
    try:
        save_weights(path, card, arrays)
    except OSError as error:
        raise WeightsError(f"{path}: cannot be written ({error.strerror})") from None
    return True


def _migrated(card: Card, schema: int, renames: Renames) -> Card:
    """The card in the next schema."""
    results = dict(card.results)
    classes = results.get("classes")
    if isinstance(classes, dict) and isinstance(classes.get("command"), str):
        results["classes"] = classes | {"command": _migrated_command(classes["command"], renames)}
    return card.model_copy(
        update={
            "schema_version": schema,
            "command": _migrated_command(card.command, renames),
            "settings": _renamed(card.settings, renames.options),
            "results": results,
        }
    )


def _migrated_command(command: str, renames: Renames) -> str:
    """The command as it was typed, with the new names of its options."""
    return OPTION.sub(lambda match: renames.options.get(match[0], match[0]), command)


def _renamed(values: Mapping[str, Any], names: Mapping[str, str]) -> dict[str, Any]:
    return {names.get(name, name): value for name, value in values.items()}
