"""Recordings of the studies: drives with poses of each kind, drives to learn from, and recordings of real robots."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from gridtrack.common.geometry import SE2
from gridtrack.common.scan import Scan
from gridtrack.evaluation.runs.recipe import read_recipe
from gridtrack.recordings import Recording, open_recording
from gridtrack.recordings.formats.native import write_native
from gridtrack.recordings.recording_info import RecordingInfo
from gridtrack.simulation.junction import JUNCTION_SET
from gridtrack.simulation.junction.drives import DRIVE_SEEDS

from studies.drive_recordings import PAUSE_NS, TRAINING_SEEDS, VALIDATION_SEEDS, drives_in, joined, standing
from studies.real_results import REAL
from studies.support.shipped import DATA, DEMO

RECIPES = Path(__file__).parents[2] / "studies" / "recipes" / "drives"
PERIOD_NS = 125_000_000


def driving(poses: list[SE2]) -> Iterator[Scan]:
    """One scan at each pose."""
    for k, pose in enumerate(poses):
        yield Scan(k * PERIOD_NS, np.ones(4, np.float32), 0.0, 1.0, 0.1, 10.0, world_T_sensor=pose)


def recorded(path: Path, poses: list[SE2]) -> Recording:
    with path.open("wb") as file:
        write_native(file, RecordingInfo(site="here"), driving(poses))
    return open_recording(path)


def test_a_sensor_with_ignored_motion_stands_at_its_first_pose_and_is_scored_by_the_true_poses() -> None:
    true = [SE2(1.0, 2.0, 0.5), SE2(2.0, 2.0, 0.6), SE2(3.0, 2.5, 0.7)]
    scans = list(standing(driving(true)))
    assert [scan.world_T_sensor for scan in scans] == [true[0]] * 3
    assert [scan.reference_T_sensor for scan in scans] == true


def test_joined_drives_follow_each_other_after_a_pause_longer_than_a_forecast(tmp_path: Path) -> None:
    parts = [recorded(tmp_path / f"{k}.mcap", [SE2(x=10.0 * k), SE2(x=10.0 * k + 1.0)]) for k in range(2)]
    scans = list(joined(parts))
    assert [scan.stamp_ns for scan in scans] == [0, PERIOD_NS, PERIOD_NS + PAUSE_NS, 2 * PERIOD_NS + PAUSE_NS]
    assert [scan.world_T_sensor.x for scan in scans] == [0.0, 1.0, 10.0, 11.0]


def test_the_drives_of_a_folder_have_true_poses() -> None:
    drives = drives_in(DATA / "drives")
    assert len(drives) == 20
    assert drives[0] == "car-202"


def test_drives_to_learn_from_have_seeds_of_their_own() -> None:
    known = {*DRIVE_SEEDS, *(seed for _, seed, _ in JUNCTION_SET.values())}
    assert known.isdisjoint(TRAINING_SEEDS)
    assert known.isdisjoint(VALIDATION_SEEDS)
    assert set(TRAINING_SEEDS).isdisjoint(VALIDATION_SEEDS)


def test_recipes_for_drives_train_and_validate_on_the_seeds_that_are_simulated_for_that() -> None:
    recipes = [read_recipe(path) for path in RECIPES.glob("*.toml")]
    assert recipes
    for recipe in recipes:
        assert {seed_of(text) for text in recipe.recordings} <= set(TRAINING_SEEDS)
        assert {seed_of(text) for text in recipe.validation} <= set(VALIDATION_SEEDS)


def seed_of(recording: str) -> int:
    """`runs/drives/training/car-302-beside.tracks@15s-45s` has the seed 302."""
    return int(Path(recording).stem.split("-")[1].partition(".")[0])


def test_the_window_of_corridor_is_the_shipped_parts() -> None:
    (corridor,) = (one for one in REAL if one.name == "corridor")
    assert corridor.grid == open_recording(DEMO).info.grid


def test_a_laser_that_moves_is_in_the_middle_of_its_window() -> None:
    middles = {one.name: f"100x{one.cell_m:g}@-{50 * one.cell_m:g},-{50 * one.cell_m:g}" for one in REAL if one.moves}
    assert middles == {one.name: one.grid for one in REAL if one.moves}
