"""The nursery: a forked tracker finds itself as a started one, and its end costs no trial."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import psutil
import pytest

from gridtrack.common.grid import GridSpec
from gridtrack.evaluation.hosting.limits import Limits
from gridtrack.evaluation.hosting.nursery import SUPERVISOR, end_nursery
from gridtrack.evaluation.hosting.tracker_process import TrackerProcess
from gridtrack.trackers.contract import StreamSpec
from gridtrack.trackers.selection import launch

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="trackers are forked on Linux only")
PLUGIN = Path(__file__).parents[2] / "plugins" / "mirror.py"
STREAM = StreamSpec(GridSpec(20, 0.2), 0.125)
FORKED, STARTED = Limits(threads=1), Limits(threads=2)
"""With several threads a tracker is started as a new program."""


@pytest.fixture(autouse=True)
def mirror(install: Any) -> Any:
    """The tracker `mirror`, and no nursery before and after the test."""
    install("mirror", {"mirror": "mirror:Mirror"}, {PLUGIN.name: PLUGIN.read_text()})
    end_nursery()
    yield
    end_nursery()


def found_by(limits: Limits, tmp_path: Path) -> dict[str, Any]:
    """The state in which the tracker finds its process."""
    found = tmp_path / "found.json"
    with TrackerProcess(launch("mirror"), STREAM, {"found": str(found)}, limits, tmp_path / "log") as tracker:
        tracker.reset(0)
    return dict(json.loads(found.read_text()))


def nurseries() -> list[psutil.Process]:
    """The nurseries of this process that are alive."""
    children = (child for child in psutil.Process().children() if child.status() != psutil.STATUS_ZOMBIE)
    return [child for child in children if str(SUPERVISOR) in child.cmdline()]


def test_a_forked_tracker_finds_its_process_as_a_started_one_does(tmp_path, monkeypatch):
    monkeypatch.setenv("SOMETHING", "before")
    found_by(FORKED, tmp_path)
    monkeypatch.setenv("SOMETHING", "after")
    monkeypatch.chdir(tmp_path)
    forked, started = found_by(FORKED, tmp_path), found_by(STARTED, tmp_path)
    assert "SOMETHING" not in forked.pop("first environment")
    assert "SOMETHING=after" in started.pop("first environment")
    assert forked["environment"]["SOMETHING"] == "after"
    assert forked["environment"].pop("TMPDIR") != started["environment"].pop("TMPDIR")
    assert forked.pop("random") != started.pop("random")
    assert forked == started


def test_trackers_come_from_one_nursery_and_have_own_random_numbers(tmp_path):
    first = found_by(FORKED, tmp_path)
    (nursery,) = nurseries()
    second = found_by(FORKED, tmp_path)
    assert nurseries() == [nursery]
    assert first["random"] != second["random"]


def test_without_its_nursery_a_trial_goes_on_and_the_next_tracker_starts(tmp_path):
    options = {"found": str(tmp_path / "found.json")}
    with TrackerProcess(launch("mirror"), STREAM, options, FORKED, tmp_path / "log") as tracker:
        (nursery,) = nurseries()
        nursery.kill()
        nursery.wait(10)
        tracker.reset(0)
        assert found_by(FORKED, tmp_path)["arguments"] == ["mirror"]
    assert tracker.peak_rss_mb > 1


def test_an_interrupted_start_leaves_no_answer_for_the_next_one(tmp_path, monkeypatch):
    found_by(FORKED, tmp_path)
    with monkeypatch.context() as patch:
        patch.setattr("socket.recv_fds", interrupt)
        with pytest.raises(KeyboardInterrupt):
            found_by(FORKED, tmp_path)
    assert nurseries() == []
    assert found_by(FORKED, tmp_path)["arguments"] == ["mirror"]


def interrupt(*_: Any) -> None:
    raise KeyboardInterrupt


def test_variables_of_loading_have_a_nursery_of_their_own(tmp_path, monkeypatch):
    found_by(FORKED, tmp_path)
    before = nurseries()
    monkeypatch.setenv("PYTHONUTF8", "1")
    assert "PYTHONUTF8=1" in found_by(FORKED, tmp_path)["first environment"]
    assert len(nurseries()) == 1
    assert nurseries() != before
