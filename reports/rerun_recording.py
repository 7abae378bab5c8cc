"""A recording as Rerun shows it: the frames that trackers get, the poses of the sensors, and the ground truth."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import chain
from pathlib import Path

from gridtrack.common.geometry import SE2
from gridtrack.common.scene import UNLABELLED, Outline, Scene
from gridtrack.recordings.observation import Observation
from gridtrack.recordings.stream import GridStream
from gridtrack.recordings.stretches import parse_stretch
from gridtrack.reports.rerun_scene import RerunScene, colour_of_class, rerun_scene

_INPUT, _SENSORS = ("world", "input"), ("world", "sensors")
_OUTLINES, _OBJECTS = ("world", "outlines"), ("world", "objects")
"""The static outlines, and those of the road users: the ground truth."""


def write_rerun_recording(stream: GridStream, path: Path, on_frame: Callable[[], None] = lambda: None) -> None:
    """Write the stretch of `stream` as a Rerun recording; `on_frame` is called after each frame.

    Everything is in the world of ground truth. Raises ConfigurationError where rerun-sdk is not installed,
    RecordingError and OSError.
    """
    with rerun_scene(path, stream.name, f"{stream.recording.sha256}@{stream.stretch_s}") as scene:
        observations = stream.observations()
        first = next(observations)
        window = stream.grid, first.reference_T_grid
        scene.show(scene.view(stream.name, ["/world/**"], *window))
        drawn = _Drawn(scene, stream)
        for seen in chain((first,), observations):
            drawn.add(seen)
            on_frame()


def default_name(text: str) -> str:
    """The name of the file of `RECORDING[@RANGE]`. Raises RecordingError."""
    path, _ = parse_stretch(text)
    return f"{path.stem}{text.removeprefix(str(path))}.rrd"


class _Drawn:
    def __init__(self, scene: RerunScene, stream: GridStream) -> None:
        self._scene, self._stream = scene, stream
        self._static: tuple[Outline, ...] | None = None
        self._sensors: set[str] = set()

    def add(self, seen: Observation) -> None:
        """Draw a frame."""
        scene, stream = self._scene, self._stream
        scene.at(seen.frame.stamp_ns, stream.recording.survey.first_ns)
        scene.occupancy(_INPUT, seen.frame.visible, seen.frame.occupied, stream.grid, seen.reference_T_grid)
        for scan, pose in zip(seen.scans, seen.grid_T_sensor, strict=True):
            self._add_sensor(scan.sensor, seen.reference_T_grid @ pose)
        if seen.scene is not None:
            self._add_truth(seen.scene)

    def _add_sensor(self, sensor: str, pose: SE2) -> None:
        entity = (*_SENSORS, sensor)
        if sensor not in self._sensors:
            self._sensors.add(sensor)
            self._scene.sensor(entity)
        self._scene.pose(entity, pose)

    def _add_truth(self, truth: Scene) -> None:
        if truth.static is not self._static:
            self._static = truth.static
            self._scene.outlines(_OUTLINES, truth.static, [(0.35, 0.35, 0.35)] * len(truth.static))
        objects = truth.objects
        outlines = [one.world_T_object.apply(one.outline) for one in objects]
        labels = [" ".join((*self._class_of(one.label), str(one.track))) for one in objects]
        self._scene.outlines(_OBJECTS, outlines, [colour_of_class(one.label) for one in objects], labels)

    def _class_of(self, label: int) -> Iterable[str]:
        return () if label == UNLABELLED else (self._stream.classes[label],)
