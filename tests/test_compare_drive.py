"""`gridtrack compare BAG` of a robot that drives: two scanners, /tf and /tf_static, and no option about poses."""

import json

import pytest

from scenes import drive_bag as made
from scenes.command_line import gridtrack

CHAINS = (
    "poses: front_scan: odom -> base_footprint -> base_link -> front_laser; rear_scan: odom -> base_footprint ->"
    " base_link -> rear_laser (mirrored); from /tf, /tf_static; longest gap 0.02 s"
)


def assert_scored(summary, tracker):
    (trial,) = summary["trackers"][tracker]["recordings"].values()
    assert trial["outcome"] == "ok"
    assert trial["frames_scored"] == trial["frames_expected"] > 3


@pytest.mark.usefixtures("trackers_here")
@pytest.mark.parametrize("version", [1, 2])
def test_a_drive_is_compared_without_an_option_about_poses(tmp_path, monkeypatch, version):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    ros = made.Ros(version)
    ros.write(tmp_path / "drive.bag", made.two_scanner_drive(ros, 6_000))
    # A ROS 1 bag with every tracker that there is, with general weights where it needs any.
    trackers = () if version == 1 else ("--no-floors", "--tracker", "persistence", "--tracker", "blank")
    shown = gridtrack("compare", "drive.bag", *trackers, "--every", "0.5s", "--horizon", "0.5s").stderr
    assert CHAINS not in shown, "normal poses are no notice"
    assert CHAINS in gridtrack("recording", "info", "drive.bag").stdout
    (path,) = tmp_path.glob("runs/*/summary.json")
    summary = json.loads(path.read_text())
    for tracker in ("persistence", "blank"):
        assert_scored(summary, tracker)
