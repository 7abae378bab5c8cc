"""`--ego-motion kiss-icp` of a comparison and a training: poses from the scans of a recording that has none."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from gridtrack.common.errors import ConfigurationError, RecordingError
from gridtrack.common.files import sha256_of
from gridtrack.evaluation.runs.plan import ComparisonPlan, resolve
from gridtrack.evaluation.runs.recipe import Recipe
from gridtrack.evaluation.runs.settings import CompareSettings
from gridtrack.evaluation.runs.train import _named
from gridtrack.recordings import open_recording

from scenes import drive_bag as made

ROS = made.Ros(1)
pytest.importorskip("kiss_icp")


@pytest.fixture
def drive(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A bag of a drive without its poses; copies of recordings are kept in the folder of the test."""
    monkeypatch.setattr("gridtrack.recordings.importing.user_cache_folder", lambda: tmp_path / "cache")
    return ROS.write(tmp_path / "drive.bag", made.scans_of(ROS, 6000, made.FRONT))


def planned(drive: Path | str, notes: list[str], **given: object) -> ComparisonPlan:
    values = {"recordings": [str(drive)], "trackers": ["persistence"], "horizon_s": 1.0, "ego_motion": "kiss-icp"}
    return resolve(CompareSettings.model_validate(values | given), note=notes.append)


def test_the_poses_are_taken_from_the_scans_once(drive: Path) -> None:
    notes: list[str] = []
    plan, again = planned(drive, notes), planned(f"{drive}@0s-5s", notes)
    assert notes == [f"{drive}: taking the poses from the scans (--ego-motion kiss-icp)"]
    (split,), (part,) = plan.splits, again.splits
    assert (split.name, split.test.site, part.name) == ("drive", "drive", "drive@0s-5s")
    assert split.test.recording.survey.moves
    assert not open_recording(drive).survey.moves
    assert split.test.recorded.source_sha256 == sha256_of(drive)
    assert any("poses: kiss-icp: scans of 'front_scan' matched" in notice.text for notice in plan.notices)
    assert planned(split.path, notes).splits[0].path == split.path


def test_a_changed_file_is_matched_again(drive: Path) -> None:
    notes: list[str] = []
    before = planned(drive, notes).splits[0].path
    ROS.write(drive.with_name("other.bag"), made.scans_of(ROS, 5000, made.FRONT)).replace(drive)
    assert planned(drive, notes).splits[0].path != before
    assert len(notes) == 2


def test_a_run_says_the_source_of_the_poses_and_resumes_with_the_same(
    drive: Path, tmp_path: Path, gridtrack, trackers_here
) -> None:
    asked = ("--no-floors", "--tracker", "persistence", "--horizon", "1")
    command = ("compare", drive, *asked, "--ego-motion", "kiss-icp")
    out = tmp_path / "run"
    assert gridtrack(*command, "--out", out).code == 0
    record = json.loads((out / "run.json").read_text())
    assert record["settings"]["ego_motion"] == "kiss-icp"
    assert record["settings"]["recordings"] == [str(drive)]
    assert "kiss-icp: scans of &#39;front_scan&#39; matched" in (out / "report" / "index.html").read_text()
    assert gridtrack(*command, "--out", out, "--resume").code == 0
    assert json.loads((out / "run.json").read_text())["configuration"] == record["configuration"]


def test_a_training_takes_them_too_and_its_command_repeats_it(drive: Path) -> None:
    recipe = Recipe(tracker="x", recordings=(str(drive),), ego_motion="kiss-icp")
    ((path, stretch),) = _named((f"{drive}@0s-3s",), recipe, lambda line: None)
    assert stretch == (0.0, 3.0)
    assert open_recording(path).survey.moves
    assert recipe.command.endswith("--ego-motion kiss-icp")


def test_where_it_makes_no_sense_one_line_says_why(tmp_path: Path, drive: Path) -> None:
    with pytest.raises(ConfigurationError, match="--ego-motion matches the scans of a finished recording"):
        planned(drive, [], follow=True)
    two = ROS.write(tmp_path / "two.bag", made.scans_of(ROS, 6000, made.FRONT, made.REAR))
    with pytest.raises(RecordingError, match=r"several sensors .* with unknown mounts"):
        planned(two, [])
