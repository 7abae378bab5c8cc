"""The model-free pipeline beside Stone Soup's trackers on the same clusters: error and time.

`python -m benchmarks.stone_soup` (ten minutes). Round people walk through a hall with a laser and occlude one another.
Every tracker gets the clusters of our segmentation in the same grid frames, and has the same motion and measurement
noise. Stone Soup's trackers are Kalman filters with global nearest neighbours and with joint probabilistic data
association (by loopy belief propagation). Initiation and deletion of tracks are tuned for each tracker on a separate
seed, by the measure of the comparison: Stone Soup's OSPA (cut-off 1 m, order 1) to the people who were seen within the
last second.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta

import numpy as np
from numpy.typing import NDArray
from stonesoup.dataassociator.neighbour import GNNWith2DAssignment
from stonesoup.dataassociator.probability import JPDAwithLBP
from stonesoup.deleter.time import UpdateTimeStepsDeleter
from stonesoup.hypothesiser.distance import DistanceHypothesiser
from stonesoup.hypothesiser.probability import PDAHypothesiser
from stonesoup.initiator.simple import MultiMeasurementInitiator
from stonesoup.measures import Euclidean, Mahalanobis
from stonesoup.metricgenerator.ospametric import OSPAMetric
from stonesoup.models.measurement.linear import LinearGaussian
from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, OrnsteinUhlenbeck
from stonesoup.predictor.kalman import KalmanPredictor
from stonesoup.tracker.simple import MultiTargetMixtureTracker, MultiTargetTracker
from stonesoup.types.detection import Detection
from stonesoup.types.state import GaussianState, State
from stonesoup.updater.kalman import KalmanUpdater

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec
from gridtrack.common.raycast import cast_scan
from gridtrack.common.scene import Scene, SceneObject
from gridtrack.simulation.laser import Laser
from gridtrack.trackers.model_free.background import BackgroundMap
from gridtrack.trackers.model_free.forecast import objects
from gridtrack.trackers.model_free.kalman import KalmanEstimator
from gridtrack.trackers.model_free.pipeline import Pipeline
from gridtrack.trackers.model_free.residence import table_shape
from gridtrack.trackers.model_free.segmentation import clusters_of, segment
from gridtrack.trackers.model_free.settings import PipelineSettings

from studies.support.results_file import ResultTable, measured_table, study_parser, write_table

GRID = GridSpec(100, 0.2, (0.0, -10.0))
PERIOD_S = 0.125
RADIUS_M = 0.25
SPEED, TURN_MEMORY_S, WANDER = 1.2, 3.0, 0.35
"""Metres a second; walkers keep their velocity for some seconds and accelerate at random, m/s^2 per sqrt(Hz)."""
BEGIN = datetime(2026, 1, 1)
CUT_OFF_M = 1.0
POSITION_NOISE_M = 0.1
Array = NDArray[np.float64]


@dataclass(frozen=True)
class HallFrame:
    """A frame, and the positions (N, 2) of the people who were seen within the last second."""

    frame: GridFrame
    people: Array


def walks(people: int, frames: int, random: np.random.Generator) -> Iterator[Array]:
    """Positions (N, 2) of each frame: integrated Ornstein-Uhlenbeck velocities, turned back at the hall's sides."""
    low, high = np.array([2.0, -8.5]), np.array([18.5, 8.5])
    place = random.uniform(low, high, (people, 2))
    velocity = random.normal(0.0, SPEED / math.sqrt(2), (people, 2))
    for _ in range(frames):
        velocity += WANDER * math.sqrt(PERIOD_S) * random.standard_normal((people, 2))
        velocity *= SPEED / np.maximum(np.linalg.norm(velocity, axis=1, keepdims=True), SPEED)
        place = place + velocity * PERIOD_S
        velocity = np.where((place < low) & (velocity < 0) | (place > high) & (velocity > 0), -velocity, velocity)
        yield place


def seen_in(places: Array, laser: Laser, random: np.random.Generator, step: int) -> tuple[GridFrame, NDArray[np.bool_]]:
    """The frame, and whether a beam met each person (N,)."""
    angles = np.arange(16) * math.tau / 16
    disc = (RADIUS_M * np.stack([np.cos(angles), np.sin(angles)], axis=1)).astype(np.float32)
    bodies = tuple(SceneObject(n, n, SE2(x, y, 0.0), disc) for n, (x, y) in enumerate(places.tolist()))
    scan = laser.scan(Scene((), 255, bodies), round(step * PERIOD_S * 1e9), laser.pose, random)
    assert scan.labels is not None  # a laser that sees labelled bodies
    visible, occupied = np.zeros(GRID.shape, bool), np.zeros(GRID.shape, bool)
    cast_scan(scan, GRID, laser.pose, visible, occupied)
    points = GRID.cell_centres(occupied)
    origins = np.array([[laser.x, laser.y]], np.float32)
    frame = GridFrame(scan.stamp_ns, visible, occupied, SE2(), origins, points, np.zeros(len(points), np.uint8))
    return frame, np.isin(np.arange(len(places)), scan.labels)


def hall(people: int, frames: int, seed: int) -> list[HallFrame]:
    random, laser = np.random.default_rng(seed), Laser(x=0.5)
    last_seen = np.full(people, -(10**6))
    hall_frames = []
    for step, places in enumerate(walks(people, frames, random)):
        frame, seen = seen_in(places, laser, random, step)
        last_seen[seen] = step
        hall_frames.append(HallFrame(frame, places[step - last_seen <= 1.0 / PERIOD_S]))
    return hall_frames


Results = dict[str, list[tuple[float, Array]]]
Tracked = tuple[list[Array], list[float]]
"""Positions (N, 2) found in each frame, and its processor time, seconds."""


def centres_of(hall_frames: list[HallFrame], settings: PipelineSettings) -> Tracked:
    """Centres (C, 2) of the clusters in each frame, and the time of segmentation."""
    found, seconds = [], []
    for frame in (one.frame for one in hall_frames):
        begun = time.thread_time()
        points = frame.points.astype(np.float64)
        ranges = np.linalg.norm(points - frame.origins[0], axis=1)
        labels = segment(points, ranges, settings.link_m, settings.link_per_m)
        clusters = clusters_of(points, np.zeros(len(points), bool), labels)
        found.append(np.array([cluster.centre for cluster in clusters]).reshape(-1, 2))
        seconds.append(time.thread_time() - begun)
    return found, seconds


def ours(hall_frames: list[HallFrame], settings: PipelineSettings) -> Tracked:
    """The pipeline with Kalman filters, segmentation and all."""
    empty = BackgroundMap(np.full(GRID.shape, 1e-3, np.float32), np.zeros(GRID.shape, np.float32))
    residence = np.full(table_shape(PERIOD_S), 0.1, np.float32)
    pipeline = Pipeline(GRID, PERIOD_S, empty, residence, settings, KalmanEstimator)
    found, seconds = [], []
    for one in hall_frames:
        begun = time.thread_time()
        pipeline.update(one.frame)
        seconds.append(time.thread_time() - begun)
        found.append(np.array([one.box[:2] for one in objects(pipeline.tracks, pipeline.window)], float).reshape(-1, 2))
    return found, seconds


@dataclass(frozen=True)
class Life:
    """Initiation and deletion of Stone Soup's tracks."""

    min_points: int
    coast_steps: int


def stone_soup(segmented: Tracked, settings: PipelineSettings, life: Life, *, joint: bool) -> Tracked:
    """Stone Soup's multi-target tracker on clusters: global nearest neighbour, or joint probabilistic.

    The time includes the segmentation, which both need.
    """
    clusters, begun_with = segmented
    axis = OrnsteinUhlenbeck(settings.acceleration**2, 1.0 / settings.velocity_memory_s)
    predictor = KalmanPredictor(CombinedLinearGaussianTransitionModel([axis, axis]))
    measurement = LinearGaussian(4, (0, 2), np.eye(2) * POSITION_NOISE_M**2)
    updater = KalmanUpdater(measurement)
    gate = math.sqrt(-2.0 * math.log(1.0 - settings.gate_probability))
    nearest = DistanceHypothesiser(predictor, updater, Mahalanobis(), missed_distance=gate)
    probable = PDAHypothesiser(
        predictor, updater, clutter_spatial_density=1e-3, prob_detect=0.85, prob_gate=settings.gate_probability
    )
    associator = JPDAwithLBP(probable) if joint else GNNWith2DAssignment(nearest)
    deleter = UpdateTimeStepsDeleter(life.coast_steps)
    variances = np.diag([POSITION_NOISE_M, settings.initial_speed] * 2) ** 2
    initiator = MultiMeasurementInitiator(
        GaussianState(np.zeros(4), variances), UpdateTimeStepsDeleter(2), GNNWith2DAssignment(nearest), updater,
        measurement, min_points=life.min_points,
    )  # fmt: skip
    stamps = [BEGIN + timedelta(seconds=PERIOD_S * step) for step in range(len(clusters))]
    detections = [
        {Detection(centre[:, None], timestamp=stamp, measurement_model=measurement) for centre in centres}
        for stamp, centres in zip(stamps, clusters, strict=True)
    ]
    kind = MultiTargetMixtureTracker if joint else MultiTargetTracker
    tracker = iter(kind(initiator, deleter, zip(stamps, detections, strict=True), associator, updater))
    found, seconds = [], []
    for _ in stamps:
        begun = time.thread_time()
        _, tracks = next(tracker)
        seconds.append(time.thread_time() - begun)
        found.append(np.array([track.state_vector[(0, 2), 0] for track in tracks], float).reshape(-1, 2))
    return found, [a + b for a, b in zip(begun_with, seconds, strict=True)]


def ospa(found: list[Array], hall_frames: list[HallFrame]) -> Array:
    """OSPA of every frame after the first two seconds, metres."""
    metric = OSPAMetric(p=1, c=CUT_OFF_M, measure=Euclidean())

    def states(positions: Array, stamp: datetime) -> list[State]:
        return [State(position, timestamp=stamp) for position in positions]

    each = zip(found, hall_frames, strict=True)
    values = [
        metric.compute_OSPA_distance(states(tracks, BEGIN), states(one.people, BEGIN)).value
        for tracks, one in itertools.islice(each, round(2.0 / PERIOD_S), None)
    ]
    return np.array(values, float)


def best_life(hall_frames: list[HallFrame], clusters: Tracked, settings: PipelineSettings, *, joint: bool) -> Life:
    """The life of Stone Soup's tracks with the least OSPA."""
    lives = [Life(*each) for each in itertools.product((2, 4), (4, 8, 16))]
    return min(lives, key=lambda life: ospa(stone_soup(clusters, settings, life, joint=joint)[0], hall_frames).mean())


def best_settings(hall_frames: list[HallFrame], settings: PipelineSettings) -> PipelineSettings:
    """Our settings with the least OSPA: probabilities of confirmation and deletion, and mean lifetime."""
    each = itertools.product((0.6, 0.8), (0.1, 0.3), (2.0, 15.0))
    tried = [
        settings.model_copy(update={"confirm_above": c, "delete_below": d, "mean_lifetime_s": life})
        for c, d, life in each
    ]
    return min(tried, key=lambda one: ospa(ours(hall_frames, one)[0], hall_frames).mean())


def compared(people: int, frames: int, seeds: range) -> Results:
    """Mean OSPA, metres, and milliseconds per frame for every seed, by tracker, ours first."""
    settings = PipelineSettings(
        acceleration=WANDER, manoeuvre_noise=1.0, velocity_memory_s=TURN_MEMORY_S, initial_speed=SPEED
    )
    practice = hall(people, frames, seeds.start - 1)
    clusters = centres_of(practice, settings)
    lives = {joint: best_life(practice, clusters, settings, joint=joint) for joint in (False, True)}
    settings = best_settings(practice, settings)
    print(f"{people} people, {frames} frames, {len(seeds)} seeds; {lives}")
    print(
        f"ours: confirmed above {settings.confirm_above}, deleted below {settings.delete_below},"
        f" mean lifetime {settings.mean_lifetime_s} s"
    )
    results: Results = {}
    for seed in seeds:
        hall_frames = hall(people, frames, seed)
        clusters = centres_of(hall_frames, settings)
        runs: dict[str, Callable[[], Tracked]] = {
            "the pipeline of `kalman`": lambda m=hall_frames: ours(m, settings),
            "Stone Soup, Kalman filter, global nearest neighbour": lambda c=clusters: stone_soup(
                c, settings, lives[False], joint=False
            ),
            "Stone Soup, Kalman filter, JPDA (loopy belief propagation)": lambda c=clusters: stone_soup(
                c, settings, lives[True], joint=True
            ),
        }
        for name, run in runs.items():
            found, seconds = run()
            results.setdefault(name, []).append((float(ospa(found, hall_frames).mean()), 1e3 * np.array(seconds)))
    return results


def table_of(results: Results) -> ResultTable:
    """Mean OSPA, its difference from ours (paired by seed, with a 95 % interval), and the median time, times ours."""
    (_, base), *_ = results.items()
    base_ms = np.median(np.concatenate([times for _, times in base]))
    rows = []
    for name, each in results.items():
        distance = np.array([one for one, _ in each])
        less = distance - np.array([one for one, _ in base])
        spread = 1.96 * less.std(ddof=1) / math.sqrt(len(less)) if len(less) > 1 else math.nan
        ratio = np.median(np.concatenate([times for _, times in each])) / base_ms
        difference = "" if each is base else f"{less.mean():+.3f} ± {spread:.3f}"
        rows.append([name, f"{distance.mean():.3f}", difference, f"{ratio:.1f}"])
    return measured_table(("", "OSPA, m", "less ours", "time of an update, times ours"), rows)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = study_parser(__doc__, "docs/results/trackers/model-free.json")
    parser.add_argument("--people", type=int, default=30)
    parser.add_argument("--frames", type=int, default=160)
    parser.add_argument("--seeds", type=int, default=5)
    given = parser.parse_args(arguments)
    table = table_of(compared(given.people, given.frames, range(1, 1 + given.seeds)))
    print(table.markdown())
    command = f"python -m benchmarks.stone_soup --frames {given.frames} --seeds {given.seeds}"
    write_table(given.out, "beside stone soup", table, command)


if __name__ == "__main__":
    main()
