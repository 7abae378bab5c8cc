"""Forecasts from the whole present: how far above persistence can a tracker come?

`python -m studies.known_present` scores three forecasters on the test worlds of data/worlds/test. `persistence` repeats
the state of each cell. The other two have knowledge that trackers lack: all true outlines, seen or not, the future
poses of the sensor, and the errors of its ranges. For one of them the scene stands still, for the other each body keeps
its true velocity. Neither knows who turns, starts, stops, swings a leg or walks in. Their thresholds are the best of
each world, chosen afterwards, so their scores are optimistic. Ten minutes on one idle core.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, nearest_step
from gridtrack.common.scene import Scene, SceneObject
from gridtrack.evaluation.referee.motion import FollowedBodies
from gridtrack.evaluation.referee.referee import Delivery, TrackerLike, scored_forecasts
from gridtrack.evaluation.referee.splits import EvaluationSplit, Sampling, plan_splits
from gridtrack.evaluation.runs.oracle import Oracle, expected_grid
from gridtrack.evaluation.scores.cells import Tally, count_cells
from gridtrack.evaluation.scores.f1 import f1_of
from gridtrack.evaluation.scores.thresholds import best_thresholds
from gridtrack.recordings.observation import Observation
from gridtrack.recordings.stream import GridStream
from gridtrack.trackers.baselines import PersistenceTracker
from gridtrack.trackers.contract import Forecast, stream_of

from studies.support.place_command import worlds_called
from studies.support.results_file import (
    ResultSection,
    ResultTable,
    measured_table,
    score_text,
    study_parser,
    write_section,
)
from studies.support.unseen_places import HORIZONS_S, REFERENCE, STRATA

RESULTS = Path("docs/results/worlds/known_present.json")
COMMAND = "python -m studies.known_present"
STANDS, MOVES_ON = "the scene stands", "bodies move on"

Forecaster = Callable[[GridStream, Sequence[int]], TrackerLike]
"""Makes a forecaster from a stream and the steps that are scored."""


class KnownScene(Oracle):
    """An oracle that knows the scene up to the newest frame; at steps that are not scored its forecast is 0."""

    moves_on = False

    def __init__(self, stream: GridStream, steps: Sequence[int]) -> None:
        super().__init__(stream)
        self._steps = steps

    def reset(self, seed: int) -> None:
        """Start before the first frame, without velocities."""
        super().reset(seed)
        self._followed, self._velocities = FollowedBodies(), np.zeros((0, 2))

    def update(self, frame: GridFrame) -> None:
        """Find the velocity of each body from the previous scene."""
        super().update(frame)
        scene = scene_of(self.ahead(0))
        motions = self._followed.motions(frame.stamp_ns, scene)
        centres = np.array([[body.world_T_object.x, body.world_T_object.y] for body in scene.objects]).reshape(-1, 2)
        velocities = motions.velocities(np.arange(len(centres)), centres, SE2())
        self._velocities = np.nan_to_num(velocities) if self.moves_on else np.zeros_like(velocities)

    def predict(self, steps: int) -> Forecast:
        """The expected scans at later frames, in the present scene with moved bodies."""
        now, grid = self.ahead(0), self.stream.grid
        forecast = np.zeros((steps + 1, *grid.shape), np.float32)
        for step in self._steps:
            later = self.ahead(step)
            seconds = (later.frame.stamp_ns - now.frame.stamp_ns) / 1e9
            expected = in_scene(moved_on(scene_of(now), self._velocities * seconds), later)
            forecast[step] = expected_grid(expected.seen_in(now.reference_T_grid, grid), grid, self.errors)
        return Forecast(forecast)


class MovedScene(KnownScene):
    """The same, with bodies that keep their velocities and do not turn."""

    moves_on = True


def scene_of(observation: Observation) -> Scene:
    """The true scene of an observation."""
    assert observation.scene is not None, "worlds have their truth"
    return observation.scene


def in_scene(scene: Scene, observation: Observation) -> Observation:
    """The observation with another scene."""
    return replace(observation, scans=tuple(replace(scan, scene=scene) for scan in observation.scans))


def moved_on(scene: Scene, moved: NDArray[np.float64]) -> Scene:
    """The scene with its N objects moved by `moved` (N, 2), metres, world frame."""

    def of(body: SceneObject, x: float, y: float) -> SceneObject:
        pose = body.world_T_object
        return replace(body, world_T_object=SE2(pose.x + x, pose.y + y, pose.theta))

    return replace(scene, objects=tuple(of(body, x, y) for body, (x, y) in zip(scene.objects, moved, strict=True)))


FORECASTERS: dict[str, Forecaster] = {
    REFERENCE: lambda stream, steps: PersistenceTracker(stream_of(stream), {}),
    STANDS: KnownScene,
    MOVES_ON: MovedScene,
}


def confusion_of(forecaster: Forecaster, split: EvaluationSplit) -> NDArray[np.int64]:
    """TP, FP, FN, TN (H, K, 4) in one world at HORIZONS_S in STRATA, each at its best threshold."""
    steps = [nearest_step(horizon_s, split.test.period_s) for horizon_s in HORIZONS_S]
    tally = Tally.empty(split.steps, split.strata)
    delivery = Delivery(split.test, lambda: None, split.regions().test)
    for scored in scored_forecasts(forecaster(split.test, steps), delivery, split.schedule, seed=0):
        tally.add(count_cells(scored.forecast.occupancy, scored.targets, scored.region_maps))
    ours = tally.of(tuple(STRATA)).at(steps)
    return ours.confusion(best_thresholds(tally, split.name).bins[steps][:, [split.strata.index(k) for k in STRATA]])


def f1_tables(splits: Iterable[EvaluationSplit]) -> dict[str, ResultTable]:
    """F1 of each forecaster by horizon, pooled over the worlds at equal times; a table for each stratum."""
    total = {name: np.zeros((len(HORIZONS_S), len(STRATA), 4), np.int64) for name in FORECASTERS}
    for split in splits:
        for name, forecaster in FORECASTERS.items():
            total[name] += confusion_of(forecaster, split)
        print(f"{split.name}: done", flush=True)
    f1 = {name: f1_of(counts) for name, counts in total.items()}
    return {
        stratum: measured_table(
            (f"F1, {stratum}", *(f"{horizon_s:g} s" for horizon_s in HORIZONS_S)),
            [[name, *(score_text(value) for value in values[:, k])] for name, values in f1.items()],
        )
        for k, stratum in enumerate(STRATA.values())
    }


def main(arguments: Sequence[str] | None = None) -> None:
    parser = study_parser(__doc__)
    parser.add_argument("--world", action="append", help="such as indoors-room-1008; default: all twenty")
    parser.add_argument("--results", type=Path, default=RESULTS, help="results file, default: %(default)s")
    given = parser.parse_args(arguments)
    sampling = Sampling(max(HORIZONS_S), every_s=1.0)
    tables = f1_tables(plan_splits(map(str, worlds_called(given.world)), None, sampling))
    section = ResultSection(command=COMMAND, tables=tables)
    write_section(given.results, "F1", section)
    print(section.text())


if __name__ == "__main__":
    main()
