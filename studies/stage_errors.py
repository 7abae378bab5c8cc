"""Error of each stage of the model-free pipeline at the junction, against the truth: which stage is the weakest?

`python -m studies.stage_errors [kalman|factor-graph]` (two minutes). Two stretches of the validation recording, by the
class of the true body, over bodies with at least two visible cells:

- segmentation: the share of bodies in one cluster, and of bodies with clusters of their own;
- association: how often per second the returns of a body change to another track;
- estimation: error of the velocity along and across the true one (median, root mean square), of moving bodies that have
  been in view for a second, and the median of the squared normalised error (1.4 if consistent);
- forecast: recall of the cells of bodies that have moved by 0.2 m, one frame, half a second and a second ahead, at the
  threshold that is best for dynamic cells at that horizon.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.grid import GridFrame, GridSpec
from gridtrack.evaluation.referee.strata import CELL_KINDS, cell_kinds_around
from gridtrack.recordings.observation import Observation
from gridtrack.recordings.stream import open_stream
from gridtrack.recordings.truth import static_cells
from gridtrack.trackers.model_free.factor_graph import FactorGraphTracker
from gridtrack.trackers.model_free.kalman import KalmanTracker
from gridtrack.trackers.model_free.pipeline import Pipeline
from gridtrack.trackers.model_free.segmentation import Cluster
from gridtrack.trackers.model_free.tracker import ModelFreeTracker
from gridtrack.trackers.model_free.tracks import Track
from gridtrack.trackers.registry import registered_name

from studies.support.results_file import measured_table, study_parser, write_table
from studies.support.shipped import JUNCTION, with_shipped_weights
from studies.support.true_bodies import MOVING_MPS, Points, bodies, body_cells, most_frequent, rigid_velocity

STRETCHES = ("0s-50s", "200s-250s")
WARM_UP, EVERY, SECOND = 20, 5, 8
PERIOD_S = 0.125
AHEAD = (1, 4, 8)
MOVED_M = 0.2
COLUMNS = ("whole", "alone", "switches/s", "along", "across", "normalised", "0.125 s", "0.5 s", "1 s")
NOTHING = np.empty((0, 2))

Found = dict[tuple[str, str], list[float]]
"""Values by class and measure."""
Forecasts = dict[int, list[tuple[NDArray[Any], ...]]]
"""By steps ahead: probability, truth and class of visible dynamic cells; class -1: nothing that has moved."""


class ClusterRecorder(Pipeline):
    """A pipeline that keeps the clusters of the newest frame."""

    clusters: Sequence[Cluster] = ()

    def _segment(self, frame: GridFrame) -> list[Cluster]:
        clusters = super()._segment(frame)
        self.clusters = tuple(clusters)
        return clusters


class RecordedKalman(KalmanTracker):
    """`kalman`, its clusters kept."""

    pipeline = ClusterRecorder


class RecordedFactorGraph(FactorGraphTracker):
    """`factor-graph`, its clusters kept."""

    pipeline = ClusterRecorder


TRACKERS: dict[str, type[ModelFreeTracker]] = {
    registered_name(kind): kind for kind in (RecordedKalman, RecordedFactorGraph)
}


def cell_owners(groups: Sequence[Points], grid: GridSpec) -> NDArray[np.int64]:
    """The index (M*M,) of the group of points (N, 2) with returns in each cell; -1: none."""
    owner = np.full(grid.size**2, -1)
    for number, points in enumerate(groups):
        cells, inside = grid.cells_of(points)
        owner[cells[inside, 0] * grid.size + cells[inside, 1]] = number
    return owner


def measure_stretch(
    tracker: ModelFreeTracker, observations: Sequence[Observation], found: Found, forecasts: Forecasts
) -> None:
    """Run the tracker over one stretch and add the errors of each stage for every visible body."""
    tracker.reset(0)
    grid, pipeline = tracker.stream.grid, tracker._pipeline
    assert isinstance(pipeline, ClusterRecorder)
    centres = grid.cell_centres(np.ones(grid.shape, bool))
    identities: dict[int, int] = {}
    seen_for: dict[int, int] = defaultdict(int)
    for number, now in enumerate(observations[: -max(AHEAD)]):
        tracker.update(now.frame)
        if number < WARM_UP:
            continue
        occupied = now.frame.occupied.reshape(-1)
        clusters = cell_owners([cluster.points for cluster in pipeline.clusters], grid)
        tracks = cell_owners([track.returns if not track.unseen else NOTHING for track in tracker.tracks], grid)
        seen = {
            key: body_cells(body, now.frame.world_T_grid, centres, occupied, grid)
            for key, body in bodies(now.scene).items()
        }
        for key, cells in seen.items():
            seen_for[key] = seen_for[key] + 1 if cells.size else 0
        add_segmentation(found, tracker, now, clusters, seen)
        for key, cells in seen.items():
            owner = most_frequent(tracks[cells])
            if cells.size < 2 or owner < 0:
                continue
            label, track = tracker.stream.classes[bodies(now.scene)[key].label], tracker.tracks[owner]
            if key in identities:
                found[label, "switches"].append(identities[key] != track.identity)
            identities[key] = track.identity
            if seen_for[key] >= SECOND:
                add_velocity(found, label, track, key, observations[number - 1 : number + 2], centres[cells])
        if number % EVERY == 0:
            add_forecast(forecasts, tracker, observations[number : number + max(AHEAD) + 1], centres)


def add_segmentation(
    found: Found,
    tracker: ModelFreeTracker,
    now: Observation,
    clusters: NDArray[np.int64],
    seen: dict[int, NDArray[np.int64]],
) -> None:
    of_cluster: dict[int, set[int]] = defaultdict(set)
    for key, cells in seen.items():
        for cluster in np.unique(clusters[cells]):
            of_cluster[int(cluster)].add(key)
    for key, cells in seen.items():
        own = clusters[cells][clusters[cells] >= 0]
        if own.size >= 2:
            label = tracker.stream.classes[bodies(now.scene)[key].label]
            found[label, "whole"].append(len(np.unique(own)) == 1)
            found[label, "alone"].append(all(of_cluster[int(cluster)] == {key} for cluster in own))


def add_velocity(
    found: Found, label: str, track: Track, key: int, around: Sequence[Observation], cells: Points
) -> None:
    """Add the error of a track against the true velocity of body `key` at its `cells` (N, 2), from three frames."""
    before, now, after = around
    scenes = bodies(before.scene), bodies(after.scene)
    if any(key not in scene for scene in scenes):
        return
    elapsed_s = (after.frame.stamp_ns - before.frame.stamp_ns) * 1e-9
    earlier, later = (scene[key].world_T_object for scene in scenes)
    true = rigid_velocity(earlier, later, elapsed_s, now.frame.world_T_grid, cells).mean(axis=1)
    speed = np.hypot(*true)
    if speed > MOVING_MPS:
        off, spread = track.estimator.mean[3:5] - true, track.estimator.covariance[3:5, 3:5]
        found[label, "along"].append(off @ true / speed)
        found[label, "across"].append((true[0] * off[1] - true[1] * off[0]) / speed)
        found[label, "normalised"].append(off @ np.linalg.solve(spread, off))


def add_forecast(
    forecasts: Forecasts, tracker: ModelFreeTracker, ahead: Sequence[Observation], centres: Points
) -> None:
    grid, occupancy = tracker.stream.grid, tracker.predict(max(AHEAD)).occupancy
    start, pose = bodies(ahead[0].scene), ahead[0].frame.world_T_grid
    assert ahead[0].scene is not None  # as `bodies` has checked
    dynamic = (cell_kinds_around(static_cells(ahead[0].scene, grid, pose)) == CELL_KINDS.index("dynamic")).reshape(-1)
    for steps in AHEAD:
        later = ahead[steps]
        occupied, kind = later.frame.occupied.reshape(-1), np.full(grid.size**2, -1)
        for key, body in bodies(later.scene).items():
            was, now = start.get(key), body.world_T_object
            if was is not None and np.hypot(was.world_T_object.x - now.x, was.world_T_object.y - now.y) >= MOVED_M:
                kind[body_cells(body, later.frame.world_T_grid, centres, occupied, grid)] = body.label
        counted = later.frame.visible.reshape(-1) & dynamic
        forecasts[steps].append((occupancy[steps].reshape(-1)[counted], occupied[counted], kind[counted]))


def best_threshold(p: NDArray[np.float32], occupied: NDArray[np.bool_]) -> float:
    """The threshold with the highest F1, of 49 that are denser near 0 and 1."""
    thresholds = np.sin(np.pi * np.arange(1, 50) / 100) ** 2
    scores = [2 * (occupied & (p >= t)).sum() / ((p >= t).sum() + occupied.sum()) for t in thresholds]
    return float(thresholds[int(np.argmax(scores))])


def main(arguments: Sequence[str] | None = None) -> None:
    parser = study_parser(__doc__, "docs/results/trackers/model-free.json")
    parser.add_argument("tracker", nargs="?", choices=list(TRACKERS), default="kalman")
    parser.add_argument("--stretches", nargs="+", default=STRETCHES, help="of the validation recording")
    given = parser.parse_args(arguments)
    found: Found = defaultdict(list)
    forecasts: Forecasts = defaultdict(list)
    for stretch in given.stretches:
        stream = open_stream(f"{JUNCTION / 'validation.tracks'}@{stretch}")
        kind = TRACKERS[given.tracker]
        tracker = with_shipped_weights(kind, given.tracker, stream)
        measure_stretch(tracker, list(stream.observations()), found, forecasts)
    parts = {steps: [np.concatenate(part) for part in zip(*forecasts[steps], strict=True)] for steps in AHEAD}
    classes = tracker.stream.classes
    rows = [class_row(name, label, found, parts) for label, name in enumerate(classes)]
    table = measured_table([registered_name(kind), *COLUMNS], [row for row in rows if row])
    print(table.markdown())
    write_table(given.out, "stages", table, f"python -m studies.stage_errors {given.tracker}")


def class_row(name: str, label: int, found: Found, parts: dict[int, list[NDArray[Any]]]) -> list[str]:
    """The errors of one class, a text for each of COLUMNS; empty if no body of the class moved."""
    if (name, "along") not in found:
        return []
    mean = {measure: np.mean(found[name, measure]) for measure in ("whole", "alone", "switches")}
    errors = [np.array(found[name, measure]) for measure in ("along", "across")]
    texts = [f"{100 * mean['whole']:.0f} %", f"{100 * mean['alone']:.0f} %", f"{mean['switches'] / PERIOD_S:.2f}"]
    texts += [f"{np.median(abs(e)):.2f}, {np.sqrt((e**2).mean()):.2f}" for e in errors]
    texts.append(f"{np.median(found[name, 'normalised']):.1f}")
    for p, occupied, kinds in parts.values():
        recall = (p >= best_threshold(p, occupied))[occupied & (kinds == label)]
        texts.append(f"{100 * recall.mean():.0f} %" if recall.size else "")
    return [name, *texts]


if __name__ == "__main__":
    main()
