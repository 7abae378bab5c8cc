"""The clauses of the tracker contract: requirement, reason, and how to fix a tracker that breaks it.

`contract_suite.py` has the check of each; docs/contract.md lists them (`python -m studies.defined_pages`).
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Clause:
    """One clause: its `name`, its requirement and reason, and how to fix a tracker that breaks it, in sentences."""

    name: str
    requirement: str
    reason: str
    mend: str
    needs: tuple[str, ...] = ()
    """Clauses that must pass before this one can be checked."""


FORECASTS = ("valid-forecast",)
COMPARED = (*FORECASTS, "repeatable")

CLAUSES = (
    Clause(
        "loads",
        "It can be loaded, and describes itself without a stream: a subclass of `Tracker` for this version of the"
        " contract, or a program that answers `describe`.",
        "`trackers list` and `compare` ask each tracker about itself before a stream begins. One that cannot answer is"
        " listed as unavailable.",
        "Install what it imports. A class has `reset`, `update` and `predict` with the arguments of `Tracker`; a"
        " program answers `describe` like `start`.",
    ),
    Clause(
        "refuses-unknown-options",
        "It refuses an option that it does not have.",
        "A misspelt option would leave the default in place, and the table would show a setting that nobody used.",
        "List the options in a subclass of `Settings`, which refuses others; a program answers with an error with"
        " the outcome `not-applicable`.",
        ("loads",),
    ),
    Clause(
        "starts",
        "It starts on a stream within the time limit, with the same description as before.",
        "The description decides before the start whether a tracker can run on a stream, and whether it needs weights.",
        "`__init__` takes (stream, options). If it cannot process the stream it raises `ConfigurationError` with the"
        " reason. `learns`, `moving_sensor` and `role` are the same for every stream.",
        ("loads",),
    ),
    Clause(
        "takes-frames",
        "It takes every frame of a stream, within the limits of time and memory.",
        "A failure ends the trial: the frames after it are not scored, and the row is marked as partial.",
        "Fix the error that `reset` or `update` raised; the last line of its log is in the verdict.",
        ("starts",),
    ),
    Clause(
        "valid-forecast",
        "A forecast has the declared arrays: their shapes and types, finite probabilities in [0, 1], class"
        " probabilities that sum to 1, velocities that are finite or NaN.",
        "The referee scores every cell of every step. It neither guesses nor clips values, but ends the trial.",
        "Return `Forecast(occupancy)` with float32 of shape (steps + 1, M, M), and `semantics` of shape"
        " (steps + 1, K, M, M); look for divisions by zero, clip rounding errors to [0, 1], and divide by the sum over"
        " classes.",
        ("takes-frames",),
    ),
    Clause(
        "any-horizon",
        "It forecasts the requested number of steps, which may be 0.",
        "The user chooses the horizon in seconds, and the period of the recording converts it to steps.",
        "Take the number of steps from the argument of `predict`; step 0 is the present: steps + 1 planes.",
        FORECASTS,
    ),
    Clause(
        "gives-its-classes",
        "A tracker that names classes gives their probabilities in every forecast.",
        "Class scores are over all scored frames; a row with classes in some of them cannot be compared.",
        "Return `semantics` in every forecast, or leave `classes` empty.",
        FORECASTS,
    ),
    Clause(
        "empty-input",
        "It forecasts from frames in which nothing is visible, from the first frame on.",
        "A lost scan gives such a frame, and so does a covered sensor.",
        "Look for divisions by the number of visible or occupied cells, and for clusters of no points.",
        FORECASTS,
    ),
    Clause(
        "missed-frames",
        "It continues when frames are missing: stamps are then several periods apart.",
        "With `--deadline` a tracker that is busy misses frames, and recordings have gaps.",
        "Take the time since the last frame from `stamp_ns`, not from the period.",
        FORECASTS,
    ),
    Clause(
        "repeatable",
        "The same seed and the same frames give the same forecasts, in every process.",
        "A score that cannot be repeated is no result, and a regression check would report chance.",
        "Draw random numbers from one generator that `reset` seeds; take the time from `stamp_ns`, not from a clock."
        " Sets of strings have another order in each process; threads and GPU kernels may sum in another order.",
        FORECASTS,
    ),
    Clause(
        "predict-keeps-the-state",
        "`predict` does not change the state.",
        "Forecasts are requested at every k-th frame: with another `--every` the tracker would behave differently.",
        "Copy the state before it is propagated; use a generator of its own in `predict`.",
        COMPARED,
    ),
    Clause(
        "reset-clears-the-state",
        "After `reset` nothing of earlier streams remains.",
        "A tracker runs over a validation stretch before the test stretch: memory of it would be an advantage that"
        " depends on the order.",
        "Set in `reset` everything that `update` and `predict` write, the generator of random numbers too.",
        COMPARED,
    ),
    Clause(
        "causal",
        "A forecast depends on the frames up to now and not on later ones, even if an earlier stream had contained"
        " them.",
        "A forecast from memory of the same minutes is no forecast.",
        "Keep no frames over a `reset`, neither in the class, nor in a module, nor in a file.",
        (*COMPARED, "reset-clears-the-state"),
    ),
    Clause(
        "scrolling-window",
        "A tracker that follows a moving sensor keeps its memory at its place in the world while the window moves.",
        "The window moves by whole cells with the sensor. A forecast is in the window of the last update.",
        "Move the memory of each cell by as many cells as the window moved, in the opposite direction"
        " (`rolled` by `shift_between` the last `world_T_grid` and this one, both in `gridtrack.common.grid`), also by"
        " more than the window's width; or leave `moving_sensor` false.",
        FORECASTS,
    ),
    Clause(
        "another-grid",
        "It works on a grid of another size and cell, or reports that it cannot.",
        "The recording and `--grid` determine the grid.",
        "Take `stream.grid` for every size in cells and every length in metres, or raise `ConfigurationError` in"
        " `__init__`.",
        FORECASTS,
    ),
    Clause(
        "another-period",
        "It works at another period of frames, or reports that it cannot.",
        "Sensors have other rates, and `--rate` changes them.",
        "Take `stream.period_s` for every time constant, or raise `ConfigurationError` in `__init__`.",
        FORECASTS,
    ),
)
