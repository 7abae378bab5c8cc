"""Every registered tracker satisfies the contract; and the suite detects each violation."""

from __future__ import annotations

import re
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gridtrack.common.errors import ConfigurationError
from gridtrack.common.grid import GridSpec
from gridtrack.evaluation.hosting.contract_clauses import CLAUSES
from gridtrack.evaluation.hosting.contract_scene import drive, empty_stream, scene
from gridtrack.evaluation.hosting.contract_suite import (
    CHECKS,
    ClauseResult,
    TrackerUnderTest,
    check_tracker,
    require_equal,
)
from gridtrack.evaluation.hosting.limits import Limits
from gridtrack.evaluation.hosting.outcome import TrialEnded
from gridtrack.evaluation.runs.learned import find_weights
from gridtrack.trackers.contract import StreamSpec
from gridtrack.trackers.registry import entries, load, recorded
from gridtrack.trackers.selection import launch

from scenes.programs_here import programs_here

LEG_TRACKER = StreamSpec(GridSpec(100, 0.1, (-2.0, -4.5)), 0.1, "leg_tracker")
JUNCTION = StreamSpec(GridSpec(100, 0.2, (-4.0, -16.0)), 0.125, "junction")
ANYWHERE = StreamSpec(GridSpec(40, 0.2), 0.125, "anywhere")
SMALL = StreamSpec(GridSpec(40, 0.2), 0.125, "here")
LIVE = sorted(entries().keys() - recorded().keys())


TINY: dict[str, dict[str, object]] = {
    "sogmp": {"channels": 2, "hidden": 4},
}
"""Options of small trackers, for those without shipped weights."""
CHEAPER = {"sogmp": {"samples": 2}}
"""Options with which the suite takes less time."""


def weights_for(name: str, site: str, folder: Path) -> Path | None:
    """The shipped weights of a tracker, or those of a small one after a short training; None if it learns nothing."""
    if (learned := find_weights(name, site, None)) is not None or name not in TINY:
        return learned and learned.path
    pytest.importorskip("lightning")
    from tests.trackers.recurrent.sources import Walk, fit

    fit(load(name), folder / "general.toml", [Walk(12, 0.2, 0.125)], general=True, **TINY[name])
    return folder / "general.toml"


@pytest.mark.parametrize("name", LIVE)
def test_a_registered_tracker_satisfies_the_contract(name: str, trackers_here: None, tmp_path: Path) -> None:
    """A learned tracker has general weights here: weights of a site are for a larger grid; the next test uses them."""
    stream = replace(ANYWHERE, weights=weights_for(name, "anywhere", tmp_path))
    results = check_tracker(launch(name), stream, CHEAPER.get(name))
    if missing := [r.observed for r in results[:3] if "No module named" in r.observed]:
        pytest.skip(missing[0])
    assert [r for r in results if not r.kept] == []
    assert len(results) == len(CLAUSES)


@pytest.mark.parametrize("name", LIVE)
def test_a_registered_tracker_forecasts_the_same_in_its_own_process(name: str, tmp_path: Path) -> None:
    """With other hashes of strings, and nothing that other trackers have imported."""
    forecasts, stream = [], stream_for(name, tmp_path)
    for where in (programs_here(), nullcontext()):
        with where, TrackerUnderTest(launch(name), stream, {}, Limits(), str(tmp_path)) as subject:
            try:
                forecasts.append(subject.fresh_forecasts())
            except TrialEnded as ended:
                if ended.outcome not in ("unavailable", "untrained"):  # weights may ship later
                    raise
                pytest.skip(ended.reason)
    require_equal(*forecasts, "here and in its own process")


def stream_for(name: str, folder: Path) -> StreamSpec:
    """The stream that a tracker has weights for."""
    known = [(s, learned) for s in (LEG_TRACKER, JUNCTION) if (learned := find_weights(name, s.site, None))]
    if not known:
        return replace(ANYWHERE, weights=weights_for(name, "anywhere", folder))
    stream, learned = known[0]
    return replace(stream, weights=learned and learned.path)


def verdicts(name: str, verdict: str, **options: object) -> dict[str, ClauseResult]:
    with programs_here():
        results = check_tracker(launch(name), SMALL, options)
    return {result.clause.name: result for result in results if result.verdict == verdict}


BREAKERS = {
    "loads": ("not-a-tracker", {}, "is not a subclass of gridtrack.trackers.contract.Tracker"),
    "refuses-unknown-options": ("takes-any-option", {}, "accepts no_such_option_of_gridtrack=1"),
    "starts": ("raises", {"at": "start"}, "crashed: ValueError: the gate is negative"),
    "takes-frames": ("raises", {"at": "update"}, "crashed: update with frame 1: ValueError: the gate is negative"),
    "valid-forecast": ("wrong-shape", {}, "invalid-output: .* has shape"),
    "any-horizon": ("keeps-to-one-horizon", {}, "invalid-output: .* has shape"),
    "gives-its-classes": ("names-classes-alone", {}, "classes car, person, .* frame 4 has no semantics"),
    "empty-input": ("fails-on-empty-input", {}, "invalid-output: .* not finite"),
    "missed-frames": ("needs-every-frame", {}, "crashed: update with frame 2: ValueError: a frame is missing"),
    "repeatable": ("rolls-dice", {}, "the same seed in two processes: after frame 4 .* differ by"),
    "predict-keeps-the-state": ("counts-predictions", {}, "twice in a row: after frame 1 .* by up to 0.5"),
    "reset-clears-the-state": ("never-forgets", {}, "in a fresh process, and after another stream and a reset"),
    "causal": ("recognises-the-stream", {}, "two streams that differ only after frame 10, one after the other"),
    "scrolling-window": ("stays-behind", {}, "4 cells away, where the window was when it was last seen: step 0"),
    "another-grid": ("keeps-to-one-grid", {}, r"shape \(6, 40, 40\); expected"),
    "another-period": ("keeps-to-one-period", {}, "ZeroDivisionError"),
}
"""For each clause a tracker that breaks this one alone, its options, and the observation."""


def test_each_clause_has_a_check_and_a_tracker_that_breaks_it() -> None:
    names = [clause.name for clause in CLAUSES]
    assert list(CHECKS) == names
    assert list(BREAKERS) == names


@pytest.mark.usefixtures("bad_trackers")
@pytest.mark.parametrize("clause", BREAKERS)
def test_a_broken_clause_is_the_only_one_that_fails(clause: str) -> None:
    name, options, observed = BREAKERS[clause]
    failed = verdicts(name, "failed", **options)
    assert list(failed) == [clause]
    assert re.search(observed, failed[clause].observed)


@pytest.mark.usefixtures("bad_trackers")
def test_a_tracker_that_keeps_the_contract_fails_nothing_and_some_clauses_do_not_concern_it() -> None:
    assert verdicts("good", "failed") == verdicts("good", "not checked") == {}
    assert {name: result.observed for name, result in verdicts("good", "not applicable").items()} == {
        "gives-its-classes": "names no classes",
        "scrolling-window": "says that it does not follow a moving sensor",
    }


@pytest.mark.usefixtures("bad_trackers")
def test_futures_and_classes_are_checked_like_occupancy() -> None:
    assert re.search("frame 4 .* differ by up to 1", verdicts("draws-other-futures", "failed")["repeatable"].observed)
    assert "semantics must sum to 1" in verdicts("lopsided-classes", "failed")["valid-forecast"].observed


@pytest.mark.usefixtures("bad_trackers")
def test_a_clause_that_needs_a_broken_one_is_not_checked_and_names_the_first_broken_one() -> None:
    unchecked = verdicts("wrong-shape", "not checked")
    assert {result.observed for result in unchecked.values()} == {"needs valid-forecast"}
    assert len(unchecked) == len(CLAUSES) - CLAUSES.index(next(iter(unchecked.values())).clause)
    unchecked = verdicts("needs-weights", "not checked", at="start")
    assert unchecked["starts"].observed == "untrained: needs-weights: no weights"
    assert len(unchecked) == len(CLAUSES) - 2


@pytest.mark.usefixtures("bad_trackers", "trackers_here")
def test_an_option_that_the_tracker_refuses_is_an_error_of_the_user() -> None:
    with pytest.raises(ConfigurationError, match="there is no option 'speed'"):
        check_tracker(launch("good"), SMALL, {"speed": 2})


def test_each_result_is_reported_and_the_suite_runs_in_processes() -> None:
    seen: list[ClauseResult] = []
    assert check_tracker(launch("blank"), SMALL, report=seen.append) == seen
    assert all(result.kept for result in seen)


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
