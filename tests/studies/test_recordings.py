"""Recordings of the studies: drives to learn from, and recordings of real robots."""

from __future__ import annotations

from operator import attrgetter
from pathlib import Path

from gridtrack.evaluation.runs.recipe import read_recipe
from gridtrack.recordings import open_recording
from gridtrack.simulation.junction import JUNCTION_SET
from gridtrack.simulation.junction.drives import DRIVE_SEEDS

from studies.real_results import REAL
from studies.support.shipped import DEMO

RECIPES = Path(__file__).parents[2] / "studies" / "recipes" / "drives"


def test_recipes_for_drives_train_and_validate_on_seeds_of_their_own() -> None:
    known = {*DRIVE_SEEDS, *(seed for _, seed, _ in JUNCTION_SET.values())}
    recipes = [read_recipe(path) for path in RECIPES.glob("*.toml")]
    assert recipes
    training, validation = (
        {seed_of(text) for recipe in recipes for text in texts(recipe)}
        for texts in (attrgetter("recordings"), attrgetter("validation"))
    )
    assert known.isdisjoint(training | validation)
    assert training.isdisjoint(validation)


def seed_of(recording: str) -> int:
    """`runs/drives/training/car-302-beside.tracks@15s-45s` has the seed 302."""
    return int(Path(recording).stem.split("-")[1].partition(".")[0])


def test_the_window_of_corridor_is_the_shipped_parts() -> None:
    (corridor,) = (one for one in REAL if one.name == "corridor")
    assert corridor.grid == open_recording(DEMO).info.grid


def test_a_laser_that_moves_is_in_the_middle_of_its_window() -> None:
    middles = {one.name: f"100x{one.cell_m:g}@-{50 * one.cell_m:g},-{50 * one.cell_m:g}" for one in REAL if one.moves}
    assert middles == {one.name: one.grid for one in REAL if one.moves}
