"""Every registered tracker satisfies the contract; and the suite detects each violation."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from gridtrack.common.grid import GridSpec
from gridtrack.evaluation.comparison.learned import find_weights
from gridtrack.evaluation.processes.contract_scene import drive, empty_stream, scene
from gridtrack.evaluation.processes.contract_suite import CheckResult, check_tracker
from gridtrack.trackers.contract import StreamSpec
from gridtrack.trackers.registry import entries
from gridtrack.trackers.selection import launch

LEG_TRACKER = StreamSpec(GridSpec(100, 0.1, (-2.0, -4.5)), 0.1, "leg_tracker")
JUNCTION = StreamSpec(GridSpec(100, 0.2, (-4.0, -16.0)), 0.125, "junction")
SMALL = StreamSpec(GridSpec(40, 0.2), 0.125, "here")


@pytest.mark.parametrize("name", entries())
def test_a_registered_tracker_satisfies_the_contract(name: str) -> None:
    known = [
        (stream, learned) for stream in (LEG_TRACKER, JUNCTION) if (learned := find_weights(name, stream.site, None))
    ]
    stream, learned = known[0] if known else (LEG_TRACKER, None)
    results = check_tracker(launch(name), replace(stream, weights=learned and learned.path))
    if results[0].verdict == "skipped":
        pytest.skip(results[0].detail)
    assert [r for r in results if r.verdict != "passed"] == []
    assert len(results) == 10


def failures(name: str, **options: object) -> dict[str, CheckResult]:
    return {r.name: r for r in check_tracker(launch(name), SMALL, options) if r.verdict != "passed"}


@pytest.mark.usefixtures("bad_trackers")
@pytest.mark.parametrize(
    ("name", "broken", "detail"),
    [
        ("good", None, ""),
        ("wrong-shape", "forecasts have the right shape", "invalid-output: .* has shape"),
        ("lopsided-classes", "forecasts have the right shape", "semantics must sum to 1"),
        ("fails-on-empty-input", "works on empty input", "invalid-output: .* not finite"),
        ("rolls-dice", "same seed and frames", "the same stream again, after reset .* differ by"),
        (
            "counts-predictions",
            "predict does not change the state",
            "twice in a row: after frame 1 .* by up to 0.5",
        ),
        (
            "remembers-the-future",
            "forecasts do not depend on future frames",
            "two streams that differ only after frame 10",
        ),
        ("never-forgets", "reset clears the state", "in a fresh process, and after another stream and a reset"),
        (
            "stays-behind",
            "keeps a wall at its place",
            "4 cells away, where the window was when it was last seen: step 0",
        ),
        (
            "keeps-to-one-grid",
            "works on another grid",
            r"shape \(6, 40, 40\); expected",
        ),
        ("keeps-to-one-period", "works at another period", "ZeroDivisionError"),
    ],
)
def test_each_violation_is_detected(name: str, broken: str | None, detail: str) -> None:
    found = failures(name)
    if broken is None:
        assert found == {}
        return
    (result,) = [r for name, r in found.items() if name.startswith(broken)]
    assert result.verdict == "failed"
    assert re.search(detail, result.detail)


@pytest.mark.usefixtures("bad_trackers")
def test_a_tracker_that_cannot_start_is_not_checked_further() -> None:
    (result,) = check_tracker(launch("needs-weights"), SMALL, {"at": "start"})
    assert (result.verdict, result.detail) == ("skipped", "untrained: needs-weights: no weights")
    (result,) = check_tracker(launch("raises"), SMALL, {"at": "start"})
    assert (result.verdict, result.detail) == ("failed", "crashed: ValueError: the gate is negative")


@pytest.mark.usefixtures("bad_trackers")
def test_a_crash_in_one_check_does_not_affect_the_next() -> None:
    found = failures("fails-on-empty-input")
    assert set(found) == {"works on empty input from the first frame"}


def test_each_result_is_reported() -> None:
    seen: list[CheckResult] = []
    assert check_tracker(launch("blank"), SMALL, report=seen.append) == seen


def test_a_scene_has_moving_boxes_and_occlusion_and_turns() -> None:
    grid = GridSpec(60, 0.2)
    one, other = (scene(grid, 0.1, 16, seed=1, turn=(10, seed)) for seed in (2, 3))
    for index, (a, b) in enumerate(zip(one, other, strict=True)):
        assert (a.occupied & ~a.visible).sum() == 0
        assert 20 < a.occupied.sum() < 0.2 * grid.size**2
        assert 0.3 < a.visible.mean() < 0.95
        assert np.array_equal(a.occupied, b.occupied) == (index <= 10)
    assert not np.array_equal(one[0].occupied, one[5].occupied)
    assert np.diff([f.stamp_ns for f in one]).tolist() == [100_000_000] * 15
    assert not any(f.visible.any() for f in empty_stream(grid, 0.1, 3))


def test_a_drive_sees_its_wall_at_one_place_in_the_world() -> None:
    grid = GridSpec(60, 0.2)
    frames, wall = drive(grid, 0.1, 12, unseen=3, with_wall=True)
    places = set()
    for frame in frames[:-3]:
        rows, columns = np.nonzero(frame.occupied)
        places |= {(int(r), round(c + frame.world_T_grid.x / grid.cell_m)) for r, c in zip(rows, columns, strict=True)}
        assert frame.visible.sum() > 1000
    assert places <= {(int(r), int(c) + 11) for r, c in wall}
    assert len(places) > 15
    assert not any(frame.visible.any() for frame in frames[-3:])
    empty, _ = drive(grid, 0.1, 12, unseen=3, with_wall=False)
    assert not any(frame.occupied.any() for frame in empty)
