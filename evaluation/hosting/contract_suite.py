"""The contract suite: a verdict on each clause of the tracker contract over the wire, for trackers in any language."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.errors import ConfigurationError, PluginError
from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec
from gridtrack.evaluation.hosting.contract_clauses import CLAUSES, Clause
from gridtrack.evaluation.hosting.contract_scene import drive, empty_stream, scene
from gridtrack.evaluation.hosting.limits import Limits
from gridtrack.evaluation.hosting.outcome import TrialEnded
from gridtrack.evaluation.hosting.tracker_process import TrackerDescription, TrackerProcess, describe
from gridtrack.trackers.contract import Forecast, StreamSpec
from gridtrack.trackers.selection import Launch

STREAM_FRAMES, TURN_FRAME, CHECKED_STEPS = 16, 10, 5
RESET_SEED = 7
Forecasts = list[tuple[int, Forecast]]
"""Forecasts, each with the number of frames observed before it."""
FORECAST_TOLERANCE = 1e-5
"""Largest difference between equal forecasts, in probability: the order of summation may change the rounding."""
UNSEEN_FRAMES = 4
"""Frames at the end of a drive in which nothing is visible: the forecast shows the memory of the tracker."""
PLACE_TOLERANCE = 0.05
"""Limit by which a wall may be more probable at another place than at its own."""
MISSED_FRAMES = 2
"""Missing frames between two delivered ones."""
UNKNOWN_OPTION = "no_such_option_of_gridtrack"
ClauseVerdict = Literal["passed", "failed", "not applicable", "not checked"]
"""`not applicable`: the clause does not concern this tracker. `not checked`: nothing could be observed, because another
clause is broken, or weights or a library are missing."""


@dataclass(frozen=True, slots=True)
class ClauseResult:
    """The verdict on one clause, and the observation in one line."""

    clause: Clause
    verdict: ClauseVerdict
    observed: str

    @property
    def kept(self) -> bool:
        """Whether the tracker keeps the clause, as far as it concerns it."""
        return self.verdict in {"passed", "not applicable"}

    def record(self) -> dict[str, str]:
        """The result as JSON: `mend` is empty unless the clause failed."""
        return {
            "clause": self.clause.name,
            "verdict": self.verdict,
            "observed": self.observed,
            "mend": self.clause.mend if self.verdict == "failed" else "",
            "requirement": self.clause.requirement,
            "reason": self.clause.reason,
        }


def check_tracker(
    launch: Launch,
    stream: StreamSpec,
    options: Mapping[str, Any] | None = None,
    limits: Limits | None = None,
    report: Callable[[ClauseResult], None] | None = None,
) -> list[ClauseResult]:
    """Check every clause of the contract on small synthetic streams; `report` receives each result.

    `stream` contains the grid, the period and, for a tracker that learns, its weights. A clause that needs a broken one
    is not checked; if weights or a library are missing, only the first clauses are. Raises ConfigurationError for
    options that the tracker refuses.
    """
    results: dict[str, ClauseResult] = {}
    with (
        TemporaryDirectory() as folder,
        TrackerUnderTest(launch, stream, options or {}, limits or Limits(), folder) as subject,
    ):
        for clause in CLAUSES:
            unmet = [results[name] for name in clause.needs if results[name].verdict != "passed"]
            results[clause.name] = _not_checked(clause, unmet[0]) if unmet else _result(clause, subject)
            if report is not None:
                report(results[clause.name])
    return list(results.values())


def _not_checked(clause: Clause, unmet: ClauseResult) -> ClauseResult:
    """The result of a clause that needs the clause of `unmet`, which did not pass; it names the first failed clause."""
    why = unmet.observed if unmet.observed.startswith("needs ") else f"needs {unmet.clause.name}"
    return ClauseResult(clause, "not checked", why)


def _result(clause: Clause, subject: TrackerUnderTest) -> ClauseResult:
    try:
        return ClauseResult(clause, "passed", CHECKS[clause.name](subject))
    except NotPassedError as found:
        if found.verdict == "not checked":
            subject.restart()
        return ClauseResult(clause, found.verdict, str(found))
    except TrialEnded as ended:
        subject.restart()
        return ClauseResult(clause, "failed", str(ended))


class NotPassedError(Exception):
    """Ends the check of a clause with this verdict; the message is the observation, or the reason."""

    def __init__(self, verdict: ClauseVerdict, observed: str) -> None:
        super().__init__(observed)
        self.verdict = verdict


class TrackerUnderTest:
    """A process of the tracker, restarted after a failure."""

    def __init__(
        self, launch: Launch, stream: StreamSpec, options: Mapping[str, Any], limits: Limits, folder: str
    ) -> None:
        self.stream = stream
        self._launch, self._options, self._limits = launch, options, limits
        self._log = Path(folder, "stderr.log")
        self._running = ExitStack()
        self._process: TrackerProcess | None = None
        self._fresh: Forecasts | None = None

    def __enter__(self) -> TrackerUnderTest:
        return self

    def __exit__(self, *_: object) -> None:
        self._running.close()

    def process(self) -> TrackerProcess:
        """The running process, started if there is none."""
        if self._process is None:
            self._process = self._running.enter_context(self.process_on(self.stream))
        return self._process

    @cached_property
    def description(self) -> TrackerDescription:
        """The tracker's description without a stream. Raises ConfigurationError, PluginError."""
        return self.described_with({})

    def described_with(self, options: Mapping[str, Any]) -> TrackerDescription:
        """The description with more `options`. Raises ConfigurationError, PluginError."""
        return describe(self._launch, {**self._options, **options}, self._limits)

    def restart(self) -> None:
        """End the process; the next use starts a new one."""
        self._process = None
        self._running.close()

    def process_on(self, stream: StreamSpec) -> TrackerProcess:
        """A separate process on another stream, not started yet."""
        return TrackerProcess(self._launch, stream, self._options, self._limits, self._log)

    def scene(self, seed: int = 1, turn_seed: int | None = None) -> list[GridFrame]:
        """A scene on the stream's grid; with `turn_seed`, the velocities change at frame TURN_FRAME."""
        turn = None if turn_seed is None else (TURN_FRAME, turn_seed)
        return scene(self.stream.grid, self.stream.period_s, STREAM_FRAMES, seed, turn)

    def forecasts(self, frames: Sequence[GridFrame], at: Iterable[int] = range(4, STREAM_FRAMES + 1, 4)) -> Forecasts:
        """Reset, stream `frames`, and forecast after each 1-based frame number in `at`, which may repeat one."""
        tracker = self.process()
        tracker.reset(RESET_SEED)
        due = list(at)
        made = []
        for count, frame in enumerate(frames, start=1):
            tracker.update(frame)
            made += [(count, tracker.predict(CHECKED_STEPS)) for _ in range(due.count(count))]
        return made

    def fresh_forecasts(self) -> Forecasts:
        """The forecasts of the scene in a process that has seen nothing else; made once."""
        if self._fresh is None:
            self.restart()
            self._fresh = self.forecasts(self.scene())
        return self._fresh


Check = Callable[[TrackerUnderTest], str]


def loads(subject: TrackerUnderTest) -> str:
    """Ask for the description without a stream."""
    try:
        description = subject.description
    except PluginError as error:
        raise NotPassedError("failed", str(error)) from None
    return f"{description.role}, {'learns' if description.learns else 'nothing to learn'}"


def refuses_unknown_options(subject: TrackerUnderTest) -> str:
    """Ask for the description with an option that no tracker has."""
    try:
        subject.described_with({UNKNOWN_OPTION: 1})
    except ConfigurationError:
        return f"refuses {UNKNOWN_OPTION}=1"
    except PluginError as error:
        raise NotPassedError("failed", f"does not refuse {UNKNOWN_OPTION}=1 but fails: {error}") from None
    raise NotPassedError("failed", f"accepts {UNKNOWN_OPTION}=1")


def starts(subject: TrackerUnderTest) -> str:
    """Start on the stream."""
    before = subject.description
    try:
        after = subject.process().description
    except TrialEnded as ended:
        if ended.outcome in {"untrained", "unavailable", "not-applicable"}:
            raise NotPassedError("not checked", str(ended)) from None
        raise
    for name in ("learns", "moving_sensor", "role"):
        if getattr(before, name) != getattr(after, name):
            raise NotPassedError(
                "failed", f"{name} is {getattr(before, name)} without a stream and {getattr(after, name)} on the stream"
            )
    return f"classes: {', '.join(after.classes) or 'none'}; moving sensor: {'yes' if after.moving_sensor else 'no'}"


def takes_frames(subject: TrackerUnderTest) -> str:
    """Update with every frame of a scene."""
    subject.forecasts(subject.scene(), at=[])
    return f"{STREAM_FRAMES} frames"


def gives_valid_forecasts(subject: TrackerUnderTest) -> str:
    """Forecast after every fourth frame of a scene."""
    subject.forecasts(subject.scene())
    return f"{CHECKED_STEPS} steps ahead, after every fourth frame"


def forecasts_any_horizon(subject: TrackerUnderTest) -> str:
    """Forecast no step, one, and many."""
    subject.forecasts(subject.scene(), at=[])
    horizons = (0, 1, 4 * CHECKED_STEPS)
    for steps in horizons:
        subject.process().predict(steps)
    return f"{', '.join(map(str, horizons))} steps ahead"


def gives_its_classes(subject: TrackerUnderTest) -> str:
    """Look for class probabilities in every forecast."""
    classes = subject.process().description.classes
    if not classes:
        raise NotPassedError("not applicable", "names no classes")
    for frames in (subject.scene(), _empty(subject)):
        for count, forecast in subject.forecasts(frames):
            if forecast.semantics is None:
                raise NotPassedError(
                    "failed",
                    f"names the classes {', '.join(classes)}, and the forecast after frame {count} has no semantics",
                )
    return ", ".join(classes)


def accepts_empty_input(subject: TrackerUnderTest) -> str:
    """Forecast from frames in which nothing is visible."""
    subject.forecasts(_empty(subject), at=[1, STREAM_FRAMES])
    return f"{STREAM_FRAMES} frames in which nothing is visible"


def goes_on_after_missed_frames(subject: TrackerUnderTest) -> str:
    """Forecast from every third frame of a scene."""
    frames = subject.scene()[:: MISSED_FRAMES + 1]
    subject.forecasts(frames, at=range(1, len(frames) + 1))
    return f"{len(frames)} frames, {MISSED_FRAMES} missing between each two"


def is_repeatable(subject: TrackerUnderTest) -> str:
    """Forecast the same scene in two fresh processes."""
    first = subject.fresh_forecasts()
    subject.restart()
    require_equal(first, subject.forecasts(subject.scene()), "the same stream with the same seed in two processes")
    return "two processes have the same forecasts"


def predict_keeps_the_state(subject: TrackerUnderTest) -> str:
    """Forecast at other frames, and twice in a row, in fresh processes."""
    frames = subject.scene()
    subject.restart()
    often = subject.forecasts(frames, at=[count for count in range(1, STREAM_FRAMES + 1) for _ in range(2)])
    for (count, one), (again, other) in pairwise(often):
        if count == again:
            require_equal([(count, one)], [(count, other)], "predicted twice in a row")
    subject.restart()
    require_equal(subject.forecasts(frames, at=[STREAM_FRAMES]), often[-1:], "with and without predictions in between")
    return "predicted twice after every frame, or only once at the end"


def reset_clears_the_state(subject: TrackerUnderTest) -> str:
    """Forecast a scene after another one."""
    fresh = subject.fresh_forecasts()
    subject.restart()
    subject.forecasts(subject.scene(seed=4), at=[STREAM_FRAMES])
    require_equal(fresh, subject.forecasts(subject.scene()), "in a fresh process, and after another stream and a reset")
    return "the same forecasts as in a fresh process"


def is_causal(subject: TrackerUnderTest) -> str:
    """Forecast the common beginning of two scenes, one after the other."""
    before_turn = range(2, TURN_FRAME + 1, 2)
    subject.restart()
    first = subject.forecasts(subject.scene(turn_seed=2), at=before_turn)
    second = subject.forecasts(subject.scene(turn_seed=3), at=before_turn)
    require_equal(first, second, f"two streams that differ only after frame {TURN_FRAME}, one after the other")
    return f"two streams that differ after frame {TURN_FRAME} have the same forecasts up to that frame"


def follows_a_moving_sensor(subject: TrackerUnderTest) -> str:
    """Drive towards a wall, and look for its place in the forecast when it is no longer visible."""
    if not subject.process().description.moving_sensor:
        raise NotPassedError("not applicable", "says that it does not follow a moving sensor")
    (_, forecast), wall = _end_of_drive(subject, with_wall=True)
    (_, without), _ = _end_of_drive(subject, with_wall=False)
    caused = forecast.occupancy - without.occupancy
    own = {step: float(caused[step, wall[:, 0], wall[:, 1]].mean()) for step in (0, CHECKED_STEPS)}
    left_behind = "where the window was when it was last seen"
    for step, moved, why in (
        (0, UNSEEN_FRAMES, left_behind),
        (CHECKED_STEPS, UNSEEN_FRAMES, left_behind),
        (CHECKED_STEPS, -CHECKED_STEPS, "as if the window continued to move"),
    ):
        other = float(caused[step, wall[:, 0], wall[:, 1] + moved].mean())
        if other > own[step] + PLACE_TOLERANCE:
            raise NotPassedError(
                "failed",
                f"a wall that was seen from a moving sensor has P(occupied) {own[step]:.2f} at its place and"
                f" {other:.2f} {abs(moved)} cells away, {why}: step {step}, less P without the wall",
            )
    _jump(subject)
    return f"a wall is forecast at its place with P(occupied) {own[0]:.2f} more than without it"


def accepts_another_grid(subject: TrackerUnderTest) -> str:
    """Run on two thirds of the cells, each larger."""
    grid = subject.stream.grid
    other = GridSpec(max(8, grid.size * 2 // 3), grid.cell_m * 1.25)
    return _works_on(subject, replace(subject.stream, grid=other), f"grid {other}")


def accepts_another_period(subject: TrackerUnderTest) -> str:
    """Run at a longer period."""
    period_s = 1.6 * subject.stream.period_s
    return _works_on(subject, replace(subject.stream, period_s=period_s), f"period {period_s:g} s")


CHECKS: Mapping[str, Check] = {
    "loads": loads,
    "refuses-unknown-options": refuses_unknown_options,
    "starts": starts,
    "takes-frames": takes_frames,
    "valid-forecast": gives_valid_forecasts,
    "any-horizon": forecasts_any_horizon,
    "gives-its-classes": gives_its_classes,
    "empty-input": accepts_empty_input,
    "missed-frames": goes_on_after_missed_frames,
    "repeatable": is_repeatable,
    "predict-keeps-the-state": predict_keeps_the_state,
    "reset-clears-the-state": reset_clears_the_state,
    "causal": is_causal,
    "scrolling-window": follows_a_moving_sensor,
    "another-grid": accepts_another_grid,
    "another-period": accepts_another_period,
}
"""The check of each clause, by its name."""


def _empty(subject: TrackerUnderTest) -> list[GridFrame]:
    return empty_stream(subject.stream.grid, subject.stream.period_s, STREAM_FRAMES)


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


def _works_on(subject: TrackerUnderTest, stream: StreamSpec, what: str) -> str:
    """Run on another stream. Returns the observation: it works, or it reports that it cannot. Raises TrialEnded."""
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


def require_equal(one: Forecasts, other: Forecasts, what: str) -> None:
    """Raise NotPassedError if two series of forecasts differ."""
    for (count, a), (_, b) in zip(one, other, strict=True):
        difference = _difference(a, b)
        if difference > FORECAST_TOLERANCE:
            raise NotPassedError(
                "failed", f"{what}: after frame {count} the forecasts differ by up to {difference:.3g}"
            )


def _difference(a: Forecast, b: Forecast) -> float:
    """The largest difference between two forecasts in any probability or sampled future."""
    differences = [float(np.abs(a.occupancy - b.occupancy).max())]
    for x, y in ((a.semantics, b.semantics), (a.futures, b.futures)):
        if x is not None and y is not None and x.shape == y.shape:
            differences.append(float(np.abs(x.astype(np.float32) - y.astype(np.float32)).max()))
        elif x is not y:
            differences.append(1.0)
    return max(differences)
