"""A tracker is not scored on frames that it learned from, under whatever name or range."""

from __future__ import annotations

import tomllib

import pytest
import tomli_w
from typer.testing import CliRunner

from gridtrack.cli import app
from gridtrack.common.errors import ConfigurationError
from gridtrack.evaluation.runs.summary import read_summary
from gridtrack.evaluation.runs.trial_record import read_trial_record
from gridtrack.recordings import import_recording
from gridtrack.recordings.stretches import WALL_CLOCK_FROM_NS
from gridtrack.trackers.training.weights import read_card

pytestmark = pytest.mark.usefixtures("home", "trackers_here")


@pytest.fixture
def room(record, train):
    """A recording, with `static-map` trained on its stretch `train`, 0 s to 4 s."""
    train("weights")
    return record()


@pytest.fixture
def compare(tmp_path):
    """`compare(recording, *options)` runs the command line on it with the trained weights; its output."""

    def compare(recording, *options):
        folders = ["--out", str(tmp_path / "run"), "--weights", str(tmp_path / "weights")]
        rows = ["--tracker", "static-map", "--tracker", "persistence", "--no-floors"]
        command = ["compare", str(recording), "--horizon", "0.5s", "--jobs", "1", *folders, *rows, *options]
        return CliRunner().invoke(app, command, catch_exceptions=False).output

    return compare


def test_frames_of_the_training_are_refused_under_another_name_and_range(room, compare, tmp_path):
    other = import_recording(room, tmp_path / "renamed.mcap", site="room", stretches={"busy": (2.0, 12.0)})
    card = tmp_path / "weights" / "static-map" / "room.toml"
    assert other.sha256 != read_card(card).train[0].sha256
    with pytest.raises(ConfigurationError) as refused:
        compare(f"{other.path}@busy")
    assert "static-map/room.toml was trained on frames of the test stretch renamed.mcap@busy" in str(refused.value)
    assert "2 s to 4 s (stamps 1002000000000 to 1004000000000), as room.mcap@train" in str(refused.value)
    assert "--allow-leak" in str(refused.value)
    assert "\n" not in str(refused.value)
    assert not (tmp_path / "run").exists()
    compare(f"{other.path}@9s-")
    record = read_trial_record(tmp_path / "run" / "static-map@renamed@9s-")
    assert (record.outcome, record.leak) == ("ok", ""), "other frames of the same source are scored"
    content = tomllib.loads(card.read_text())
    for data in (*content["train"], *content["validation"]):
        for key in ("source_sha256", "start_ns", "end_ns"):
            del data[key]
    card.write_text(tomli_w.dumps(content))
    copy = import_recording(room, tmp_path / "copy.mcap", site="room").path
    with pytest.raises(ConfigurationError, match=r"copy\.mcap@2s-9s, 2 s to 4 s"):
        compare(f"{copy}@2s-9s")  # a card of an earlier version is compared by the hash and the seconds


def test_frames_of_the_training_are_refused_in_the_source_that_was_imported(record, train, compare, tmp_path):
    room = record()
    imported = import_recording(room, tmp_path / "imported.mcap", site="room").path
    train("weights", "static-map", f"{imported}@10s-20s", validation=(f"{imported}@0s-9s",))
    with pytest.raises(ConfigurationError, match=r"of the test stretch room\.mcap@test, 10 s to 20 s"):
        compare(room)


def test_frames_that_thresholds_or_weights_are_chosen_on_are_refused(room, compare):
    with pytest.raises(ConfigurationError, match=r"trained on frames of the stretch that thresholds are chosen on"):
        compare(f"{room}@9s-", "--validation", f"{room}@0s-4s")
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
    assert not difference.tests
    assert any("static-map on " in notice and ": not ranked: " in notice for notice in map(str, found.notices))
    assert read_trial_record(run / "static-map@room@0s-9s").leak
    assert read_trial_record(run / "persistence@room@0s-9s").leak == ""
    page = (run / "report" / "index.html").read_text()
    assert '<span class="tag outcome">ok, learned from these frames</span>' in page
    assert "No tracker is ranked on room@0s-9s: each learned from its frames, or did not complete it." in page
    floor = page.split('<tbody class="floor">')[1].split("</tbody>")[0]
    assert "persistence" in floor
    assert "static-map" not in floor


def test_frames_of_another_site_at_the_same_time_of_the_day_are_no_leak(record, train, tmp_path, compare):
    """General weights, and a site's weights that started from them, learned at many sites, maybe on one day."""
    today = {"stretches": {}, "shift_ns": WALL_CLOCK_FROM_NS}
    yard, hall = (record(site, wall_m=m, site=site, **today) for site, m in (("yard", 3.0), ("hall", 2.5)))
    path = train("weights", "static-map", f"{yard}@0s-10s", validation=(f"{yard}@10s-20s",), general=True)
    card = tomllib.loads(path.read_text())
    assert [data["site"] for data in (*card["train"], *card["validation"])] == ["yard", "yard"]
    compare(f"{hall}@2s-9s")
    found = read_trial_record(tmp_path / "run" / "static-map@hall@2s-9s")
    assert (found.outcome, found.card, found.leak) == ("ok", "general", "")
    second_laser = import_recording(hall, tmp_path / "second.mcap", site="yard").path
    message = r"trained on frames of the test stretch {}\.mcap@2s-9s, 2 s to 9 s"
    with pytest.raises(ConfigurationError, match=message.format("second")):
        compare(f"{second_laser}@2s-9s", "--resume")
    for data in (*card["train"], *card["validation"]):
        del data["site"]
    path.write_text(tomli_w.dumps(card))
    with pytest.raises(ConfigurationError, match=message.format("hall")):
        compare(f"{hall}@2s-9s", "--resume")


def test_a_tracker_that_names_no_training_data_on_its_card_cannot_hide_it(train, install):
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
    card = read_card(train("weights", "secretive"))
    named = [data.recording for data in (*card.train, *card.validation)]
    assert named == ["room.mcap@train", "room.mcap@validation"]
