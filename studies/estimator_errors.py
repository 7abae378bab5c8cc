"""Errors of the Kalman filter and the factor graph as estimators of an object's motion, by what the object does.

`python -m studies.estimator_errors [--runs 200]` (four minutes). Beside them a Kalman filter that leaves out
measurements beyond the factor graph's gate; and each in two regimes, as tracks have them.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from gridtrack.common.geometry import wrap_angle
from gridtrack.trackers.model_free.motion.estimator import MotionEstimator, warm_up
from gridtrack.trackers.model_free.motion.factor_graph import GATE, FactorGraphEstimator
from gridtrack.trackers.model_free.motion.kalman import KalmanEstimator
from gridtrack.trackers.model_free.motion.model import propagate
from gridtrack.trackers.model_free.motion.regimes import SwitchingEstimator
from gridtrack.trackers.model_free.settings import PipelineSettings

from studies.support.measured_motion import FRAMES_PER_SECOND, MODEL, NOISE, Array, measured_poses

FINE = 50
"""Steps of the truth's integration in a period."""


class GatedKalmanEstimator(KalmanEstimator):
    """Leaves a measurement out that lies beyond the gate, as association does in a pipeline."""

    def update(self, pose: Array, covariance: Array) -> None:
        """Take in a measured pose (3,) and its covariance (3, 3), or not."""
        innovation = pose - self.mean[:3]
        innovation[2] = wrap_angle(innovation[2])
        if innovation @ np.linalg.solve(self.covariance[:3, :3] + covariance, innovation) <= GATE:
            super().update(pose, covariance)


STREET = PipelineSettings(
    acceleration=0.0643,
    speed_noise=0.0719,
    turn_acceleration=0.0519,
    manoeuvre_noise=5.2,
    steady_duration_s=9.71,
    manoeuvre_duration_s=2.05,
    velocity_memory_s=22.5,
    initial_speed=5.11,
    initial_turn_rate=0.0511,
)
"""The motion of road users at the junction, found by an early search there, so that figures stay comparable."""
REGIMES = STREET.motion(MODEL.period_s, window_m=20.0)


def in_two_regimes(initiate: Callable[..., MotionEstimator]) -> Callable[..., MotionEstimator]:
    """Two estimators, of steady motion and of manoeuvres, with the street settings in place of MODEL."""
    return lambda pose, covariance, _: SwitchingEstimator(initiate, pose, covariance, REGIMES)


class Scene(NamedTuple):
    """What an object does over 9 s: its speed (m/s) and turn rate (rad/s) by time (s)."""

    speed: Callable[[Array], Array]
    turn_rate: Callable[[Array], Array]
    outliers: float = 0.0
    """The share of its poses that are grossly wrong: anywhere within 1.5 m and 0.5 rad along each axis."""
    gap_s: tuple[float, float] = (0.0, 0.0)
    """From when to when nothing is measured of it."""
    noise: Array = NOISE
    """Covariance (3, 3) of its measured poses."""


def straight_on(time_s: Array) -> Array:
    return np.zeros_like(time_s)


def corner(time_s: Array) -> Array:
    """A quarter turn in 3 s, its rate rising and falling within half a second."""
    return np.interp(time_s, [2.0, 2.5, 5.0, 5.5], [0.0, 0.53, 0.53, 0.0])


def steady(time_s: Array) -> Array:
    return np.full_like(time_s, 6.0)


def stop_and_go(time_s: Array) -> Array:
    return np.interp(time_s, [2.0, 5.0, 6.5, 9.0], [6.0, 0.0, 0.0, 5.0])


def emergency_stop(time_s: Array) -> Array:
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


def truth_of(scene: Scene) -> Array:
    """True states (N, 6) at every frame of 9 s."""
    dt = MODEL.period_s / FINE
    times_s = np.arange(round(9.0 / dt), dtype=np.float64) * dt
    speed, rate = scene.speed(times_s), scene.turn_rate(times_s)
    heading = 0.3 + np.cumsum(rate) * dt
    velocity = speed[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    states = np.column_stack([np.cumsum(velocity, axis=0) * dt, heading, velocity, rate])
    return np.asarray(states[::FINE], np.float64)


def squared_errors(kind: Callable[..., MotionEstimator], scene: Scene, truth: Array, seed: int) -> Array:
    """Mean squared errors (3,) of position, velocity and position a second ahead, from the second second on."""
    poses = measured_poses(truth, scene.noise, scene.outliers, np.random.default_rng(seed))
    track = kind(poses[0], scene.noise, MODEL)
    means, covariances = [track.mean], [track.covariance]
    for frame, pose in enumerate(poses[1:], 1):
        track.predict()
        if not scene.gap_s[0] <= frame * MODEL.period_s < scene.gap_s[1]:
            track.update(pose, scene.noise)
        means.append(track.mean)
        covariances.append(track.covariance)
    ahead, _ = propagate(np.array(means), np.array(covariances), FRAMES_PER_SECOND, MODEL)
    off = ahead[FRAMES_PER_SECOND:, 0] - truth[FRAMES_PER_SECOND:]
    forecast_off = (
        ahead[FRAMES_PER_SECOND:-FRAMES_PER_SECOND, FRAMES_PER_SECOND, :2] - truth[2 * FRAMES_PER_SECOND :, :2]
    )
    return np.array([(part**2).sum(axis=1).mean() for part in (off[:, :2], off[:, 3:5], forecast_off)])


def root(squares: Array) -> tuple[Array, Array]:
    """Root mean squares (3,) of runs' `squares` (R, 3), and what each run adds to them, to first order (R, 3)."""
    level = np.sqrt(squares.mean(axis=0))
    return level, (squares - squares.mean(axis=0)) / (2.0 * level)


def print_errors(runs: int) -> None:
    print(f"RMS error over {runs} runs, 95 % intervals (normal, by run; differences are paired):")
    print("| object | estimator | position, m | velocity, m/s | 1 s ahead, m |\n|---|---|---:|---:|---:|")
    alone: dict[str, Callable[..., MotionEstimator]] = {
        "factor graph": FactorGraphEstimator,
        "Kalman filter": KalmanEstimator,
        "gated Kalman filter": GatedKalmanEstimator,
    }
    in_tracks = {f"two {label}s": in_two_regimes(kind) for label, kind in alone.items()}
    for name, scene in SCENES.items():
        for kinds in (alone, in_tracks):
            print_scene(name, scene, kinds, runs)


def print_scene(name: str, scene: Scene, kinds: Mapping[str, Callable[..., MotionEstimator]], runs: int) -> None:
    """Each of `kinds`, and the first less each of the others."""
    truth, found = truth_of(scene), {}
    for label, kind in kinds.items():
        found[label] = root(np.array([squared_errors(kind, scene, truth, seed) for seed in range(runs)]))
        print_error(name, label, *found[label])
    (first, (level, parts)), *others = found.items()
    for label, (other, other_parts) in others:
        print_error(name, f"{first} less {label}", level - other, parts - other_parts)


def print_error(scene: str, label: str, values: Array, parts: Array) -> None:
    """`values` (3,) with the interval that follows from what each run adds to them, `parts` (R, 3)."""
    reach = 1.96 * parts.std(axis=0, ddof=1) / np.sqrt(len(parts))
    cells = " | ".join(f"{value:.3f} ± {width:.3f}" for value, width in zip(values, reach, strict=True))
    print(f"| {scene} | {label} | {cells} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--runs", type=int, default=200)
    runs = parser.parse_args().runs
    for kind in (KalmanEstimator, FactorGraphEstimator):
        warm_up(kind, MODEL)
    print_errors(runs)


if __name__ == "__main__":
    main()
