"""General weights: trained on recordings of unlike places, used if there are none of the site, and named so."""

import json
import shlex

import pytest
from typer.testing import CliRunner

from gridtrack.cli import app
from gridtrack.common.errors import ConfigurationError, WeightsError
from gridtrack.common.files import sha256_of
from gridtrack.recordings import packaged_recording
from gridtrack.trackers.training import searched_fit
from gridtrack.trackers.training.weights import read_card

from scenes.programs_here import programs_here

HALL = str(packaged_recording("leg_tracker"))
"""A hall, in cells of 0.1 m at 10 Hz."""
STREET = str(packaged_recording("junction/validation"))
"""A junction, in cells of 0.2 m at 8 Hz."""


def gridtrack(*arguments, exit_code=0):
    with programs_here():
        done = CliRunner().invoke(app, [str(argument) for argument in arguments], catch_exceptions=False)
    assert done.exit_code == exit_code, done.output
    return done.output


@pytest.fixture(scope="module", autouse=True)
def short_searches():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(searched_fit, "SEARCH_ITERATIONS", 2)
        yield


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    """A folder with general weights of `static-map`."""
    folder = tmp_path_factory.mktemp("weights")
    gridtrack(
        *("train", "static-map", f"{HALL}@0s-6s", f"{STREET}@0s-6s", "--validation", f"{HALL}@75s-80s"),
        *("--general", "--out", folder),
    )
    return folder


def test_a_general_card_has_no_place_and_names_its_training_recordings(weights):
    """No map, no grid and no period; the ranges of cell and period."""
    card = read_card(weights / "static-map" / "general.toml")
    assert card.general
    assert (card.grid, card.period_s, card.world_T_grid) == ("", None, None)
    assert card.cells_m == (0.1, 0.2)
    assert card.periods_s == (0.1, 0.125)
    assert "--general" in card.command


@pytest.fixture(scope="module")
def elsewhere(tmp_path_factory):
    """A recording of a site that nobody has weights for, without a validation stretch."""
    path = tmp_path_factory.mktemp("elsewhere") / "yard.mcap"
    gridtrack("recording", "import", HALL, "--site", "yard", "--stretch", "all=0s-126s", "--out", path)
    return path


def compared(recording, weights, out, *trackers, exit_code=0):
    named = [part for tracker in trackers for part in ("--tracker", tracker)]
    options = ("--weights", weights, "--every", "2s", "--out", out)
    text = gridtrack("compare", "--no-floors", recording, *named, *options, exit_code=exit_code)
    summary = json.loads((out / "summary.json").read_text())
    return text, {label: next(iter(row["recordings"].values())) for label, row in summary["trackers"].items()}


def test_general_weights_are_used_where_the_site_has_none_and_the_table_says_so(weights, elsewhere, tmp_path):
    rows = ("static-map", "own=static-map:card=site")
    text, found = compared(f"{elsewhere}@90s-98s", weights, tmp_path, *rows, exit_code=3)
    assert (found["static-map"]["outcome"], found["static-map"]["card"]) == ("ok", "general")
    assert found["own"]["outcome"] == "untrained"
    assert "general: static-map" in text


def test_a_recording_without_a_validation_stretch_has_the_thresholds_of_the_card(weights, elsewhere, tmp_path):
    _, found = compared(f"{elsewhere}@90s-98s", weights, tmp_path, "static-map", "blank")
    assert found["static-map"]["threshold_chosen_on"] == "the card static-map/general.toml"
    assert found["blank"]["threshold_chosen_on"] == ""
    outcome = json.loads((tmp_path / "static-map@yard@90s-98s" / "outcome.json").read_text())
    visible = outcome["thresholds"]["values"]["visible"]
    card = read_card(weights / "static-map" / "general.toml").thresholds
    assert visible[10] == pytest.approx(card.values["visible"][10]) != 0.5


def test_weights_of_the_site_and_general_ones_are_two_rows_on_request(weights, tmp_path):
    _, found = compared(
        f"{HALL}@90s-98s", weights, tmp_path, "site=static-map:card=site", "general=static-map:card=general"
    )
    assert {label: row["card"] for label, row in found.items()} == {"site": "site", "general": "general"}


def test_a_row_of_an_unknown_kind_of_weights_is_refused(weights, tmp_path):
    with pytest.raises(ConfigurationError, match="card=mine; expected any, site, general"):
        compared(HALL, weights, tmp_path, "static-map:card=mine")


def test_recordings_of_unlike_places_are_refused_without_the_option(tmp_path):
    with pytest.raises(WeightsError, match="or for any place with --general"):
        gridtrack("train", "static-map", f"{HALL}@0s-6s", f"{STREET}@0s-6s", "--validation", HALL, "--out", tmp_path)


SEARCHED = dict.fromkeys(
    ("birth_probability", "free_decay_s", "birth_speed", "acceleration", "position_noise_m", "start_stop_speed"), 0.05
) | {"occupied_mass": 0.91, "free_mass": 0.81, "time_to_start_s": 20, "time_to_stop_s": 5, "free_decay_s": 2}
"""A value for every setting of `dogma` that is searched: nothing is left to search."""
TEN_SECONDS = (f"{HALL}@0s-10s", "--validation", f"{HALL}@75s-80s", "--seed", "4")


@pytest.fixture(scope="module")
def general_dogma(tmp_path_factory):
    """A folder with general weights of `dogma`, not searched, with few particles."""
    folder = tmp_path_factory.mktemp("dogma")
    options = ",".join(f"{key}={value}" for key, value in (SEARCHED | {"particles": 300}).items())
    gridtrack(
        *("train", f"dogma:{options}", f"{HALL}@20s-30s", f"{STREET}@0s-10s", "--validation", f"{STREET}@20s-26s"),
        *("--general", "--out", folder),
    )
    return folder


@pytest.fixture(scope="module")
def dogma_of_the_hall(general_dogma, tmp_path_factory):
    """The folder, the output and the card of a training on ten seconds of the hall, from the general weights."""
    folder = tmp_path_factory.mktemp("hall")
    text = gridtrack("train", "dogma:acceleration=0.3", *TEN_SECONDS, "--weights", general_dogma, "--out", folder)
    return folder, text, read_card(folder / "dogma" / "leg_tracker.toml")


def test_a_training_at_a_site_starts_from_the_general_weights_and_says_so(general_dogma, dogma_of_the_hall):
    """Settings that are not searched are theirs, options are the user's; the place is learned there."""
    folder, text, card = dogma_of_the_hall
    general = general_dogma / "dogma" / "general.toml"
    assert (card.started_from.name, card.started_from.sha256) == ("dogma/general.toml", sha256_of(general))
    assert "starts from the general weights dogma/general.toml" in text
    assert (card.settings["particles"], card.settings["acceleration"]) == (300, 0.3)
    assert (card.site, card.grid) == ("leg_tracker", "100x0.1@-2,-4.5")
    assert shlex.split(card.command)[-4:] == ["--weights", str(general_dogma), "--out", str(folder)]


def test_a_card_names_the_training_recordings_of_its_general_weights(dogma_of_the_hall, tmp_path):
    """So that nothing of it is scored with the weights of the site."""
    folder, _, card = dogma_of_the_hall
    assert [data.recording for data in card.train] == [
        "leg_tracker.mcap@0s-10s", "leg_tracker.mcap@20s-30s", "validation.tracks@0s-10s",
    ]  # fmt: skip
    with pytest.raises(ConfigurationError, match="was trained on frames of the test stretch"):
        compared(f"{HALL}@20s-32s", folder, tmp_path, "dogma")


def test_a_general_training_goes_on_from_general_weights_that_are_named(general_dogma, tmp_path):
    """With recordings of further places: earlier training recordings stay on the card."""
    text = gridtrack(
        *("train", "dogma:acceleration=0.3", f"{HALL}@30s-40s", f"{STREET}@10s-20s"),
        *("--validation", f"{STREET}@20s-26s", "--general", "--weights", general_dogma, "--out", tmp_path),
    )
    card = read_card(tmp_path / "dogma" / "general.toml")
    assert "starts from the general weights dogma/general.toml" in text
    assert card.general
    assert card.started_from.sha256 == sha256_of(general_dogma / "dogma" / "general.toml")
    assert (card.settings["particles"], card.settings["acceleration"]) == (300, 0.3)
    assert [data.recording for data in card.train] == [
        "leg_tracker.mcap@30s-40s", "validation.tracks@10s-20s",
        "leg_tracker.mcap@20s-30s", "validation.tracks@0s-10s",
    ]  # fmt: skip
    assert shlex.split(card.command)[-5:] == ["--general", "--weights", str(general_dogma), "--out", str(tmp_path)]


def test_without_general_weights_a_training_is_from_scratch_and_its_command_says_so(tmp_path, monkeypatch):
    monkeypatch.setattr("gridtrack.evaluation.runs.learned._folders", lambda override: iter(()))
    options = ",".join(f"{key}={value}" for key, value in (SEARCHED | {"particles": 200}).items())
    text = gridtrack("train", f"dogma:{options}", *TEN_SECONDS, "--out", tmp_path)
    card = read_card(tmp_path / "dogma" / "leg_tracker.toml")
    assert "from scratch: there are no general weights of dogma" in text
    assert card.started_from is None
    assert "--from-scratch" in shlex.split(card.command)


def test_general_weights_that_learned_from_the_validation_stretch_are_refused(general_dogma, tmp_path):
    with pytest.raises(ConfigurationError, match=r"was trained on leg_tracker\.mcap@20s-30s.*--from-scratch"):
        gridtrack(
            *("train", "dogma", f"{HALL}@0s-10s", "--validation", f"{HALL}@25s-31s", "--weights", general_dogma),
            *("--out", tmp_path),
        )
