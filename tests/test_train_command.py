"""`gridtrack train`: the tracker and its settings from the command line, a recipe or a card."""

from __future__ import annotations

import pytest
from typer.testing import CliRunner

from gridtrack.cli import app
from gridtrack.common.errors import ConfigurationError
from gridtrack.recordings import packaged_recording
from gridtrack.trackers.weights import read_card

DEMO = str(packaged_recording("leg_tracker"))


def train(*arguments: str) -> None:
    CliRunner().invoke(app, ["train", *arguments], catch_exceptions=False)


def test_a_recipe_names_tracker_and_recording_and_the_command_line_overrides_it(tmp_path):
    recipe = tmp_path / "recipe.toml"
    recipe.write_text(
        f'tracker = "static-map"\nrecordings = ["{DEMO}"]\nout = "{tmp_path / "weights"}"\n'
        "[options]\nprior_frames = 2.5\n"
    )
    card = tmp_path / "weights" / "static-map" / "leg_tracker.toml"
    train("--recipe", str(recipe))
    assert read_card(card).settings == {"prior_frames": 2.5}
    train("static-map:prior_frames=4", "--recipe", str(recipe), "--seed", "9")
    assert (read_card(card).settings, read_card(card).seed) == ({"prior_frames": 4.0}, 9)


def test_the_first_argument_beside_a_card_is_a_recording_where_no_tracker_has_this_name(tmp_path):
    train("static-map:prior_frames=3", DEMO, "--out", str(tmp_path / "first"))
    card = tmp_path / "first" / "static-map" / "leg_tracker.toml"
    train(f"{DEMO}@0s-20s", "--like", str(card), "--validation", f"{DEMO}@75s-81s", "--out", str(tmp_path / "second"))
    second = read_card(tmp_path / "second" / "static-map" / "leg_tracker.toml")
    assert second.settings == {"prior_frames": 3.0}
    assert second.train[0].recording == "leg_tracker.mcap@0s-20s"


def test_a_recipe_and_a_card_together_are_refused(tmp_path):
    with pytest.raises(ConfigurationError, match="--recipe and --like: give one of them"):
        train("--recipe", "a.toml", "--like", "b.toml")
