"""A training is described by a recipe, a card or the command line, and its card has the command that repeats it."""

from __future__ import annotations

import shlex
from importlib import resources
from pathlib import Path

import pytest

from gridtrack.common.config import parse_pairs, validated
from gridtrack.common.errors import ConfigurationError, RecordingError, WeightsError
from gridtrack.evaluation.runs import train as train_module
from gridtrack.evaluation.runs.recipe import Recipe, complete_recipe, read_recipe, recipe_like
from gridtrack.evaluation.runs.train import train_tracker
from gridtrack.evaluation.runs.trial import Trial
from gridtrack.trackers import registry
from gridtrack.trackers.selection import Selection, parse_selection
from gridtrack.trackers.training.weights import read_card

pytestmark = pytest.mark.usefixtures("trackers_here")

RECIPES = Path(__file__).parents[3] / "studies" / "recipes"
CARDS = sorted(Path(str(resources.files("gridtrack.data"))).glob("weights/*/*.toml"))


def named(path: Path) -> str:
    return "/".join(path.parts[-2:])


def recipes(*folders: str) -> list[Path]:
    return sorted(path for folder in folders for path in RECIPES.glob(f"{folder}/*.toml"))


def options_of(recipe: Recipe) -> object:
    pytest.importorskip("torch")
    return validated(registry.load(recipe.tracker).Options, dict(recipe.options), "options")


def site_of(recipe: Recipe) -> str:
    name = "general" if recipe.general else Path(recipe.recordings[0]).stem
    return {"train": "junction"}.get(name, name)


def test_there_is_a_recipe_for_every_card_that_ships():
    """General weights may have a recipe before they are trained."""
    found = {(recipe.tracker, site_of(recipe)) for recipe in map(read_recipe, recipes("weights"))}
    cards = {(path.parent.name, path.stem) for path in CARDS}
    assert cards <= found
    assert {(tracker, site) for tracker, site in found if site != "general"} <= cards


def test_there_is_a_recipe_of_general_weights_for_every_tracker_that_learns_them():
    pytest.importorskip("torch")
    learning = {name for name in registry.entries() if registry.load(name).learns_general}
    assert {r.tracker for r in map(read_recipe, recipes("weights")) if r.general} == learning


@pytest.mark.parametrize("path", recipes("weights", "ablations", "equal-budget", "published"), ids=named)
def test_every_recipe_is_one_training_that_its_tracker_accepts(path):
    recipe = complete_recipe(read_recipe(path), {})
    assert set(recipe.options) <= set(options_of(recipe).model_fields_set)
    assert recipe.out is not None
    starts = registry.load(recipe.tracker).starts_from_general(options_of(recipe))
    reported = recipe.general or recipe.from_scratch or recipe.weights
    assert not starts or reported  # not from weights that the user happens to have
    root, simulated = RECIPES.parents[1], (Path("runs/drives"), Path("runs/worlds"))
    paths = [Path(stretch.partition("@")[0]) for stretch in (*recipe.recordings, *recipe.validation)]
    assert all((root / path).exists() or any(map(path.is_relative_to, simulated)) for path in paths)


@pytest.mark.parametrize("path", recipes("weights"), ids=named)
def test_the_cards_that_ship_have_the_settings_of_their_recipes(path):
    recipe = read_recipe(path)
    file = RECIPES.parents[1] / recipe.out / recipe.tracker / f"{site_of(recipe)}.toml"
    if recipe.general and not file.exists():
        return  # its recipe is there before it is trained
    card = read_card(file)
    asked = {key: value for key, value in recipe.options.items() if key != "stage"}
    assert {key: card.settings[key] for key in asked} == asked
    assert card.seed == recipe.seed


@pytest.mark.parametrize("path", CARDS, ids=named)
def test_a_recipe_like_a_card_has_its_tracker_settings_and_seed(path):
    card, recipe = read_card(path), recipe_like(path)
    assert (recipe.tracker, recipe.options, recipe.seed) == (card.tracker, card.settings, card.seed)
    assert recipe.recordings == ()
    settings = options_of(recipe)
    assert all(getattr(settings, key) is not None for key in card.settings)


def test_a_training_like_a_card_writes_the_settings_of_that_card(record, train, tmp_path):
    first = train("first", options={"prior_frames": 3.0})
    again = complete_recipe(
        recipe_like(first), {"recordings": (str(record("other")),), "out": tmp_path / "other", "seed": 5}
    )
    card = read_card(train_tracker(again))
    assert card.settings == read_card(first).settings == {"prior_frames": 3.0}
    assert (card.train[0].recording, card.seed) == ("other.mcap@train", 5)


def test_a_recipe_trains_and_its_card_has_the_command_that_repeats_it(record, tmp_path):
    path = tmp_path / "recipe.toml"
    path.write_text(
        f'tracker = "static-map"\nrecordings = ["{record()}"]\nvalidation = ["{record()}@4s-9s"]\nseed = 3\n'
        f'out = "{tmp_path / "weights"}"\nrate_hz = 5.0\n\n[options]\nprior_frames = 2.5\n'
    )
    recipe = complete_recipe(read_recipe(path), {})
    card = read_card(train_tracker(recipe))
    assert (card.settings, card.seed, card.period_s) == ({"prior_frames": 2.5}, 3, 0.2)
    assert shlex.split(card.command) == [
        "gridtrack", "train", "static-map:prior_frames=2.5", str(record()), "--validation", f"{record()}@4s-9s",
        "--seed", "3", "--rate", "5", "--out", str(tmp_path / "weights"),
    ]  # fmt: skip


def test_a_folder_stands_for_the_recordings_in_it_and_the_command_names_the_folder(record, train):
    folder = record().parent
    record("other")
    (folder / "notes.txt").write_text("no recording")
    card = read_card(train("weights", "static-map", f"{folder}@0s-4s", validation=(f"{folder}@5s-9s",)))
    assert [data.recording for data in card.train] == ["other.mcap@0s-4s", "room.mcap@0s-4s"]
    assert len(card.train) == len(card.validation) == 2
    assert f"{folder}@0s-4s" in shlex.split(card.command)


def test_a_network_learns_general_weights_from_a_folder_and_has_thresholds(record, train, monkeypatch):
    """The tracker runs with these weights to choose the thresholds, on the device of the options."""
    rows: list[Selection] = []
    monkeypatch.setattr(train_module, "Trial", lambda row, *rest, **more: rows.append(row) or Trial(row, *rest, **more))
    pytest.importorskip("lightning")
    folder = record().parent
    options = {"channels": 4, "updates": 1, "validate_every": 1, "batch": 1, "observed_frames": 3, "blank_frames": 3}
    options["device"] = "cpu"
    how = {"options": options, "general": True, "validation": (f"{folder}@5s-15s",)}
    card = read_card(train("weights", "dilated-convgru", f"{folder}@0s-5s", **how))
    assert card.general
    assert card.settings["resolution_input"]
    assert card.thresholds is not None
    assert rows
    assert all(row.options == {"device": "cpu"} for row in rows)


def test_a_folder_without_recordings_is_refused(train, tmp_path):
    with pytest.raises(RecordingError, match=f"{tmp_path}/empty: no recording in this folder"):
        train("weights", "static-map", (tmp_path / "empty").mkdir() or tmp_path / "empty")


def test_the_command_of_a_recipe_names_every_option_as_the_command_line_reads_it():
    options = {"static_gates": [], "dilated": False, "cell": "plain", "rate": 1e-3, "name": "a, b", "word": "true"}
    recipe = Recipe(tracker="my-tracker", options=options, recordings=("a b.mcap@0s-9s",), grid="50x0.4")
    words = shlex.split(recipe.command)
    assert words[2:] == [words[2], "a b.mcap@0s-9s", "--seed", "1", "--grid", "50x0.4"]
    assert parse_selection(words[2]).options == parse_pairs(words[2].partition(":")[2], "") == options


def test_given_settings_override_the_recipe_and_options_one_by_one():
    base = Recipe(tracker="kalman", options={"a": 1, "b": 2}, recordings=("a.mcap",), seed=4)
    recipe = complete_recipe(base, {"options": {"b": 3}, "recordings": ("b.mcap",), "validation": ("c.mcap",)})
    assert recipe.options == {"a": 1, "b": 3}
    assert (recipe.tracker, recipe.recordings, recipe.validation) == ("kalman", ("b.mcap",), ("c.mcap",))
    assert recipe.seed == 4


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("trackers = 1", r"r\.toml: there is no option 'trackers'; did you mean 'tracker'"),
        ('weights = "w"\nfrom_scratch = true', r"r\.toml: .*weights .* and from_scratch: leave one of them out"),
        ("seed = -1", r"r\.toml: 'seed' = -1: "),
        ("recordings = [", r"r\.toml: not TOML"),
        ("seed = 1\nseed = 2", r"r\.toml: not TOML"),
    ],
)
def test_a_recipe_that_is_none_is_refused(text, message, tmp_path):
    path = tmp_path / "r.toml"
    path.write_text(text)
    with pytest.raises(ConfigurationError, match=message):
        read_recipe(path)
    with pytest.raises(ConfigurationError, match="no such recipe"):
        read_recipe(tmp_path / "missing.toml")


def test_a_training_without_tracker_or_recording_is_refused(tmp_path):
    with pytest.raises(ConfigurationError, match="no tracker to train: name one"):
        complete_recipe(Recipe(recordings=("a.mcap",)), {})
    with pytest.raises(ConfigurationError, match="no recording to train kalman on"):
        complete_recipe(Recipe(tracker="kalman"), {})
    with pytest.raises(WeightsError, match="cannot be read"):
        recipe_like(tmp_path / "missing.toml")
