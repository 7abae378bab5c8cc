"""`gridtrack compare BAG` of a robot that drives: two scanners, /tf and /tf_static, and no option about poses."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from scenes import drive_bag as made

CHAINS = (
    "poses: front_scan: odom -> base_footprint -> base_link -> front_laser; rear_scan: odom -> base_footprint ->"
    " base_link -> rear_laser (mirrored); from /tf, /tf_static; longest gap 0.02 s"
)
INCOMPLETE = 3
"""Exit code where a tracker has no weights for the place."""


def assert_scored(summary: dict[str, Any], tracker: str) -> None:
    (trial,) = summary["trackers"][tracker]["recordings"].values()
    assert trial["outcome"] == "ok"
    assert trial["frames_scored"] == trial["frames_expected"] > 5


@pytest.mark.parametrize("version", [1, 2])
def test_a_drive_is_compared_without_an_option_about_poses(
    tmp_path: Path, version: int, gridtrack: Any, trackers_here: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    ros = made.Ros(version)
    ros.write(tmp_path / "drive.bag", made.two_scanner_drive(ros, 12_000))
    # A ROS 1 bag with every tracker that there is; most have no weights for the place.
    trackers = () if version == 1 else ("--tracker", "persistence", "--tracker", "blank")
    done = gridtrack("compare", "drive.bag", *trackers)
    assert done.code in ((0, INCOMPLETE) if version == 1 else (0,)), done.err
    assert f"drive.bag: {CHAINS}\n" in done.err
    summary = json.loads((tmp_path / "runs" / "latest" / "summary.json").read_text())
    for tracker in ("persistence", "blank"):
        assert_scored(summary, tracker)
