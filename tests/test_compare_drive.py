"""`gridtrack compare BAG` of a robot that drives: two scanners, /tf and /tf_static, and no option about poses."""

from __future__ import annotations

import json
import os
import subprocess
import sys
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


def compared(folder: Path, *arguments: str, codes: tuple[int, ...] = (0,)) -> tuple[str, dict[str, Any]]:
    """Standard error and the summary of `gridtrack compare` in a folder; the run is the one that it made there."""
    command = [sys.executable, "-m", "gridtrack.cli", "compare", *arguments]
    environment = {**os.environ, "XDG_DATA_HOME": str(folder)}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode in codes, done.stderr
    (summary,) = folder.glob("runs/*/summary.json")
    return done.stderr, json.loads(summary.read_text())


def assert_scored(summary: dict[str, Any], tracker: str) -> None:
    (trial,) = summary["trackers"][tracker]["recordings"].values()
    assert trial["outcome"] == "ok"
    assert trial["frames_scored"] == trial["frames_expected"] > 5


@pytest.mark.parametrize("version", [1, 2])
def test_a_drive_is_compared_without_an_option_about_poses(tmp_path: Path, version: int) -> None:
    ros = made.Ros(version)
    ros.write(tmp_path / "drive.bag", made.two_scanner_drive(ros, 12_000))
    # A ROS 1 bag with every tracker that there is; most have no weights for the place.
    trackers = () if version == 1 else ("--tracker", "persistence", "--tracker", "blank")
    said, summary = compared(tmp_path, "drive.bag", *trackers, codes=(0, INCOMPLETE) if version == 1 else (0,))
    assert f"drive.bag: {CHAINS}\n" in said
    for tracker in ("persistence", "blank"):
        assert_scored(summary, tracker)
