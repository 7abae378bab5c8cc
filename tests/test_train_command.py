"""`gridtrack train`: the tracker and its settings from the command line, a recipe or a card."""

from functools import partial

import pytest

from gridtrack.evaluation.runs.recipe import Recipe
from gridtrack.evaluation.runs.train import general_start, train_tracker
from gridtrack.evaluation.runs.training_process import ProgressLines
from gridtrack.recordings import packaged_recording
from gridtrack.recordings.stream import GridStream
from gridtrack.trackers.training.weights import read_card

from scenes.command_line import gridtrack

pytestmark = pytest.mark.usefixtures("trackers_here")

DEMO = str(packaged_recording("leg_tracker"))


def train(*arguments, code=0):
    return gridtrack("train", *arguments, code=code).stderr


def test_a_recipe_names_tracker_and_recording_and_the_command_line_overrides_it(tmp_path):
    recipe = tmp_path / "recipe.toml"
    recipe.write_text(
        f'tracker = "static-map"\nrecordings = ["{DEMO}@0s-10s"]\nvalidation = ["{DEMO}@75s-81s"]\n'
        f'out = "{tmp_path / "weights"}"\n'
        "[options]\nprior_frames = 2.5\n"
    )
    card = tmp_path / "weights" / "static-map" / "leg_tracker.toml"
    train("--recipe", recipe)
    assert read_card(card).settings == {"prior_frames": 2.5}
    train("static-map:prior_frames=4", "--recipe", recipe, "--seed", "9")
    assert (read_card(card).settings, read_card(card).seed) == ({"prior_frames": 4.0}, 9)


def test_the_first_argument_beside_a_card_is_a_recording_where_no_tracker_has_this_name(tmp_path):
    validation = ("--validation", f"{DEMO}@75s-81s")
    train("static-map:prior_frames=3", f"{DEMO}@0s-10s", *validation, "--out", tmp_path / "first")
    card = tmp_path / "first" / "static-map" / "leg_tracker.toml"
    train(f"{DEMO}@0s-20s", "--like", card, *validation, "--out", tmp_path / "second")
    second = read_card(tmp_path / "second" / "static-map" / "leg_tracker.toml")
    assert second.settings == {"prior_frames": 3.0}
    assert second.train[0].recording == "leg_tracker.mcap@0s-20s"


def test_two_sources_of_a_recipe_or_of_a_start_are_refused(tmp_path):
    assert "--recipe and --like: give one of them" in train("--recipe", "a.toml", "--like", "b.toml", code=2)
    both = ("--weights", tmp_path, "--from-scratch")
    assert "--weights and --from-scratch: give one of them" in train("dogma", DEMO, *both, code=2)


@pytest.fixture
def asked(monkeypatch):
    """The recipes of the trainings that the command line asks for; none is run."""
    recipes = []
    monkeypatch.setattr(
        "gridtrack.evaluation.runs.train.train_tracker", lambda recipe, report: recipes.append(recipe) or "card"
    )
    return recipes


def test_the_start_on_the_command_line_overrides_the_recipes(asked, tmp_path):
    recipe = tmp_path / "recipe.toml"
    recipe.write_text(f'tracker = "dogma"\nrecordings = ["{DEMO}"]\nfrom_scratch = true\n')
    train("--recipe", recipe)
    train("--recipe", recipe, "--weights", "mine")
    recipe.write_text(f'tracker = "dogma"\nrecordings = ["{DEMO}"]\nweights = "shared"\n')
    train("--recipe", recipe)
    train("--recipe", recipe, "--from-scratch")
    assert [(recipe.weights, recipe.from_scratch) for recipe in asked] == [
        (None, True), ("mine", False), ("shared", False), (None, True),
    ]  # fmt: skip
    assert [word for word in asked[1].command.split() if word in ("--weights", "mine", "--from-scratch")] == [
        "--weights", "mine",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("recipe", "can_start", "line"),
    [
        ({"from_scratch": True}, True, "from scratch, not from general weights"),
        (
            {"general": True},
            True,
            "from scratch: a general training starts from general weights only if --weights names their folder",
        ),
        (
            {"weights": "there"},
            False,
            "from scratch: a training of dogma does not start from weights; --weights has no effect",
        ),
    ],
)
def test_a_training_from_scratch_says_why_and_looks_for_no_general_weights(
    monkeypatch, tmp_path, recipe, can_start, line
):
    monkeypatch.setattr("gridtrack.evaluation.runs.train.find_weights", None)
    reported = []
    asked = Recipe(tracker="dogma", **recipe)
    assert general_start(asked, [], tmp_path, reported.append, can_start=can_start) is None
    assert reported == [line]


def test_regions_for_the_thresholds_come_from_the_training_and_not_from_the_rest_of_the_recording(
    monkeypatch, tmp_path
):
    monkeypatch.setattr(GridStream, "all_observations", None)
    train("static-map", f"{DEMO}@0s-20s", "--validation", f"{DEMO}@75s-81s", "--out", tmp_path)
    assert read_card(tmp_path / "static-map" / "leg_tracker.toml").thresholds is not None


def test_choosing_thresholds_reports_its_progress(monkeypatch, tmp_path):
    often = partial(ProgressLines, every_s=0.02)
    monkeypatch.setattr("gridtrack.evaluation.runs.train.ProgressLines", often)
    reported = []
    recipe = {"recordings": [f"{DEMO}@0s-20s"], "validation": [f"{DEMO}@75s-81s", f"{DEMO}@81s-90s"], "out": tmp_path}
    train_tracker(Recipe(tracker="static-map", from_scratch=True, **recipe), reported.append)
    thresholds = [line.split(",")[0] for line in reported if line.startswith("thresholds on recording")]
    assert set(thresholds) == {"thresholds on recording 1 of 2", "thresholds on recording 2 of 2"}
