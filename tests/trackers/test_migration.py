"""A weights card of an earlier schema is refused with the command that migrates it to the present names."""

from __future__ import annotations

import re
import shlex
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import load_file
from typer.testing import CliRunner

from gridtrack.cli import app
from gridtrack.common.errors import WeightsError
from gridtrack.common.grid import GridSpec
from gridtrack.trackers import registry
from gridtrack.trackers.card import CARD_SCHEMA, Card
from gridtrack.trackers.contract import StreamSpec
from gridtrack.trackers.migration import RENAMES, Renames, migrate_card, migrate_cards
from gridtrack.trackers.weights import load_weights, parse_card, read_arrays, read_card, save_weights

GRID = GridSpec(4, 0.5)
COMMAND = "gridtrack train kalman:surge=0.07,link_m=0.2 'a b.mcap' --validation surge.mcap --out weights"
MIGRATED = "gridtrack train kalman:speed_noise=0.07,link_m=0.2 'a b.mcap' --validation surge.mcap --out weights"

OTHER = {
    "tracker": "kalman",
    "site": "other",
    "grid": str(GRID),
    "period_s": 0.1,
    "seed": 0,
    "command": "",
    "train": (),
    "settings": {"link_m": 0.2},
}


@pytest.fixture
def old(tmp_path: Path) -> Path:
    """A card of schema 1 with two old options and an old array."""
    path = tmp_path / "kalman" / "hall.toml"
    card = Card(
        schema_version=1,
        tracker="kalman",
        site="hall",
        grid=str(GRID),
        period_s=0.1,
        seed=3,
        command=COMMAND,
        train=(),
        settings={"surge": 0.07, "link_m": 0.2, "birth_probability": 0.3},
        results={"classes": {"command": "gridtrack train kalman:stage=classes,sink_s=3 a.mcap", "seed": 1}},
    )
    save_weights(path, card, {"dwell": np.eye(3, dtype=np.float32), "calibration": np.zeros((2, 3), np.float32)})
    return path


def contents(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_an_old_card_is_refused_with_the_command_that_migrates_it(old):
    with pytest.raises(WeightsError, match="schema 1; this gridtrack reads 2") as refused:
        read_card(old)
    command = re.search("run `(.*)`$", str(refused.value))
    done = CliRunner().invoke(app, shlex.split(command[1])[1:])
    assert (done.exit_code, done.output) == (0, "weights: 1 cards migrated, 0 have the present schema\n")
    weights = load_weights(StreamSpec(GRID, 0.1, "hall", weights=old), "kalman")
    assert weights.card.settings == {"speed_noise": 0.07, "link_m": 0.2, "initiation_probability": 0.3}
    assert np.array_equal(weights.arrays["residence"], np.eye(3))
    assert set(weights.arrays) == {"residence", "calibration"}
    assert weights.card.command == MIGRATED
    assert weights.card.results["classes"]["command"] == "gridtrack train kalman:stage=classes,adaptation_s=3 a.mcap"
    assert weights.card.seed == 3


def test_the_command_for_a_path_with_a_space_can_be_run_as_printed(old):
    moved = old.rename(old.with_name("main hall.toml"))
    old.with_suffix(".safetensors").rename(moved.with_suffix(".safetensors"))
    with pytest.raises(WeightsError, match=r"run `gridtrack trackers migrate '.*main hall\.toml'`"):
        read_card(moved)


def test_migrating_twice_changes_nothing(old):
    assert migrate_card(old)
    once = contents(old.parent)
    assert not migrate_card(old)
    assert migrate_cards([old.parent]).unchanged == [old]
    assert contents(old.parent) == once
    assert set(once) == {old, old.with_suffix(".safetensors")}


def test_cards_are_found_in_folders_and_each_is_migrated_once(old):
    done = migrate_cards([old.parents[1], old])
    assert (done.rewritten, done.unchanged, done.errors) == ([old], [], [])


@pytest.mark.parametrize("damaged", [".toml", ".safetensors"])
def test_a_damaged_card_is_left_as_it_was_and_the_others_are_migrated(old, damaged):
    other = old.with_name("other.toml")
    save_weights(other, Card(schema_version=1, **OTHER), {})
    broken = old.with_suffix(damaged)
    broken.write_bytes(broken.read_bytes()[:-1] + b"!")
    before = contents(old.parent)
    done = CliRunner().invoke(app, ["trackers", "migrate", str(old.parent)])
    assert isinstance(done.exception, WeightsError)
    assert str(done.exception).startswith("1 cards are left as they are; the first: ")
    after = contents(old.parent)
    assert {path: after[path] for path in (old, old.with_suffix(".safetensors"))} == {
        path: before[path] for path in (old, old.with_suffix(".safetensors"))
    }
    assert read_card(other).settings == {"link_m": 0.2}


def test_a_card_of_a_later_schema_is_not_touched(old):
    old.write_text(old.read_text().replace("schema_version = 1", "schema_version = 9"))
    before = contents(old.parent)
    assert migrate_cards([old]).errors == [f"{old}: schema 9; this gridtrack migrates 1 to 2"]
    assert contents(old.parent) == before


def test_a_folder_without_cards_is_an_error(tmp_path):
    with pytest.raises(WeightsError, match="no weights card"):
        migrate_cards([tmp_path])


NEXT = {
    CARD_SCHEMA + 1: {
        "kalman": Renames(options={"speed_noise": "along_noise", "link_m": "gap_m"}, arrays={"residence": "stay"})
    }
}
"""A schema that does not exist, after the present one: it renames a renamed option, an old one and an array."""


def test_a_card_is_taken_through_every_schema_after_its_own(old):
    assert migrate_card(old, {**RENAMES, **NEXT})
    card = parse_card(old)
    assert card.schema_version == CARD_SCHEMA + 1
    assert card.settings == {"along_noise": 0.07, "gap_m": 0.2, "initiation_probability": 0.3}
    assert card.command == MIGRATED.replace("speed_noise", "along_noise").replace("link_m", "gap_m")
    assert set(read_arrays(old.with_suffix(".safetensors"), card.arrays_sha256)) == {"stay", "calibration"}


def test_a_card_of_the_present_schema_is_taken_through_the_later_ones_only(old):
    migrate_card(old)
    assert migrate_card(old, {**RENAMES, **NEXT})
    assert parse_card(old).settings == {"along_noise": 0.07, "gap_m": 0.2, "initiation_probability": 0.3}


def test_a_tracker_without_renames_needs_no_entry(tmp_path):
    path = tmp_path / "other.toml"
    save_weights(path, Card(schema_version=1, **{**OTHER, "tracker": "other"}), {})
    assert migrate_card(path, {**RENAMES, **NEXT})
    assert (parse_card(path).schema_version, parse_card(path).settings) == (CARD_SCHEMA + 1, {"link_m": 0.2})


def test_every_schema_after_the_first_has_its_renames():
    assert list(RENAMES) == list(range(2, CARD_SCHEMA + 1))


@pytest.mark.parametrize("tracker", sorted({tracker for step in RENAMES.values() for tracker in step}))
def test_every_new_name_is_an_option_and_no_old_name_is(tracker):
    fields = registry.load(tracker).Options.model_fields
    renames = [step[tracker].options for step in RENAMES.values() if tracker in step]
    old_names = {name for options in renames for name in options}
    assert {name for options in renames for name in options.values()} - old_names <= set(fields)
    assert not old_names & set(fields)


def test_the_shipped_cards_have_the_present_schema_and_no_old_array():
    weights = Path(str(resources.files("gridtrack.data") / "weights"))
    for path in sorted(weights.rglob("*.toml")):
        card = read_card(path)
        arrays = load_file(path.with_suffix(".safetensors"))
        assert not set(arrays) & {old for step in RENAMES.values() for old in step.get(card.tracker, Renames()).arrays}


def test_the_glossary_lists_every_renamed_option():
    glossary = (Path(__file__).parents[2] / "docs" / "glossary.md").read_text()
    renames = [one for step in RENAMES.values() for one in step.values()]
    rows = {f"| `{old}` | `{new}` |" for one in renames for old, new in one.options.items()}
    assert rows <= set(glossary.splitlines())
