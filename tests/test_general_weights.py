"""General weights: trained on recordings of unlike places, used where there are none of the site, and named so."""

from __future__ import annotations

import json

import pytest
from typer.testing import CliRunner

from gridtrack.cli import app
from gridtrack.common.errors import ConfigurationError, WeightsError
from gridtrack.recordings import packaged_recording
from gridtrack.trackers.weights import read_card

HALL = str(packaged_recording("leg_tracker"))
"""A hall, in cells of 0.1 m at 10 Hz."""
STREET = str(packaged_recording("junction/validation"))
"""A junction, in cells of 0.2 m at 8 Hz."""


def gridtrack(*arguments: object, exit_code: int = 0) -> str:
    done = CliRunner().invoke(app, [str(argument) for argument in arguments], catch_exceptions=False)
    assert done.exit_code == exit_code, done.output
    return done.output


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    """A folder with general weights of `static-map`."""
    folder = tmp_path_factory.mktemp("weights")
    gridtrack(
        *("train", "static-map", f"{HALL}@0s-20s", f"{STREET}@0s-20s", "--validation", f"{HALL}@75s-81s"),
        *("--general", "--out", folder),
    )
    return folder


def test_a_general_card_has_no_place_and_says_what_it_was_trained_on(weights):
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
    text = gridtrack("compare", recording, *named, *options, exit_code=exit_code)
    summary = json.loads((out / "summary.json").read_text())
    return text, {label: next(iter(row["recordings"].values())) for label, row in summary["trackers"].items()}


def test_general_weights_are_used_where_the_site_has_none_and_the_table_says_so(weights, elsewhere, tmp_path):
    rows = ("static-map", "own=static-map:card=site")
    text, found = compared(f"{elsewhere}@90s-110s", weights, tmp_path, *rows, exit_code=3)
    assert (found["static-map"]["outcome"], found["static-map"]["card"]) == ("ok", "general")
    assert found["own"]["outcome"] == "untrained"
    assert "static-map (general)" in text


def test_a_recording_without_a_validation_stretch_has_the_thresholds_of_the_card(weights, elsewhere, tmp_path):
    _, found = compared(f"{elsewhere}@90s-110s", weights, tmp_path, "static-map", "blank")
    assert found["static-map"]["threshold_chosen_on"] == "the card static-map/general.toml"
    assert found["blank"]["threshold_chosen_on"] == ""
    outcome = json.loads((tmp_path / "static-map@yard@90s-110s" / "outcome.json").read_text())
    visible = outcome["thresholds"]["values"]["visible"]
    card = read_card(weights / "static-map" / "general.toml").thresholds
    assert visible[10] == pytest.approx(card.values["visible"][10]) != 0.5


def test_weights_of_the_site_and_general_ones_are_two_rows_on_request(weights, tmp_path):
    _, found = compared(
        f"{HALL}@90s-110s", weights, tmp_path, "site=static-map:card=site", "general=static-map:card=general"
    )
    assert {label: row["card"] for label, row in found.items()} == {"site": "site", "general": "general"}


def test_a_row_of_an_unknown_kind_of_weights_is_refused(weights, tmp_path):
    with pytest.raises(ConfigurationError, match="card=mine; expected any, site, general"):
        compared(HALL, weights, tmp_path, "static-map:card=mine")


def test_recordings_of_unlike_places_are_refused_without_the_option(tmp_path):
    with pytest.raises(WeightsError, match="or for any place with --general"):
        gridtrack("train", "static-map", f"{HALL}@0s-20s", f"{STREET}@0s-20s", "--validation", HALL, "--out", tmp_path)
