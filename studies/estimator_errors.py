"""Errors of the Kalman filter and the factor graph as estimators of an object's motion, by manoeuvre.

`python -m studies.estimator_errors [--runs 200] [--out FILE]` (ten minutes). Beside them a Kalman filter that ignores
measurements beyond the gate of the factor graph, and each estimator in two regimes, as tracks use it. RMS errors over
the runs; differences are paired by run, with normal 95 % intervals. Their speed: `benchmarks/estimators.py`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.geometry import wrap_angle
from gridtrack.trackers.model_free.estimators import MotionEstimator, SwitchingEstimator, warm_up
from gridtrack.trackers.model_free.factor_graph import GATE, FactorGraphEstimator
from gridtrack.trackers.model_free.kalman import KalmanEstimator
from gridtrack.trackers.model_free.motion import MotionModel, propagate
from gridtrack.trackers.model_free.settings import PipelineSettings

from studies.support.results_file import ResultSection, measured_table, study_parser, write_section

Array = NDArray[np.float64]
MODEL = MotionModel(
    acceleration=0.7,
    speed_noise=0.001,
    turn_acceleration=0.3,
    velocity_memory_s=20.0,
    turn_memory_s=3.0,
    initial_speed=5.0,
    initial_turn_rate=0.2,
    period_s=0.125,
)
NOISE = np.diag([0.06, 0.06, 0.04]) ** 2
"""Covariance of the measured pose of a vehicle, in cells of 0.1 m: metres, metres, radians."""
FRAMES_PER_SECOND = 8
FINE = 50
"""Integration steps of the truth per period."""


class GatedKalmanEstimator(KalmanEstimator):
    """Ignores measurements beyond the gate, as association does in a pipeline."""

    def update(self, pose: Array, covariance: Array) -> None:
        """Take in a measured pose (3,) with its covariance (3, 3), or ignore it."""
        innovation = pose - self.mean[:3]
        innovation[2] = wrap_angle(innovation[2])
        if innovation @ np.linalg.solve(self.covariance[:3, :3] + covariance, innovation) <= GATE:
            super().update(pose, covariance)


Initiate = Callable[..., MotionEstimator]
Errors = tuple[Array, Array]
"""RMS errors (3,) in MEASURES, and the contribution of each run (R, 3)."""
REFERENCE = "factor graph"
ALONE: dict[str, Initiate] = {
    "Kalman": KalmanEstimator,
    "gated Kalman": GatedKalmanEstimator,
    REFERENCE: FactorGraphEstimator,
}
MEASURES = ("position, m", "velocity, m/s", "1 s ahead, m")
SHOWN = tuple(f"{measure}: {label}" for measure in MEASURES[1:] for label in (*ALONE, f"{REFERENCE} less Kalman"))
COMMAND = "python -m studies.estimator_errors"

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
"""Motion of road users at the junction by an early search, kept so that figures stay comparable."""
REGIMES = STREET.motion(MODEL.period_s, window_m=20.0)


def in_two_regimes(initiate: Initiate) -> Initiate:
    """Two estimators, of steady motion and of manoeuvres, with the street settings in place of MODEL."""
    return lambda pose, covariance, _: SwitchingEstimator(initiate, pose, covariance, REGIMES)


class Scene(NamedTuple):
    """The motion of an object over 9 s: speed (m/s) and turn rate (rad/s) by time (s)."""

    speed: Callable[[Array], Array]
    turn_rate: Callable[[Array], Array]
    outliers: float = 0.0
    """Share of measured poses that are grossly wrong."""
    gap_s: tuple[float, float] = (0.0, 0.0)
    """Begin and end of a time without measurements."""
    noise: Array = NOISE
    """Covariance (3, 3) of the measured poses."""


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
    "turn, heading not measured": Scene(steady, corner, noise=np.diag([0.06, 0.06, 10.0]) ** 2),
    "turn, unseen for 1 s": Scene(steady, corner, gap_s=(3.0, 4.0)),
    "stop and go, 2 m/s²": Scene(stop_and_go, straight_on),
    "emergency stop, 8 m/s²": Scene(emergency_stop, straight_on),
    "turn, 5 % gross errors": Scene(steady, corner, outliers=0.05),
}


def measured_poses(truth: Array, noise: Array, outliers: float, rng: np.random.Generator) -> Array:
    """Measured poses (N, 3) of true states (N, 6).

    A share `outliers` is wrong by up to 1.5 m and 0.5 rad along each axis, except among the first three.
    """
    poses = truth[:, :3] + rng.multivariate_normal(np.zeros(3), noise, len(truth))
    wrong = rng.random(len(truth)) < outliers
    wrong[:3] = False
    poses[wrong] += rng.uniform(-1.0, 1.0, (wrong.sum(), 3)) * [1.5, 1.5, 0.5]
    return np.asarray(poses, np.float64)


def truth_of(scene: Scene) -> Array:
    """True states (N, 6) at every frame of 9 s."""
    dt = MODEL.period_s / FINE
    times_s = np.arange(round(9.0 / dt), dtype=np.float64) * dt
    speed, rate = scene.speed(times_s), scene.turn_rate(times_s)
    heading = 0.3 + np.cumsum(rate) * dt
    velocity = speed[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    states = np.column_stack([np.cumsum(velocity, axis=0) * dt, heading, velocity, rate])
    return np.asarray(states[::FINE], np.float64)


def squared_errors(kind: Initiate, scene: Scene, truth: Array, seed: int) -> Array:
    """Mean squared errors (3,) of position, velocity and position a second ahead, after the first second."""
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


def root(squares: Array) -> Errors:
    """Root mean squares (3,) over the runs of `squares` (R, 3), and first-order contributions of the runs (R, 3)."""
    level = np.sqrt(squares.mean(axis=0))
    return level, (squares - squares.mean(axis=0)) / (2.0 * level)


def differences_of(scene: Scene, initiate: Mapping[str, Initiate], runs: int) -> dict[str, Errors]:
    """RMS errors of each estimator, and of REFERENCE less each other estimator."""
    truth = truth_of(scene)
    found = {
        name: root(np.array([squared_errors(kind, scene, truth, seed) for seed in range(runs)]))
        for name, kind in initiate.items()
    }
    level, parts = found[REFERENCE]
    others = {name: of for name, of in found.items() if name != REFERENCE}
    less = {f"{REFERENCE} less {name}": (level - other, parts - own) for name, (other, own) in others.items()}
    return found | less


def error_text(errors: Errors, measure: int, *, paired: bool) -> str:
    """`0.267`, or a difference with half the width of its 95 % interval."""
    level, parts = errors[0][measure], errors[1][:, measure]
    reach = 1.96 * parts.std(ddof=1) / np.sqrt(len(parts))
    return f"{level:+.3f} ± {reach:.3f}" if paired else f"{level:.3f}"


def section(initiate: Mapping[str, Initiate], runs: int) -> ResultSection:
    """Errors in every scene: the columns SHOWN as a table, all of them as values."""
    rows: list[list[str]] = []
    values: dict[str, str] = {}
    for name, scene in SCENES.items():
        found = differences_of(scene, initiate, runs)
        texts = {
            f"{measure}: {label}": error_text(errors, number, paired=" less " in label)
            for number, measure in enumerate(MEASURES)
            for label, errors in found.items()
        }
        rows.append([name, *(texts[column] for column in SHOWN)])
        values |= {f"{name}: {column}": text for column, text in texts.items()}
        print(" | ".join(rows[-1]), flush=True)
    table = measured_table(("object", *SHOWN), rows)
    return ResultSection(command=f"{COMMAND} --runs {runs}", tables={"table": table}, values=values)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = study_parser(__doc__, "docs/results/trackers/estimators.json")
    parser.add_argument("--runs", type=int, default=200)
    given = parser.parse_args(arguments)
    for kind in (KalmanEstimator, FactorGraphEstimator):
        warm_up(kind, MODEL)
    in_tracks = {name: in_two_regimes(kind) for name, kind in ALONE.items()}
    for name, initiate in {"errors": ALONE, "errors in two regimes": in_tracks}.items():
        print(name)
        write_section(given.out, name, section(initiate, given.runs))


if __name__ == "__main__":
    main()
