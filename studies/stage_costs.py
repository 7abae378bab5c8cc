"""What each stage of the model-free pipeline costs in F1: the junction with the truth in a stage's place.

Run it by itself: `python -m studies.stage_costs [kalman|factor-graph]`. The validation recording, scored as while
tuning (moving and visible cells, each step's best threshold), as the pipeline is and then with one thing from the
truth: all returns of a body as one cluster; how the body has moved since it was first matched, in place of each later
match; the velocity and turn rate of every track that is seen, or of those that are at most a second old, at the time of
the forecast.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from gridtrack.common.geometry import SE2, wrap_angle
from gridtrack.common.grid import GridFrame, GridSpec
from gridtrack.common.scene import SceneObject
from gridtrack.evaluation.comparison.learned import find_weights
from gridtrack.evaluation.scoring.in_process import score_in_process
from gridtrack.recordings.stream import GridStream, Observation, open_stream
from gridtrack.trackers import registry
from gridtrack.trackers.contract import Forecast, stream_of
from gridtrack.trackers.model_free.matches import Match
from gridtrack.trackers.model_free.segmentation import Cluster, joined
from gridtrack.trackers.model_free.tracker import ModelFreeTracker
from gridtrack.trackers.model_free.tracks import Track

from studies.stage_errors import most
from studies.velocity_errors import JUNCTION, bodies, cells_of, rigid_velocity

STEPS, HORIZONS = 20, {"0.5 s": 4, "1 s": 8, "2 s": 16}
YOUNG_S = 1.0
VELOCITY_SD, TURN_RATE_SD = 0.03, 0.01
POSE_SD = 0.03
"""How well the truth is known, m/s, rad/s, and m and rad."""


class Truth(NamedTuple):
    """Of one frame: the number of the body on each cell (M, M), -1 for none, and the bodies before, now and after."""

    owner: np.ndarray
    before: dict[int, SceneObject]
    now: dict[int, SceneObject]
    after: dict[int, SceneObject]
    elapsed_s: float
    world_T_grid: SE2

    def motion(self, body: int, at: np.ndarray) -> tuple[np.ndarray, float] | None:
        """Velocity (2,) of the body at a point (1, 2), grid frame, and its turn rate; None at its first and last."""
        if body not in self.before or body not in self.after:
            return None
        poses = self.before[body].world_T_object, self.after[body].world_T_object
        turned = wrap_angle(poses[1].theta - poses[0].theta)
        return rigid_velocity(*poses, self.elapsed_s, self.world_T_grid, at).mean(axis=1), turned / self.elapsed_s


def truths(observations: Sequence[Observation], grid: GridSpec) -> dict[int, Truth]:
    """By stamp."""
    centres, found = grid.cell_centres(np.ones(grid.shape, bool)), {}
    for number, now in enumerate(observations):
        before, after = observations[max(number - 1, 0)], observations[min(number + 1, len(observations) - 1)]
        owner, occupied = np.full(grid.size**2, -1), now.frame.occupied.reshape(-1)
        for key, body in bodies(now.scene).items():
            owner[cells_of(body, now.frame.world_T_grid, centres, occupied, grid)] = key
        scenes = bodies(before.scene), bodies(now.scene), bodies(after.scene)
        elapsed_s = (after.frame.stamp_ns - before.frame.stamp_ns) * 1e-9
        found[now.frame.stamp_ns] = Truth(owner.reshape(grid.shape), *scenes, elapsed_s, now.frame.world_T_grid)
    return found


def informed(kind: type[ModelFreeTracker], truth: Mapping[int, Truth], told: str) -> type[ModelFreeTracker]:
    """The tracker, but `told` one thing from the truth: `clusters`, `poses`, `velocity`, `young` or nothing."""

    class Informed(kind):  # type: ignore[misc, valid-type]
        def reset(self, seed: int) -> None:
            super().reset(seed)
            self._seen_for: dict[int, int] = {}
            if told == "clusters":
                segment = self._pipeline._segment
                self._pipeline._segment = lambda frame: whole(segment(frame), truth[frame.stamp_ns], self.stream.grid)
            if told == "poses":
                correct, first = self._pipeline._correct, dict[int, tuple[int, SE2]]()
                self._pipeline._correct = lambda shares, matches, visible: correct(
                    shares, posed(self.tracks, shares, matches, first, self._now, self.stream.grid), visible
                )

        def update(self, frame: GridFrame) -> None:
            self._now = truth[frame.stamp_ns]
            super().update(frame)
            for track in self.tracks:
                self._seen_for[track.identity] = self._seen_for.get(track.identity, 0) + (not track.unseen)

        def predict(self, steps: int) -> Forecast:
            wanted = [track for track in self.tracks if told in ("velocity", "young") and not track.unseen]
            if told == "young":
                wanted = [t for t in wanted if self._seen_for[t.identity] * self.stream.period_s <= YOUNG_S]
            estimators = [one for track in wanted for one in track.estimator.estimators]
            kept = [(one, one.mean, one.covariance) for one in estimators]
            for track in wanted:
                tell(track, self._now, self.stream.grid)
            forecast: Forecast = super().predict(steps)
            for one, mean, covariance in kept:
                one.mean, one.covariance = mean, covariance
            return forecast

    return Informed


def tell(track: Track, truth: Truth, grid: GridSpec) -> None:
    """Let the estimators of a track know how the body moves that most of its returns are of."""
    body = owner_of(track.returns, truth, grid)
    motion = None if body is None else truth.motion(body, track.returns.mean(axis=0, keepdims=True))
    if motion is None:
        return
    for estimator in track.estimator.estimators:
        mean, covariance = estimator.mean.copy(), estimator.covariance.copy()
        mean[3:5], mean[5] = motion
        covariance[3:, :] = covariance[:, 3:] = 0.0
        covariance[3:, 3:] = np.diag([VELOCITY_SD, VELOCITY_SD, TURN_RATE_SD]) ** 2
        estimator.mean, estimator.covariance = mean, covariance


def posed(
    tracks: Sequence[Track],
    shares: Mapping[int, Cluster],
    matches: Mapping[int, Match],
    first: dict[int, tuple[int, SE2]],
    truth: Truth,
    grid: GridSpec,
) -> dict[int, Match]:
    """The matches, track number -> match, but after each track's first on a body as that body has moved since.

    `first` is by identity: the body that the track was first matched on, and the track's pose in that body's frame.
    """
    told = {}
    for number, match in matches.items():
        told[number] = match
        body, identity = owner_of(shares[number].points, truth, grid), tracks[number].identity
        if body is None:
            continue
        grid_T_body = truth.world_T_grid.inverse() @ truth.now[body].world_T_object
        if first.get(identity, (None, None))[0] != body:
            first[identity] = body, grid_T_body.inverse() @ SE2(*match.pose.tolist())
            continue
        true, covariance = grid_T_body @ first[identity][1], np.eye(3) * POSE_SD**2
        pose = np.array([true.x, true.y, true.theta])
        if match.covariance[2, 2] > math.pi**2:  # which shows no heading
            pose[2], covariance[2, 2] = match.pose[2], match.covariance[2, 2]
        told[number] = match._replace(pose=pose, covariance=covariance)
    return told


def whole(clusters: Sequence[Cluster], truth: Truth, grid: GridSpec) -> list[Cluster]:
    """The clusters, those of which most returns are of one body as one."""
    of_body: dict[int, list[Cluster]] = {}
    for number, cluster in enumerate(clusters):
        body = owner_of(cluster.points, truth, grid)
        of_body.setdefault(-1 - number if body is None else body, []).append(cluster)
    return [joined(parts) for parts in of_body.values()]


def owner_of(points: np.ndarray, truth: Truth, grid: GridSpec) -> int | None:
    """The body that most of `points` (N, 2) are on."""
    cells, inside = grid.cells_of(points)
    body = most(truth.owner[tuple(cells[inside].T)])
    return None if body < 0 else body


def score(kind: type[ModelFreeTracker], stream: GridStream) -> list[float]:
    """F1 of moving and of visible cells at HORIZONS."""
    learned = find_weights(kind.name, stream.site, None)
    found = score_in_process(kind(stream_of(stream, learned.path if learned else None), kind.Options()), stream, STEPS)
    return [float(found.f1[stratum][step]) for stratum in ("moving", "visible") for step in HORIZONS.values()]


def main() -> None:
    kind = registry.load((sys.argv[1:] or ["kalman"])[0])
    stream = open_stream(JUNCTION / "validation.tracks")
    truth = truths(list(stream.observations()), stream.grid)
    columns = [f"{stratum} {horizon}" for stratum in ("moving", "visible") for horizon in HORIZONS]
    print(f"| {kind.name}, told | {' | '.join(columns)} |\n|---|{'--:|' * len(columns)}")
    for told in ("nothing", "clusters", "poses", "velocity", "young"):
        values = score(informed(kind, truth, told), stream)
        print(f"| {told} | {' | '.join(f'{value:.3f}' for value in values)} |", flush=True)


if __name__ == "__main__":
    main()
