"""The contract suite: checks of the tracker contract over the wire, for trackers in any language."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from tempfile import TemporaryDirectory
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridSpec
from gridtrack.evaluation.processes.contract_scene import drive, empty_stream, scene
from gridtrack.evaluation.processes.limits import Limits
from gridtrack.evaluation.processes.outcome import TrialEnded
from gridtrack.evaluation.processes.tracker_under_test import (
    CHECKED_STEPS,
    RESET_SEED,
    STREAM_FRAMES,
    TURN_FRAME,
    Forecasts,
    TrackerUnderTest,
)
from gridtrack.trackers.contract import Forecast, StreamSpec
from gridtrack.trackers.selection import Launch

FORECAST_TOLERANCE = 1e-5
"""Largest difference of equal forecasts, in probability: the order of summation may change the rounding."""
UNSEEN_FRAMES = 4
"""Frames of a drive in which nothing is visible any more: what is forecast is what the tracker remembers."""
PLACE_TOLERANCE = 0.05
"""How much more probable a wall may be at another place than at its own."""

CheckVerdict = Literal["passed", "failed", "skipped"]


@dataclass(frozen=True, slots=True)
class CheckResult:
    """The result of one check: its name, verdict and a detail in one line."""

    name: str
    verdict: CheckVerdict
    detail: str


class ContractViolationError(Exception):
    """A failed check; the message is the detail."""


def check_tracker(
    launch: Launch,
    stream: StreamSpec,
    options: Mapping[str, Any] | None = None,
    limits: Limits | None = None,
    report: Callable[[CheckResult], None] | None = None,
) -> list[CheckResult]:
    """Run every check of the contract on small synthetic streams; `report` receives each result.

    `stream` contains the grid, the period and, for a tracker that learns, its weights. Where a tracker cannot start
    because weights or a library are missing, the other checks are not run.
    """
    results: list[CheckResult] = []
    with (
        TemporaryDirectory() as folder,
        TrackerUnderTest(launch, stream, options or {}, limits or Limits(), folder) as subject,
    ):
        for check in (starts, *CHECKS):
            results.append(_result(check, subject))
            if report is not None:
                report(results[-1])
            if check is starts and results[-1].verdict != "passed":
                break
    return results


Check = Callable[[TrackerUnderTest], str]


def _result(check: Check, subject: TrackerUnderTest) -> CheckResult:
    name = (check.__doc__ or "").partition(".")[0].lower()
    try:
        return CheckResult(name, "passed", check(subject))
    except ContractViolationError as violation:
        return CheckResult(name, "failed", str(violation))
    except TrialEnded as ended:
        subject.restart()
        cannot_start = check is starts and ended.outcome in {"untrained", "unavailable"}
        return CheckResult(name, "skipped" if cannot_start else "failed", str(ended))


def starts(subject: TrackerUnderTest) -> str:
    """Starts on the stream."""
    description = subject.process().description
    moving_sensor = "yes" if description.moving_sensor else "no"
    return f"classes: {', '.join(description.classes) or 'none'}; moving sensor: {moving_sensor}"


def gives_valid_forecasts(subject: TrackerUnderTest) -> str:
    """Forecasts have the right shape, type and range."""
    subject.forecasts(subject.scene(), at=[])
    tracker = subject.process()
    for steps in (0, 1, 4 * CHECKED_STEPS):
        forecast = tracker.predict(steps)
        if tracker.description.classes and forecast.semantics is None:
            raise ContractViolationError(
                f"declares the classes {', '.join(tracker.description.classes)} and forecasts no semantics"
            )
    return f"0, 1 and {4 * CHECKED_STEPS} steps ahead"


def accepts_empty_input(subject: TrackerUnderTest) -> str:
    """Works on empty input from the first frame."""
    subject.forecasts(empty_stream(subject.stream.grid, subject.stream.period_s, STREAM_FRAMES), at=[1, STREAM_FRAMES])
    return f"{STREAM_FRAMES} frames in which nothing is visible"


def is_deterministic(subject: TrackerUnderTest) -> str:
    """Same seed and frames, same forecasts."""
    frames = subject.scene()
    first = subject.forecasts(frames)
    _require_equal(first, subject.forecasts(frames), "the same stream again, after reset with the same seed")
    subject.restart()
    _require_equal(first, subject.forecasts(frames), "the same stream with the same seed, in a fresh process")
    return "after reset, and in a fresh process"


def predict_keeps_the_state(subject: TrackerUnderTest) -> str:
    """Predict does not change the state."""
    frames = subject.scene()
    often = subject.forecasts(frames, at=[count for count in range(1, STREAM_FRAMES + 1) for _ in range(2)])
    for (count, one), (again, other) in pairwise(often):
        if count == again:
            _require_equal([(count, one)], [(count, other)], "predicted twice in a row")
    _require_equal(subject.forecasts(frames, at=[STREAM_FRAMES]), often[-1:], "with and without predictions in between")
    return "predicted twice after every frame, or only once at the end"


def is_causal(subject: TrackerUnderTest) -> str:
    """Forecasts do not depend on future frames."""
    before_turn = range(2, TURN_FRAME + 1, 2)
    first = subject.forecasts(subject.scene(turn_seed=2), at=before_turn)
    second = subject.forecasts(subject.scene(turn_seed=3), at=before_turn)
    _require_equal(first, second, f"two streams that differ only after frame {TURN_FRAME}")
    return f"two streams that differ after frame {TURN_FRAME} have the same forecasts up to that frame"


def reset_clears_the_state(subject: TrackerUnderTest) -> str:
    """Reset clears the state of the last stream."""
    subject.restart()
    frames = subject.scene()
    fresh = subject.forecasts(frames)
    subject.forecasts(subject.scene(seed=4), at=[STREAM_FRAMES])
    _require_equal(fresh, subject.forecasts(frames), "in a fresh process, and after another stream and a reset")
    return "the same forecasts as in a fresh process"


def accepts_another_grid(subject: TrackerUnderTest) -> str:
    """Works on another grid, or reports that it cannot."""
    grid = subject.stream.grid
    other = GridSpec(max(8, grid.size * 2 // 3), grid.cell_m * 1.25)
    return _works_on(subject, replace(subject.stream, grid=other), f"grid {other}")


def accepts_another_period(subject: TrackerUnderTest) -> str:
    """Works at another period, or reports that it cannot."""
    period_s = 1.6 * subject.stream.period_s
    return _works_on(subject, replace(subject.stream, period_s=period_s), f"period {period_s:g} s")


def follows_a_moving_sensor(subject: TrackerUnderTest) -> str:
    """Keeps a wall at its place while the sensor moves, or says that it cannot."""
    tracker = subject.process()
    if not tracker.description.moving_sensor:
        return "says that it does not follow a moving sensor"
    (_, forecast), wall = _end_of_drive(subject, with_wall=True)
    (_, without), _ = _end_of_drive(subject, with_wall=False)
    caused = forecast.occupancy - without.occupancy
    own = {step: float(caused[step, wall[:, 0], wall[:, 1]].mean()) for step in (0, CHECKED_STEPS)}
    left_behind = "where the window was when it was last seen"
    for step, moved, why in (
        (0, UNSEEN_FRAMES, left_behind),
        (CHECKED_STEPS, UNSEEN_FRAMES, left_behind),
        (CHECKED_STEPS, -CHECKED_STEPS, "as if the window went on moving"),
    ):
        other = float(caused[step, wall[:, 0], wall[:, 1] + moved].mean())
        if other > own[step] + PLACE_TOLERANCE:
            raise ContractViolationError(
                f"a wall that was seen from a moving sensor has P(occupied) {own[step]:.2f} at its place and"
                f" {other:.2f} {abs(moved)} cells away, {why}: step {step}, less P without the wall"
            )
    _jump(subject)
    return f"a wall is forecast at its place with P(occupied) {own[0]:.2f} more than without it"


def _end_of_drive(subject: TrackerUnderTest, *, with_wall: bool) -> tuple[tuple[int, Forecast], NDArray[np.int64]]:
    """The forecast after a drive, and the cells of the wall in its window."""
    stream = subject.stream
    frames, wall = drive(stream.grid, stream.period_s, STREAM_FRAMES, unseen=UNSEEN_FRAMES, with_wall=with_wall)
    (made,) = subject.forecasts(frames, at=[STREAM_FRAMES])
    return made, wall


def _jump(subject: TrackerUnderTest) -> None:
    """Move the window beyond itself in one frame: the forecast must be valid. Raises TrialEnded."""
    tracker, grid = subject.process(), subject.stream.grid
    frame = subject.scene()[-1]
    beyond_m = 3 * grid.size * grid.cell_m
    tracker.update(replace(frame, world_T_grid=SE2(beyond_m, -beyond_m)))
    tracker.predict(CHECKED_STEPS)


CHECKS: tuple[Check, ...] = (
    gives_valid_forecasts,
    accepts_empty_input,
    is_deterministic,
    predict_keeps_the_state,
    is_causal,
    reset_clears_the_state,
    follows_a_moving_sensor,
    accepts_another_grid,
    accepts_another_period,
)


def _works_on(subject: TrackerUnderTest, stream: StreamSpec, what: str) -> str:
    """The detail of a check on another stream: works, or reports that it cannot. Raises TrialEnded otherwise."""
    process = subject.process_on(stream)
    try:
        with process:
            process.reset(RESET_SEED)
            for frame in scene(stream.grid, stream.period_s, STREAM_FRAMES, seed=1):
                process.update(frame)
            process.predict(CHECKED_STEPS)
    except TrialEnded as ended:
        if ended.outcome in {"not-applicable", "untrained"}:
            return f"{what}: reports that it cannot ({ended.reason})"
        raise
    return f"{what}: works"


def _require_equal(one: Forecasts, other: Forecasts, what: str) -> None:
    """Raise ContractViolationError where two series of forecasts differ."""
    for (count, a), (_, b) in zip(one, other, strict=True):
        difference = _difference(a, b)
        if difference > FORECAST_TOLERANCE:
            raise ContractViolationError(f"{what}: after frame {count} the forecasts differ by up to {difference:.3g}")


def _difference(a: Forecast, b: Forecast) -> float:
    """The largest difference of two forecasts in any probability."""
    if (a.semantics is None) != (b.semantics is None):
        return 1.0
    pairs = [(a.occupancy, b.occupancy)]
    if a.semantics is not None and b.semantics is not None:
        pairs.append((a.semantics, b.semantics))
    return max(float(np.abs(x - y).max()) for x, y in pairs)
