"""Kalman filter and factor graph as estimators of an object's motion: time, errors, and an hour of frames.

Beside them in the table of errors: a Kalman filter that leaves out what lies beyond the factor graph's gate; and each
in two regimes, as tracks have them.

Run it by itself: `python -m benchmarks.estimators [--runs 200]` (about eight minutes). Aims: an update in 0.1 ms
(Kalman filter) and 0.4 ms (factor graph) a track; 30 tracks and their forecast within 25 ms at p95; an hour
at 8 Hz without growth of memory or of time. Times are processor time of one thread: other work is felt in caches only.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
import psutil

from gridtrack.common.geometry import wrap_angle
from gridtrack.trackers.model_free.motion.estimator import MotionEstimator, warm_up
from gridtrack.trackers.model_free.motion.factor_graph import GATE, FactorGraphEstimator
from gridtrack.trackers.model_free.motion.kalman import KalmanEstimator
from gridtrack.trackers.model_free.motion.model import propagate
from gridtrack.trackers.model_free.motion.parameters import MotionModel
from gridtrack.trackers.model_free.motion.regimes import SwitchingEstimator
from gridtrack.trackers.model_free.tuning import STARTS


class GatedKalmanEstimator(KalmanEstimator):
    """Leaves a measurement out that lies beyond the gate, as association does in a pipeline."""

    def update(self, pose: np.ndarray, covariance: np.ndarray) -> None:
        """Take in a measured pose (3,) and its covariance (3, 3), or not."""
        innovation = pose - self.mean[:3]
        innovation[2] = wrap_angle(innovation[2])
        if innovation @ np.linalg.solve(self.covariance[:3, :3] + covariance, innovation) <= GATE:
            super().update(pose, covariance)


ESTIMATORS: dict[str, Callable[..., MotionEstimator]] = {
    "Kalman filter": KalmanEstimator,
    "factor graph": FactorGraphEstimator,
}
MODEL = MotionModel(
    acceleration=0.7,
    surge=0.001,
    turn_acceleration=0.3,
    velocity_memory_s=20.0,
    turn_memory_s=3.0,
    initial_speed=5.0,
    initial_turn_rate=0.2,
    period_s=0.125,
)
NOISE = np.diag([0.06, 0.06, 0.04]) ** 2
"""Of a vehicle's pose measured in cells of 0.1 m: metres, metres, radians."""
STEPS, SECOND, TRACKS, FINE = 20, 8, 30, 50
"""Of a forecast; frames in a second; live tracks at a time; steps of the truth's integration in a period."""


REGIMES = STARTS[1].motion(MODEL.period_s)


def as_tracks_have(begin: Callable[..., MotionEstimator]) -> Callable[..., MotionEstimator]:
    """Two of them, steady and agile, with a street's settings in place of the model's."""
    return lambda pose, covariance, _: SwitchingEstimator(begin, pose, covariance, REGIMES)


class Scene(NamedTuple):
    """What an object does over 9 s, by the time in seconds: its speed (m/s) and turn rate (rad/s)."""

    speed: Callable[[np.ndarray], np.ndarray]
    turn_rate: Callable[[np.ndarray], np.ndarray]
    outliers: float = 0.0
    """The share of its poses that are grossly wrong: anywhere within 1.5 m and 0.5 rad along each axis."""
    gap_s: tuple[float, float] = (0.0, 0.0)
    """From when to when nothing is measured of it."""
    noise: np.ndarray = NOISE
    """Covariance (3, 3) of its measured poses."""


def straight_on(time_s: np.ndarray) -> np.ndarray:
    return np.zeros_like(time_s)


def corner(time_s: np.ndarray) -> np.ndarray:
    """A quarter turn in 3 s, its rate coming and going in half a second."""
    return np.interp(time_s, [2.0, 2.5, 5.0, 5.5], [0.0, 0.53, 0.53, 0.0])


def steady(time_s: np.ndarray) -> np.ndarray:
    return np.full_like(time_s, 6.0)


def stop_and_go(time_s: np.ndarray) -> np.ndarray:
    return np.interp(time_s, [2.0, 5.0, 6.5, 9.0], [6.0, 0.0, 0.0, 5.0])


def emergency_stop(time_s: np.ndarray) -> np.ndarray:
    return np.interp(time_s, [4.0, 4.75], [6.0, 0.0])


SCENES = {
    "straight": Scene(steady, straight_on),
    "turn": Scene(steady, corner),
    "stop and go": Scene(stop_and_go, straight_on),
    "emergency stop": Scene(emergency_stop, straight_on),
    "turn, 5 % outliers": Scene(steady, corner, outliers=0.05),
    "turn, unseen for 1 s": Scene(steady, corner, gap_s=(3.0, 4.0)),
    "turn, heading unseen": Scene(steady, corner, noise=np.diag([0.06, 0.06, 10.0]) ** 2),
}


def truth_of(scene: Scene) -> np.ndarray:
    """True states (N, 6) at every frame of 9 s."""
    dt = MODEL.period_s / FINE
    moments = np.arange(round(9.0 / dt)) * dt
    speed, rate = scene.speed(moments), scene.turn_rate(moments)
    heading = 0.3 + np.cumsum(rate) * dt
    velocity = speed[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    return np.column_stack([np.cumsum(velocity, axis=0) * dt, heading, velocity, rate])[::FINE]


def poses_of(truth: np.ndarray, noise: np.ndarray, outliers: float, rng: np.random.Generator) -> np.ndarray:
    """Measured poses (N, 3) of true states (N, 6); none of the first three is grossly wrong."""
    poses = truth[:, :3] + rng.multivariate_normal(np.zeros(3), noise, len(truth))
    wrong = rng.random(len(truth)) < outliers
    wrong[:3] = False
    poses[wrong] += rng.uniform(-1.0, 1.0, (wrong.sum(), 3)) * [1.5, 1.5, 0.5]
    return poses


def squared_errors(kind: Callable[..., MotionEstimator], scene: Scene, truth: np.ndarray, seed: int) -> np.ndarray:
    """Mean squared errors (3,) of position, velocity and position a second ahead, from the second second on."""
    poses = poses_of(truth, scene.noise, scene.outliers, np.random.default_rng(seed))
    track = kind(poses[0], scene.noise, MODEL)
    means, covariances = [track.mean], [track.covariance]
    for frame, pose in enumerate(poses[1:], 1):
        track.predict()
        if not scene.gap_s[0] <= frame * MODEL.period_s < scene.gap_s[1]:
            track.update(pose, scene.noise)
        means.append(track.mean)
        covariances.append(track.covariance)
    ahead, _ = propagate(np.array(means), np.array(covariances), SECOND, MODEL)
    off = ahead[SECOND:, 0] - truth[SECOND:]
    forecast_off = ahead[SECOND:-SECOND, SECOND, :2] - truth[2 * SECOND :, :2]
    return np.array([(part**2).sum(axis=1).mean() for part in (off[:, :2], off[:, 3:5], forecast_off)])


def root(squares: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Root mean squares (3,) of runs' `squares` (R, 3), and what each run adds to them, to first order (R, 3)."""
    level = np.sqrt(squares.mean(axis=0))
    return level, (squares - squares.mean(axis=0)) / (2.0 * level)


def print_errors(runs: int) -> None:
    print(f"RMS error over {runs} runs, 95 % intervals (normal, by run; differences are paired):")
    print("| object | estimator | position, m | velocity, m/s | 1 s ahead, m |\n|---|---|---:|---:|---:|")
    alone = {
        "factor graph": FactorGraphEstimator,
        "Kalman filter": KalmanEstimator,
        "gated Kalman filter": GatedKalmanEstimator,
    }
    in_tracks = {f"two {label}s": as_tracks_have(kind) for label, kind in alone.items()}
    for name, scene in SCENES.items():
        for kinds in (alone, in_tracks):
            print_scene(name, scene, kinds, runs)


def print_scene(name: str, scene: Scene, kinds: Mapping[str, Callable[..., MotionEstimator]], runs: int) -> None:
    """Each of `kinds`, and the first less each of the others."""
    truth, found = truth_of(scene), {}
    for label, kind in kinds.items():
        found[label] = root(np.array([squared_errors(kind, scene, truth, seed) for seed in range(runs)]))
        print_row(name, label, *found[label])
    (first, (level, parts)), *others = found.items()
    for label, (other, other_parts) in others:
        print_row(name, f"{first} less {label}", level - other, parts - other_parts)


def print_row(scene: str, label: str, values: np.ndarray, parts: np.ndarray) -> None:
    """`values` (3,) with the interval that follows from what each run adds to them, `parts` (R, 3)."""
    reach = 1.96 * parts.std(axis=0, ddof=1) / np.sqrt(len(parts))
    cells = " | ".join(f"{value:.3f} ± {width:.3f}" for value, width in zip(values, reach, strict=True))
    print(f"| {scene} | {label} | {cells} |", flush=True)


def print_times(frames: int = 300) -> None:
    print("processor time, ms: median / p95")
    print(f"{'':16}{'one track':>18}{f'{TRACKS} tracks and their {STEPS}-step forecast':>46}")
    for label, kind in ESTIMATORS.items():
        poses = circling(frames, TRACKS)
        tracks = [kind(pose, NOISE, MODEL) for pose in poses[0]]
        each, together = [], []
        for seen in poses[1:]:
            begin = time.thread_time()
            for track, pose in zip(tracks, seen, strict=True):
                start = time.thread_time()
                track.predict()
                track.update(pose, NOISE)
                each.append(time.thread_time() - start)
            propagate(np.stack([t.mean for t in tracks]), np.stack([t.covariance for t in tracks]), STEPS, MODEL)
            together.append(time.thread_time() - begin)
        print(f"{label:16}{spread(each):>18}{spread(together):>46}")


def circling(frames: int, tracks: int) -> np.ndarray:
    """Measured poses (frames, tracks, 3) of objects on a circle of 8 m at 4 m/s, 5 % of them grossly wrong."""
    angle = 0.5 * MODEL.period_s * np.arange(frames)
    truth = np.column_stack([8.0 * np.sin(angle), -8.0 * np.cos(angle), angle])
    rng = np.random.default_rng(0)
    return np.stack([poses_of(truth, NOISE, 0.05, rng) for _ in range(tracks)], axis=1)


def spread(seconds: list[float]) -> str:
    median, most = np.percentile(1e3 * np.array(seconds), [50, 95])
    return f"{median:.3f} / {most:.3f}"


def print_hour(tracks: int = 3) -> None:
    frames, quarter, process = 3600 * SECOND, 900 * SECOND, psutil.Process()
    poses = circling(frames, tracks)
    for label, kind in ESTIMATORS.items():
        print(f"{label}, an hour: {frames} frames, {tracks} tracks, every tenth second unseen; by the quarter")
        followed, start = [kind(pose, NOISE, MODEL) for pose in poses[0]], time.thread_time()
        for frame in range(1, frames):
            for track, pose in zip(followed, poses[frame], strict=True):
                track.predict()
                if frame // SECOND % 10 != 9:
                    track.update(pose, NOISE)
            if (frame + 1) % quarter == 0:
                took_ms, start = 1e3 * (time.thread_time() - start), time.thread_time()
                memory_mb, restarts = process.memory_info().rss / 2**20, sum(track.restarts for track in followed)
                thousand_ms = 1e3 * took_ms / (quarter * tracks)
                print(f"{thousand_ms:9.1f} ms a thousand steps {memory_mb:9.1f} MiB {restarts:4} restarts", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=200)
    arguments = parser.parse_args()
    for kind in ESTIMATORS.values():
        warm_up(kind, MODEL)
    print_times()
    print_errors(arguments.runs)
    print_hour()


if __name__ == "__main__":
    main()
