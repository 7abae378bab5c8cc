"""Speed of the model-free pipeline by the number of road users, and the time of each of its stages at thirty.

`python -m benchmarks.model_free [--out FILE]` (one minute). Aims for one update and a 20-step forecast at thirty
tracks, 95th percentile, one thread: 10 ms with Kalman filters, 25 ms with the factor graph. One in three road users is
a car.
"""

from __future__ import annotations

import functools
import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec
from gridtrack.trackers.model_free.background import BackgroundMap
from gridtrack.trackers.model_free.classes import FEATURES, ClassFilter, ClassModel
from gridtrack.trackers.model_free.factor_graph import FactorGraphTracker
from gridtrack.trackers.model_free.kalman import KalmanTracker
from gridtrack.trackers.model_free.pipeline import Pipeline
from gridtrack.trackers.model_free.residence import table_shape
from gridtrack.trackers.model_free.settings import PipelineSettings
from gridtrack.trackers.registry import registered_name
from gridtrack.trackers.training.calibration import IDENTITY, Calibration
from gridtrack.trackers.training.weights import read_card

from benchmarks.timing import p50_p95
from studies.support.results_file import measured_table, study_parser, write_table
from studies.support.shipped import STEPS, WEIGHTS

GRID = GridSpec(100, 0.2)
PERIOD_S = 0.125
FRAMES, WARM_UP = 200, 40
MOVERS = (3, 10, 30)
TUNED = read_card(WEIGHTS / "kalman" / "junction.toml").settings
STREET = PipelineSettings(**{name: TUNED[name] for name in PipelineSettings.model_fields if name in TUNED})
"""The settings that ship for the junction; an option that their card lacks has its default."""
CALIBRATION = "calibration"
CLASSES, GAUSSIANS = 5, 8
MORE = "classes, additional processor time"
"""The cost of CLASSES classes of GAUSSIANS Gaussians, beside the processor time of an update and a forecast."""


def side_of_car() -> np.ndarray:
    """Returns of a car, (N, 2) metres about its centre: one side and the front."""
    along = np.arange(-2.1, 2.15, 0.1)
    across = np.arange(-0.8, 0.85, 0.1)
    return np.concatenate([np.stack([along, 0 * along - 0.85], 1), np.stack([0 * across + 2.15, across], 1)])


def person() -> np.ndarray:
    """Returns of a person, (N, 2) metres."""
    return np.array([(0.0, 0.0), (0.2, 0.0), (0.2, 0.2)])


def frame_of(count: int, step: int) -> GridFrame:
    """A frame with all cells visible; `count` road users circle about fixed positions, one in three a car."""
    occupied = np.zeros(GRID.shape, bool)
    phase = 0.06 * step
    for n in range(count):
        body, radius = (side_of_car(), 0.6) if n % 3 == 0 else (person(), 0.7)
        home = np.array([-8.2 + 3.3 * (n % 6), -7.8 + 3.8 * (n // 6)])
        turned = body @ np.array([[np.cos(0.1 * n), np.sin(0.1 * n)], [-np.sin(0.1 * n), np.cos(0.1 * n)]])
        cells, inside = GRID.cells_of(turned + home + radius * np.array([np.cos(phase + n), np.sin(phase + n)]))
        occupied[tuple(cells[inside].T)] = True
    points = GRID.cell_centres(occupied)
    sensor = np.zeros((1, 2), np.float32)
    return GridFrame(0, np.ones(GRID.shape, bool), occupied, SE2(), sensor, points, np.zeros(len(points), np.uint8))


def timed(stage: str, method: Callable[..., Any]) -> Callable[..., Any]:
    """A method of the pipeline that records the time of each call, in seconds, under `stage`."""

    @functools.wraps(method)
    def call(pipeline: TimedPipeline, *arguments: Any) -> Any:
        start = time.perf_counter()
        answer = method(pipeline, *arguments)
        pipeline.seconds[stage].append(time.perf_counter() - start)
        return answer

    return call


class TimedPipeline(Pipeline):
    """A pipeline that records the times of its stages; the rest of an update is the background."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.seconds: dict[str, list[float]] = defaultdict(list)

    _segment = timed("segmentation", Pipeline._segment)
    _predict = timed("prediction", Pipeline._predict)
    _associate = timed("association", Pipeline._associate)
    _correct = timed("estimation, shape", Pipeline._correct)
    _update_existence = timed("existence", Pipeline._update_existence)
    _merge = timed("merging", Pipeline._merge)
    forecast = timed("forecast", Pipeline.forecast)


def some_classes() -> ClassFilter:
    """Classes drawn at random: the time does not depend on the scene."""
    shares = np.full((CLASSES, GAUSSIANS), 1.0 / GAUSSIANS)
    means = np.random.default_rng(0).normal(size=(*shares.shape, len(FEATURES)))
    whitening = np.tile(np.eye(len(FEATURES)), (CLASSES, 1, 1))
    place = np.full((CLASSES, *GRID.shape), 1.0 / CLASSES)
    return ClassFilter(ClassModel(shares, means, whitening, place[:, 0, 0], np.array([0.5, 0.5]), place), GRID)


def measure_classes(pipeline: TimedPipeline, classes: ClassFilter, frame: GridFrame) -> None:
    """Record the additional processor time of an update and a forecast with classes."""
    start = time.process_time()
    Pipeline.forecast(pipeline, STEPS)
    between = time.process_time()
    classes.observe(pipeline.tracks, frame, pipeline.window)
    pipeline.forecast_classes(STEPS, classes.cell_prior, classes.posteriors(pipeline.tracks))
    pipeline.seconds[MORE].append(time.process_time() - between - (between - start))


def measure(
    tracker: type[KalmanTracker] | type[FactorGraphTracker], count: int, frames: int
) -> tuple[TimedPipeline, np.ndarray]:
    """The pipeline at the end, and the seconds of each update and forecast together, from frame WARM_UP on."""
    place = BackgroundMap(np.full(GRID.shape, 1e-3, np.float32), np.zeros(GRID.shape, np.float32))
    residence = np.full(table_shape(PERIOD_S), 0.3, np.float32)
    pipeline = TimedPipeline(GRID, PERIOD_S, place, residence, STREET, tracker.estimator)
    calibration = Calibration(IDENTITY, PERIOD_S)
    seconds, classes, seen = [], some_classes(), np.zeros(GRID.shape, np.float32)
    for step in range(frames):
        frame = frame_of(count, step)
        start = time.perf_counter()
        pipeline.update(frame)
        occupancy = pipeline.forecast(STEPS)
        forecast = time.perf_counter()
        calibration.apply(occupancy, seen)
        seconds.append(time.perf_counter() - start)
        pipeline.seconds[CALIBRATION].append(time.perf_counter() - forecast)
        measure_classes(pipeline, classes, frame)
    return pipeline, np.array(seconds[WARM_UP:])


def share_column(pipeline: TimedPipeline, seconds: np.ndarray) -> dict[str, str]:
    """The median of each stage as a share of the time of an update and a forecast together."""
    whole = float(np.median(seconds))
    stages = {stage: float(np.median(times[WARM_UP:])) for stage, times in pipeline.seconds.items()}
    return {stage: f"{100 * time_s / whole:.0f} %" for stage, time_s in stages.items()}


def main(arguments: Sequence[str] | None = None) -> None:
    parser = study_parser(__doc__, "docs/results/trackers/model-free.json")
    parser.add_argument(
        "--frames", type=int, default=FRAMES, help=f"for each number of road users, {WARM_UP} to warm up"
    )
    given = parser.parse_args(arguments)
    print(f"{'tracker':12} {'movers':>6} {'tracks':>6}   update and {STEPS}-step forecast, p50 / p95 ms")
    shares, values, medians = {}, {}, {}
    for tracker in (KalmanTracker, FactorGraphTracker):
        name = registered_name(tracker)
        for count in MOVERS:
            pipeline, seconds = measure(tracker, count, given.frames)
            print(f"{name:12} {count:>6} {len(pipeline.tracks):>6}   {p50_p95(1e3 * seconds, 2):>16}")
        for stage in pipeline.seconds:
            print(f"    {stage:20} {p50_p95(1e3 * np.array(pipeline.seconds[stage][WARM_UP:]), 2):>16}")
        shares[name], medians[name] = share_column(pipeline, seconds), np.median(seconds)
        values[f"{name}, classes"] = shares[name][MORE]
        values[f"{name}, ms"] = p50_p95(1e3 * seconds)
        values[f"{name}, times kalman"] = f"{medians[name] / medians['kalman']:.1f}"
    stages = next(iter(shares.values()))
    table = measured_table(
        ("share of an update and a forecast", *shares),
        [[stage, *(column[stage] for column in shares.values())] for stage in stages],
    )
    write_table(given.out, "time", table, "python -m benchmarks.model_free", values)


if __name__ == "__main__":
    main()
