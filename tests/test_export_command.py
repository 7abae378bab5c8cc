"""`gridtrack trackers export`: settings and manifest of a tracker, and refusals in one line."""

import hashlib
import json
import sys
from pathlib import Path

import pytest

from gridtrack.recordings import packaged_recording

from scenes.command_line import gridtrack

pytestmark = pytest.mark.usefixtures("trackers_here")
WEIGHTS = Path(packaged_recording("leg_tracker")).parents[1] / "weights"


@pytest.mark.parametrize("name", ["kalman", "factor-graph", "dogma"])
def test_a_tracker_without_a_network_exports_its_settings(tmp_path, name):
    card = WEIGHTS / name / "leg_tracker.toml"
    said = gridtrack("trackers", "export", f"{name}", "--weights", card, "--out", tmp_path / "out").stdout
    assert said.splitlines()[0] == "settings only: the tracker itself is Python code of gridtrack"
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["README.md", "manifest.json", "out", "settings.json"]
    manifest = json.loads((tmp_path / "out" / "manifest.json").read_text())
    assert (manifest["tracker"], manifest["site"]) == (name, "leg_tracker")
    assert manifest["card_sha256"] == hashlib.sha256(card.read_bytes()).hexdigest()
    settings = json.loads((tmp_path / "out" / "settings.json").read_text())
    assert settings


def test_general_weights_are_exported_for_a_grid_and_a_rate_and_options_replace_settings(tmp_path):
    choice = ("--weights", WEIGHTS, "--grid", "40x0.1", "--rate", "10")
    gridtrack("trackers", "export", "dogma:particles=500", *choice, "--out", tmp_path / "out")
    manifest = json.loads((tmp_path / "out" / "manifest.json").read_text())
    found = [manifest[key] for key in ("site", "size", "cell_m", "period_s", "corner_in_window_m")]
    assert found == ["general", 40, 0.1, 0.1, [-2.0, -2.0]]
    assert manifest["thresholds"]["values"]["visible"]
    assert json.loads((tmp_path / "out" / "settings.json").read_text())["particles"] == 500
    assert "learned from" in (tmp_path / "out" / "README.md").read_text()


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (("persistence",), "tracker 'persistence': export: PersistenceTracker has no export: networks with a latent"),
        (("kalman", "--weights", "nowhere"), "nowhere: no such folder of weights"),
        (("kalman", "--weights", "nowhere.toml"), "nowhere.toml: cannot be read"),
        (("kalman", "--weights", WEIGHTS / "dogma" / "general.toml"), "made for tracker dogma, but this is kalman"),
        (("dogma", "--rate", "0"), "--rate 0: it should be greater than 0"),
        (("dogma", "--weights", WEIGHTS / "dogma" / "leg_tracker.toml", "--rate", "3"), "made for a period of"),
    ],
)
def test_what_cannot_be_exported_is_refused_in_a_line_and_nothing_is_left(tmp_path, arguments, line):
    *_, last = gridtrack("trackers", "export", *arguments, "--out", tmp_path / "out", code=2).stderr.splitlines()
    assert last.startswith("gridtrack: ")
    assert line in last
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_exists_is_kept(tmp_path):
    assert "exists; choose another folder" in gridtrack("trackers", "export", "dogma", "--out", tmp_path, code=2).stderr


def test_without_the_libraries_the_line_names_the_extra(tmp_path, monkeypatch):
    pytest.importorskip("torch")
    monkeypatch.setitem(sys.modules, "onnxscript", None)
    monkeypatch.delitem(sys.modules, "gridtrack.trackers.recurrent.onnx_export", raising=False)
    said = gridtrack("trackers", "export", "deep-tracking-rnn", "--out", tmp_path / "out", code=2).stderr
    assert "pip install 'gridtrack[export]'" in said
