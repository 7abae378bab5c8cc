"""Cost of each stage of the model-free pipeline in F1: the junction with the truth in place of a stage.

`python -m studies.stage_costs [kalman|factor-graph]` (ten minutes). The validation recording is scored as in tuning
(dynamic and visible cells, the best threshold of each step), with the pipeline as it is, and then with one part
replaced by the truth: all returns of a body as one cluster; the motion of the body since its first match, in place of
each later match; velocity and turn rate, when a forecast is made, of all visible tracks, or of those at most a second
old.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.geometry import SE2, wrap_angle
from gridtrack.common.grid import GridFrame, GridSpec, Mask
from gridtrack.common.scene import SceneObject
from gridtrack.evaluation.referee.kinds import regions_of
from gridtrack.evaluation.referee.strata import STRATA
from gridtrack.evaluation.runs.objective import score_in_process
from gridtrack.recordings.observation import Observation
from gridtrack.recordings.stream import GridStream, open_stream
from gridtrack.trackers.contract import Forecast
from gridtrack.trackers.model_free.factor_graph import FactorGraphTracker
from gridtrack.trackers.model_free.kalman import KalmanTracker
from gridtrack.trackers.model_free.matching import Match
from gridtrack.trackers.model_free.pipeline import Pipeline
from gridtrack.trackers.model_free.segmentation import Cluster, joined
from gridtrack.trackers.model_free.tracker import ModelFreeTracker
from gridtrack.trackers.model_free.tracks import Track
from gridtrack.trackers.registry import registered_name

from studies.support.results_file import measured_table, study_parser, write_table
from studies.support.shipped import JUNCTION, STEPS, with_shipped_weights
from studies.support.true_bodies import Points, bodies, body_cells, most_frequent, rigid_velocity

HORIZONS = {"0.5 s": 4, "1 s": 8, "2 s": 16}
YOUNG_S = 1.0
VELOCITY_SD, TURN_RATE_SD = 0.03, 0.01
POSE_SD = 0.03
"""Standard deviations of the truth as the pipeline gets it: m/s, rad/s, and m and rad."""
REPLACED = {
    "nothing": "nothing",
    "clusters": "which clusters are one object",
    "poses": "how each object moved since it was first matched",
    "velocity": "the velocity of every visible track",
    "young": "the velocity of tracks visible for at most one second",
}
"""The parts that the truth replaces, and their names in the table."""
TRACKERS: dict[str, type[ModelFreeTracker]] = {"kalman": KalmanTracker, "factor-graph": FactorGraphTracker}


class TrueFrame(NamedTuple):
    """The bodies of a frame, the one before and the one after; `owner` (M, M): the body on each cell, -1: none."""

    owner: NDArray[np.int64]
    before: dict[int, SceneObject]
    now: dict[int, SceneObject]
    after: dict[int, SceneObject]
    elapsed_s: float
    world_T_grid: SE2

    def motion(self, body: int, at: Points) -> tuple[Points, float] | None:
        """Velocity (2,) of a body at a point (1, 2), grid frame, and its turn rate; None in a first or last frame."""
        if body not in self.before or body not in self.after:
            return None
        poses = self.before[body].world_T_object, self.after[body].world_T_object
        turned = wrap_angle(poses[1].theta - poses[0].theta)
        return rigid_velocity(*poses, self.elapsed_s, self.world_T_grid, at).mean(axis=1), turned / self.elapsed_s


def true_frames(observations: Sequence[Observation], grid: GridSpec) -> dict[int, TrueFrame]:
    """The true frames by stamp."""
    centres, found = grid.cell_centres(np.ones(grid.shape, bool)), {}
    for number, now in enumerate(observations):
        before, after = observations[max(number - 1, 0)], observations[min(number + 1, len(observations) - 1)]
        owner, occupied = np.full(grid.size**2, -1), now.frame.occupied.reshape(-1)
        for key, body in bodies(now.scene).items():
            owner[body_cells(body, now.frame.world_T_grid, centres, occupied, grid)] = key
        scenes = bodies(before.scene), bodies(now.scene), bodies(after.scene)
        elapsed_s = (after.frame.stamp_ns - before.frame.stamp_ns) * 1e-9
        found[now.frame.stamp_ns] = TrueFrame(owner.reshape(grid.shape), *scenes, elapsed_s, now.frame.world_T_grid)
    return found


def informed_pipeline(replaced: str, truth: Mapping[int, TrueFrame]) -> type[Pipeline]:
    """The pipeline, with clusters or poses from the truth if `replaced` says so."""

    class InformedPipeline(Pipeline):
        def __init__(self, *arguments: Any) -> None:
            super().__init__(*arguments)
            self._first: dict[int, tuple[int, SE2]] = {}

        def update(self, frame: GridFrame) -> None:
            self._now = truth[frame.stamp_ns]
            super().update(frame)

        def _segment(self, frame: GridFrame) -> list[Cluster]:
            clusters = super()._segment(frame)
            return one_per_body(clusters, self._now, self.grid) if replaced == "clusters" else clusters

        def _correct(self, shares: dict[int, Cluster], poses: dict[int, Match], visible: Mask) -> None:
            if replaced == "poses":
                poses = true_poses(self.tracks, shares, poses, self._first, self._now, self.grid)
            super()._correct(shares, poses, visible)

    return InformedPipeline


def informed_tracker(
    kind: type[ModelFreeTracker], replaced: str, truth: Mapping[int, TrueFrame]
) -> type[ModelFreeTracker]:
    """The tracker, with one of REPLACED from the truth."""

    class InformedTracker(kind):  # type: ignore[valid-type]
        pipeline = informed_pipeline(replaced, truth)

        def reset(self, seed: int) -> None:
            super().reset(seed)
            self._visible_for: dict[int, int] = {}

        def update(self, frame: GridFrame) -> None:
            self._now = truth[frame.stamp_ns]
            super().update(frame)
            for track in self.tracks:
                self._visible_for[track.identity] = self._visible_for.get(track.identity, 0) + (not track.unseen)

        def predict(self, steps: int) -> Forecast:
            tracks = self._tracks_to_correct()
            estimators = [one for track in tracks for one in track.estimator.estimators]
            kept = [(one, one.mean, one.covariance) for one in estimators]
            for track in tracks:
                set_true_velocity(track, self._now, self.stream.grid)
            forecast: Forecast = super().predict(steps)
            for one, mean, covariance in kept:
                one.mean, one.covariance = mean, covariance
            return forecast

        def _tracks_to_correct(self) -> list[Track]:
            visible = [track for track in self.tracks if not track.unseen]
            if replaced == "velocity":
                return visible
            if replaced == "young":
                return [t for t in visible if self._visible_for[t.identity] * self.stream.period_s <= YOUNG_S]
            return []

    return InformedTracker


def set_true_velocity(track: Track, truth: TrueFrame, grid: GridSpec) -> None:
    """Give the estimators of a track the velocity of the body that has most of its returns."""
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


def true_poses(
    tracks: Sequence[Track],
    shares: Mapping[int, Cluster],
    matches: Mapping[int, Match],
    first: dict[int, tuple[int, SE2]],
    truth: TrueFrame,
    grid: GridSpec,
) -> dict[int, Match]:
    """The matches by track number; after a track's first match on a body, its pose follows the body's true motion.

    `first` has by identity the body of a track's first match, and the track's pose in the frame of that body.
    """
    corrected = {}
    for number, match in matches.items():
        corrected[number] = match
        body, identity = owner_of(shares[number].points, truth, grid), tracks[number].identity
        if body is None:
            continue
        grid_T_body = truth.world_T_grid.inverse() @ truth.now[body].world_T_object
        if first.get(identity, (None, None))[0] != body:
            first[identity] = body, grid_T_body.inverse() @ SE2(*match.pose.tolist())
            continue
        true, covariance = grid_T_body @ first[identity][1], np.eye(3) * POSE_SD**2
        pose = np.array([true.x, true.y, true.theta])
        if match.covariance[2, 2] > math.pi**2:  # the match has no heading
            pose[2], covariance[2, 2] = match.pose[2], match.covariance[2, 2]
        corrected[number] = match._replace(pose=pose, covariance=covariance)
    return corrected


def one_per_body(clusters: Sequence[Cluster], truth: TrueFrame, grid: GridSpec) -> list[Cluster]:
    """The clusters; clusters that have most of their returns on the same body are joined."""
    of_body: dict[int, list[Cluster]] = {}
    for number, cluster in enumerate(clusters):
        body = owner_of(cluster.points, truth, grid)
        of_body.setdefault(-1 - number if body is None else body, []).append(cluster)
    return [joined(parts) for parts in of_body.values()]


def owner_of(points: Points, truth: TrueFrame, grid: GridSpec) -> int | None:
    """The body that has most of `points` (N, 2)."""
    cells, inside = grid.cells_of(points)
    body = most_frequent(truth.owner[tuple(cells[inside].T)])
    return None if body < 0 else body


def scores(kind: type[ModelFreeTracker], stream: GridStream) -> list[float]:
    """F1 of dynamic and of visible cells at HORIZONS."""
    tracker = with_shipped_weights(kind, registered_name(kind), stream)
    found = score_in_process(tracker, stream, STEPS, regions_of(stream, STRATA))
    return [float(found.f1[stratum][step]) for stratum in ("dynamic", "visible") for step in HORIZONS.values()]


def main(arguments: Sequence[str] | None = None) -> None:
    parser = study_parser(__doc__, "docs/results/trackers/model-free.json")
    parser.add_argument("tracker", nargs="?", choices=list(TRACKERS), default="kalman")
    parser.add_argument("--stretch", help="of the validation recording, such as 0s-20s; default: all of it")
    given = parser.parse_args(arguments)
    kind = TRACKERS[given.tracker]
    recording = JUNCTION / "validation.tracks"
    stream = open_stream(f"{recording}@{given.stretch}" if given.stretch else recording)
    truth = true_frames(list(stream.observations()), stream.grid)
    columns = [f"{stratum} {horizon}" for stratum in ("dynamic", "visible") for horizon in HORIZONS]
    rows: list[list[str]] = []
    gains: dict[str, str] = {}
    without: list[float] = []
    for replaced, name in REPLACED.items():
        values = scores(informed_tracker(kind, replaced, truth), stream)
        without = without or values
        rows.append([name, *(f"{value:.3f}" for value in values)])
        gains |= {f"gain, {name}: {c}": f"{v - w:.3f}" for c, v, w in zip(columns, values, without, strict=True)}
    table = measured_table([f"{registered_name(kind)}, with the truth of", *columns], rows)
    print(table.markdown())
    write_table(given.out, "stage costs", table, f"python -m studies.stage_costs {registered_name(kind)}", gains)


if __name__ == "__main__":
    main()
