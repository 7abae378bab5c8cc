"""A tracker is not scored on frames that it learned from, under whatever name or cut they come."""

from __future__ import annotations

import tomllib
from dataclasses import replace

import pytest
import tomli_w
from typer.testing import CliRunner

from gridtrack.cli import app
from gridtrack.common.errors import ConfigurationError
from gridtrack.evaluation.runs.recipe import Recipe
from gridtrack.evaluation.runs.summary import read_summary
from gridtrack.evaluation.runs.train import train_tracker
from gridtrack.evaluation.runs.trial_record import read_trial_record
from gridtrack.recordings import RecordingInfo, import_recording, write_native
from gridtrack.recordings.stretches import WALL_CLOCK_FROM_NS
from tests.evaluation.conftest import RATE_HZ, SECONDS, scan


@pytest.fixture
def room(record, tmp_path, monkeypatch):
    """A recording, with `static-map` trained on its stretch `train`, 0 s to 4 s."""
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "home"))
    path = record()
    train_tracker(Recipe(tracker="static-map", recordings=(str(path),), out=tmp_path / "weights"), lambda text: None)
    return path


@pytest.fixture
def compare(room, tmp_path):
    """`compare(recording, *options)` runs the command line on it with the weights of `room`; its output."""

    def compare(recording, *options):
        command = [
            "compare",
            str(recording),
            "--horizon",
            "0.5s",
            "--jobs",
            "1",
            "--weights",
            str(tmp_path / "weights"),
        ]
        command += ["--weights", str(tmp_path / "weights"), "--tracker", "static-map", "--tracker", "persistence"]
        command += ["--out", str(tmp_path / "run"), *options]
        return CliRunner().invoke(app, command, catch_exceptions=False).output

    return compare


def test_frames_of_the_training_are_refused_under_another_name_and_cut(room, compare, tmp_path):
    other = import_recording(room, tmp_path / "renamed.mcap", site="room", stretches={"busy": (2.0, 12.0)})
    assert other.sha256 != read_training(tmp_path)["sha256"]
    with pytest.raises(ConfigurationError) as refused:
        compare(f"{other.path}@busy")
    assert "static-map/room.toml was trained on frames of the test stretch renamed.mcap@busy" in str(refused.value)
    assert "2 s to 4 s (stamps 1002000000000 to 1004000000000), as room.mcap@train" in str(refused.value)
    assert "--allow-leak" in str(refused.value)
    assert "\n" not in str(refused.value)
    assert not (tmp_path / "run").exists()


def test_frames_of_the_training_are_refused_in_the_source_that_was_imported(room, compare, tmp_path):
    imported = import_recording(room, tmp_path / "imported.mcap", site="room").path
    train_tracker(
        Recipe(
            tracker="static-map",
            recordings=(f"{imported}@10s-20s",),
            validation=(f"{imported}@0s-9s",),
            out=tmp_path / "weights",
        ),
        lambda text: None,
    )
    with pytest.raises(ConfigurationError, match=r"of the test stretch room\.mcap@test, 10 s to 20 s"):
        compare(room)


def test_other_frames_of_the_same_source_are_scored(compare, room, tmp_path):
    other = import_recording(room, tmp_path / "renamed.mcap", site="room").path
    compare(f"{other}@9s-")
    assert read_trial_record(tmp_path / "run" / "static-map@renamed@9s-").leak == ""


def test_frames_that_thresholds_are_chosen_on_are_refused_where_they_were_learned_from(compare, room):
    with pytest.raises(ConfigurationError, match=r"trained on frames of the stretch that thresholds are chosen on"):
        compare(f"{room}@9s-", "--validation", f"{room}@0s-4s")


def test_frames_that_weights_were_selected_on_are_refused(compare, room):
    with pytest.raises(ConfigurationError, match=r"selected on frames of the test stretch room\.mcap@5s-, 5 s to 9 s"):
        compare(f"{room}@5s-", "--validation", f"{room}@0s-4s")


def test_an_allowed_leak_is_marked_in_table_summary_record_and_page_and_is_not_ranked(compare, room, tmp_path):
    output = compare(f"{room}@0s-9s", "--allow-leak")
    assert "| static-map (ok, learned from these frames) |" in output
    run = tmp_path / "run"
    found = read_summary(run)
    assert "static-map/room.toml was trained on frames" in found.trackers["static-map"].recordings["room@0s-9s"].leak
    (difference,) = found.differences
    assert difference.interval == "not compared: static-map learned from frames that it is scored on"
    assert not difference.headline
    assert any(notice.startswith("static-map is not ranked: ") for notice in found.notices)
    assert read_trial_record(run / "static-map@room@0s-9s").leak
    assert read_trial_record(run / "persistence@room@0s-9s").leak == ""
    page = (run / "report" / "index.html").read_text()
    assert '<span class="tag outcome">ok, learned from these frames</span>' in page
    assert "No tracker is ranked on room@0s-9s: each learned from its frames, or did not complete it." in page
    floor = page.split('<tbody class="floor">')[1].split("</tbody>")[0]
    assert "persistence" in floor
    assert "static-map" not in floor


def test_a_card_of_an_earlier_version_is_compared_by_the_hash_and_the_seconds(room, compare, tmp_path):
    path = tmp_path / "weights" / "static-map" / "room.toml"
    card = tomllib.loads(path.read_text())
    for data in (*card["train"], *card["validation"]):
        for key in ("source_sha256", "start_ns", "end_ns"):
            del data[key]
    path.write_text(tomli_w.dumps(card))
    imported = import_recording(room, tmp_path / "imported.mcap", site="room").path
    with pytest.raises(ConfigurationError, match=r"imported\.mcap@2s-9s, 2 s to 4 s"):
        compare(f"{imported}@2s-9s")


def test_frames_of_another_site_at_the_same_time_of_the_day_are_no_leak(tmp_path, compare):
    """General weights, and those of a site that started from them, learned at many sites: on one day, it may be."""
    yard, hall = (recorded_today(tmp_path / f"{site}.mcap", site) for site in ("yard", "hall"))
    weights = tmp_path / "weights"
    general = Recipe(
        tracker="static-map",
        recordings=(f"{yard}@0s-10s",),
        validation=(f"{yard}@10s-20s",),
        general=True,
        out=weights,
    )
    path = train_tracker(general, lambda text: None)
    card = tomllib.loads(path.read_text())
    assert [data["site"] for data in (*card["train"], *card["validation"])] == ["yard", "yard"]
    compare(f"{hall}@2s-9s")
    record = read_trial_record(tmp_path / "run" / "static-map@hall@2s-9s")
    assert (record.outcome, record.card, record.leak) == ("ok", "general", "")
    second_laser = import_recording(hall, tmp_path / "second.mcap", site="yard").path
    with pytest.raises(
        ConfigurationError, match=r"trained on frames of the test stretch second\.mcap@2s-9s, 2 s to 9 s"
    ):
        compare(f"{second_laser}@2s-9s", "--resume")
    for data in (*card["train"], *card["validation"]):
        del data["site"]
    path.write_text(tomli_w.dumps(card))
    with pytest.raises(ConfigurationError, match=r"trained on frames of the test stretch hall\.mcap@2s-9s, 2 s to 9 s"):
        compare(f"{hall}@2s-9s", "--resume")


def recorded_today(path, site):
    """A recording like that of `record`, at its own site, with stamps that are times of the day."""
    info = RecordingInfo(site=site, grid="40x0.2@-1,-4", rate_hz=RATE_HZ, stretches={})
    wall_m = 3.0 if site == "yard" else 2.5
    scans = (scan(index, wall_m=wall_m) for index in range(SECONDS * RATE_HZ))
    with path.open("wb") as file:
        write_native(file, info, (replace(one, stamp_ns=one.stamp_ns + WALL_CLOCK_FROM_NS) for one in scans))
    return path


def test_a_tracker_that_names_no_training_data_on_its_card_cannot_hide_it(record, tmp_path, install):
    module = """
from gridtrack.trackers.baselines import PersistenceTracker
from gridtrack.trackers.training.card import card_for
from gridtrack.trackers.training.weights import save_weights


class Secretive(PersistenceTracker):
    learns = True

    @classmethod
    def fit(cls, task):
        card = card_for("secretive", task, {})
        save_weights(task.out, card.model_copy(update={"train": (), "validation": ()}), {})
"""
    install("secretive", {"secretive": "secretive:Secretive"}, {"secretive.py": module})
    path = train_tracker(
        Recipe(tracker="secretive", recordings=(str(record()),), out=tmp_path / "weights"), lambda text: None
    )
    card = tomllib.loads(path.read_text())
    assert [data["recording"] for data in (*card["train"], *card["validation"])] == [
        "room.mcap@train",
        "room.mcap@validation",
    ]


def read_training(tmp_path):
    return tomllib.loads((tmp_path / "weights" / "static-map" / "room.toml").read_text())["train"][0]
