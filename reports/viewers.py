"""Files for viewers: a recording and the kept forecasts of a run as Rerun recordings, and the layout of Foxglove."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridSpec
from gridtrack.common.scene import UNLABELLED, Outline, Scene
from gridtrack.evaluation.referee.samples import SAMPLES, Sample, SamplesError, read_samples
from gridtrack.recordings.observation import Observation
from gridtrack.recordings.stream import GridStream
from gridtrack.recordings.stretches import parse_stretch
from gridtrack.reports.chosen_scores import exported_tables
from gridtrack.reports.rerun_scene import (
    FREE_CELL,
    OCCUPIED_CELL,
    UNKNOWN_CELL,
    RerunScene,
    colour_of_class,
    rerun_scene,
)
from gridtrack.reports.run import ReportedRun, ReportError, chosen_runs, read_runs

LAYOUT_FILE = Path(__file__).parent / "assets" / "foxglove_layout.json"
_INPUT, _SENSORS, _OBSERVED, _TRUTH = "input", "sensors", "observed", "truth"
_FORECAST, _TRACKS, _OUTLINES, _OBJECTS = "forecast", "tracks", "outlines", "objects"
"""Entities of `world`. Ground truth of a recording: static outlines, and the outlines of objects."""
_HIDDEN = (2, 3)
_CELL_OF_STATE = np.array([FREE_CELL, OCCUPIED_CELL, FREE_CELL, OCCUPIED_CELL, UNKNOWN_CELL], np.uint8)
"""Seen free, seen occupied, hidden and free, hidden and occupied, not scored: the states of a target."""


def foxglove_layout() -> str:
    """The layout for Foxglove, JSON."""
    return LAYOUT_FILE.read_text("utf-8")


def write_rerun_recording(stream: GridStream, path: Path, on_frame: Callable[[], None] = lambda: None) -> None:
    """Write the stretch of `stream` as a Rerun recording; `on_frame` is called after each frame.

    The frame is the world of ground truth. Raises ConfigurationError if rerun-sdk is not installed,
    RecordingError and OSError.
    """
    with rerun_scene(path, stream.name, f"{stream.recording.sha256}@{stream.stretch_s}") as scene:
        observations = stream.observations()
        first = next(observations)
        window = stream.grid, first.reference_T_grid
        scene.show(scene.view(stream.name, ["/world/**"], *window))
        drawn = _DrawnRecording(scene, stream)
        for seen in chain((first,), observations):
            drawn.add(seen)
            on_frame()


def default_name(text: str) -> str:
    """The name of the file of `RECORDING[@RANGE]`. Raises RecordingError."""
    path, _ = parse_stretch(text)
    return f"{path.stem}{text.removeprefix(str(path))}.rrd"


class _DrawnRecording:
    def __init__(self, scene: RerunScene, stream: GridStream) -> None:
        self._scene, self._stream = scene, stream
        self._static: tuple[Outline, ...] | None = None
        self._sensors: set[str] = set()

    def add(self, seen: Observation) -> None:
        """Draw a frame."""
        scene, stream = self._scene, self._stream
        scene.at(seen.frame.stamp_ns, stream.recording.survey.first_ns)
        scene.occupancy(("world", _INPUT), seen.frame.visible, seen.frame.occupied, stream.grid, seen.reference_T_grid)
        for scan, pose in zip(seen.scans, seen.grid_T_sensor, strict=True):
            self._add_sensor(scan.sensor, seen.reference_T_grid @ pose)
        if seen.scene is not None:
            self._add_truth(seen.scene)

    def _add_sensor(self, sensor: str, pose: SE2) -> None:
        entity = ("world", _SENSORS, sensor)
        if sensor not in self._sensors:
            self._sensors.add(sensor)
            self._scene.sensor(entity)
        self._scene.pose(entity, pose)

    def _add_truth(self, truth: Scene) -> None:
        if truth.static is not self._static:
            self._static = truth.static
            self._scene.outlines(("world", _OUTLINES), truth.static, [(0.35, 0.35, 0.35)] * len(truth.static))
        objects = truth.objects
        outlines = [one.world_T_object.apply(one.outline) for one in objects]
        labels = [" ".join((*self._class_of(one.label), str(one.track))) for one in objects]
        self._scene.outlines(("world", _OBJECTS), outlines, [colour_of_class(one.label) for one in objects], labels)

    def _class_of(self, label: int) -> Iterable[str]:
        return () if label == UNLABELLED else (self._stream.classes[label],)


def write_rerun_run(
    run: Path, out: Path | None = None, rows: str = "", recordings: str = ""
) -> tuple[list[Path], list[str]]:
    """Write RECORDING.rrd for each recording of a run with kept forecasts, in `out` or the folder of its report.

    `rows` and `recordings` are patterns, as in `exported_tables` and `chosen_runs`. Returns the files, and a notice for
    each damaged file of forecasts. Raises ConfigurationError, RunError, ReportError and OSError.
    """
    (reported,) = chosen_runs(read_runs([run]), recordings)
    folder = out or run / "report"
    folder.mkdir(parents=True, exist_ok=True)
    written: list[Path] = []
    notices: list[str] = []
    for table in (one.table for one in exported_tables([reported], rows) if not one.table.pooled):
        path = folder / f"{table.recording}.rrd"
        if path.parent != folder:
            raise ReportError(f"{run}: '{table.recording}' is not the name of a file")
        drawn = _RecordingOfRun(reported, table.recording, [row.label for row in table.rows])
        if drawn.window is not None:
            drawn.write(path)
            written.append(path)
        notices += drawn.notices
    if not written:
        raise ReportError(f"{run}: none of the trials has kept forecasts ({SAMPLES})")
    return written, notices


class _RecordingOfRun:
    """One recording. Each observed frame is drawn once, from the first tracker with its sample."""

    def __init__(self, run: ReportedRun, recording: str, labels: Sequence[str]) -> None:
        self._run, self._recording, self._labels = run, recording, labels
        self.notices: list[str] = []
        self._horizons: tuple[float, ...] = ()
        self._start_ns = 0
        self.window: tuple[GridSpec, SE2] | None = None
        self._has_truth = False
        self._stamps: dict[str, set[int]] = {}
        for label in labels:
            self._survey(label)
        self.notices = list(dict.fromkeys(self.notices))

    def _survey(self, label: str) -> None:
        for sample in self._samples(label):
            if self.window is None:
                self.window, self._start_ns = (sample.grid, sample.reference_T_grid), sample.stamp_ns
                self._horizons = sample.horizons_s
            self._stamps.setdefault(label, set()).add(sample.stamp_ns)
            self._has_truth |= bool(np.isin(sample.state, _HIDDEN).any())
            self._start_ns = min(self._start_ns, sample.stamp_ns)

    def write(self, path: Path) -> None:
        """Write the recording. Raises ConfigurationError and OSError."""
        name = f"{self._run.name}: {self._recording}"
        with rerun_scene(path, name, f"{self._run.path.resolve()}@{self._recording}") as scene:
            self._show(scene)
            done: set[int] = set()
            for label in self._stamps:
                for sample in self._samples(label):
                    scene.at(sample.stamp_ns, self._start_ns)
                    if sample.stamp_ns not in done:
                        done.add(sample.stamp_ns)
                        self._draw_observed(scene, sample)
                    _draw_forecast(scene, label, sample)
            self._clear_missing(scene, done)

    def _samples(self, label: str) -> Iterator[Sample]:
        """The samples of a trial one at a time; a damaged file has its samples before the damage, and a notice."""
        path = self._run.trial_folder(label, self._recording) / SAMPLES
        if not path.exists():
            return
        try:
            yield from read_samples(path)
        except SamplesError as error:
            self.notices.append(f"{error}: {label} has forecasts only of the frames before the damage")

    def _draw_observed(self, scene: RerunScene, sample: Sample) -> None:
        window = sample.grid, sample.reference_T_grid
        scene.occupancy(("world", _INPUT), sample.visible, sample.occupied, *window)
        scene.points(("world", _SENSORS), sample.reference_T_grid.apply(sample.origins))
        for i, horizon in enumerate(sample.horizons_s):
            seen = sample.observed_visible[i], sample.observed_occupied[i]
            scene.occupancy(("world", _OBSERVED, _seconds(horizon)), *seen, *window)
            if self._has_truth:
                scene.grid(("world", _TRUTH, _seconds(horizon)), _CELL_OF_STATE[sample.state[i]], *window)

    def _clear_missing(self, scene: RerunScene, stamps: set[int]) -> None:
        """Show nothing at the stamps without a sample of a tracker, instead of its last forecast."""
        for label, kept in self._stamps.items():
            for stamp_ns in sorted(stamps - kept):
                scene.at(stamp_ns, self._start_ns)
                scene.clear(("world", _FORECAST, label))
                scene.clear(("world", _TRACKS, label))

    def _show(self, scene: RerunScene) -> None:
        """A tab for each horizon: input, observed frame, truth, and a view of each tracker with its tracks."""
        from rerun import blueprint as rrb

        tabs = [rrb.Grid(*self._views(scene, horizon), name=horizon) for horizon in map(_seconds, self._horizons)]
        scene.show(rrb.Tabs(*tabs, active_tab=len(tabs) // 2) if tabs else self._input_view(scene))

    def _input_view(self, scene: RerunScene) -> Any:
        assert self.window is not None
        return scene.view(_INPUT, [scene.path("world", _INPUT), scene.path("world", _SENSORS)], *self.window)

    def _views(self, scene: RerunScene, horizon: str) -> list[Any]:
        assert self.window is not None
        views = [self._input_view(scene)]
        for kind in (_OBSERVED, _TRUTH) if self._has_truth else (_OBSERVED,):
            views.append(scene.view(f"{kind} {horizon} later", [scene.path("world", kind, horizon)], *self.window))
        for label in self._stamps:
            forecast, tracks = scene.path("world", _FORECAST, label, horizon), scene.path("world", _TRACKS, label)
            views.append(scene.view(label, [forecast, f"{tracks}/**"], *self.window))
        return views


def _draw_forecast(scene: RerunScene, label: str, sample: Sample) -> None:
    for horizon, forecast in zip(sample.horizons_s, sample.forecast, strict=True):
        percent = (forecast * OCCUPIED_CELL).round()
        scene.grid(("world", _FORECAST, label, _seconds(horizon)), percent, sample.grid, sample.reference_T_grid)
    scene.tracks(("world", _TRACKS, label), sample.objects, sample.reference_T_grid)


def _seconds(horizon: float) -> str:
    return f"{horizon:g} s"
