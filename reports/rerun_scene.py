"""A Rerun recording (.rrd): grids, outlines, boxes and poses, in world metres, on the timeline of stamps.

It is written to a file only: no viewer is started, and no connection is opened. https://rerun.io
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.errors import ConfigurationError, printable
from gridtrack.common.files import replacing
from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridSpec, Mask
from gridtrack.common.scene import UNLABELLED
from gridtrack.evaluation.referee.samples import HEIGHT_M, KeptObject
from gridtrack.recordings.native_messages import CLASS_COLOURS

if TYPE_CHECKING:
    import rerun as rr

FREE_CELL, OCCUPIED_CELL, UNKNOWN_CELL = 0, 100, 255
"""Values of cells as in nav_msgs/OccupancyGrid, where unknown is -1: probabilities are per cent."""
STAMPS, SINCE_START = "stamp", "time"
"""Timelines: the stamps, and the time since the first scan of the recording or the first sample of a run."""
OUTLINE_Z_M = 0.03
"""Outlines and poses lie a little above the grid, which would hide them."""
SENSOR_ARROW_M = 0.6

VIEW_COLOUR = (225, 225, 225)
"""The background of a view; the grid is white where the probability is 0."""

Rgb = tuple[float, float, float]


@contextmanager
def rerun_scene(path: Path, name: str, identity: str) -> Iterator[RerunScene]:
    """A scene that becomes the file `path` when the block ends; if the block raises, there is no file.

    The viewer shows `name`, and joins files of one `identity` to one recording. Raises ConfigurationError if rerun-sdk
    is not installed, OSError if the file cannot be written.
    """
    rerun = _library()
    stream = rerun.RecordingStream("gridtrack", recording_id=identity)
    if not rerun.is_enabled(recording=stream):
        raise ConfigurationError("the environment variable RERUN switches Rerun off: unset it")
    strict = rerun.strict_mode()
    with replacing(path) as partial:
        partial.touch(exist_ok=False)  # raises OSError where no file can be written
        try:
            rerun.set_strict_mode(True)  # an error is raised, not printed
            stream.save(partial)
            stream.set_log_time_enabled(False)
            stream.set_log_tick_enabled(False)
            stream.send_recording_name(printable(name))
            yield RerunScene(stream, rerun)
            stream.flush()
        finally:
            rerun.set_strict_mode(strict)
            stream.disconnect()


def _library() -> Any:
    try:
        import rerun
    except ImportError:
        raise ConfigurationError("Rerun recordings need rerun-sdk: pip install 'gridtrack[view]'") from None
    return rerun


class RerunScene:
    """The drawing, entity by entity. A name from the user is one escaped part of an entity's path."""

    def __init__(self, stream: rr.RecordingStream, library: Any) -> None:
        self._stream, self._rr = stream, library
        self.log(("world",), library.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)

    def path(self, *parts: str) -> str:
        """The path of an entity, as a blueprint names it."""
        return str(self._rr.new_entity_path(list(parts)))

    def log(self, entity: Sequence[str], *content: Any, static: bool = False) -> None:
        """Log archetypes of Rerun at the current time."""
        self._stream.log(self.path(*entity), *content, static=static)

    def at(self, stamp_ns: int, start_ns: int) -> None:
        """Set the time of all following calls; SINCE_START counts from the stamp `start_ns`."""
        self._stream.set_time(STAMPS, timestamp=np.datetime64(stamp_ns, "ns"))
        self._stream.set_time(SINCE_START, duration=np.timedelta64(stamp_ns - start_ns, "ns"))

    def show(self, shown: Any) -> None:
        """Show a view made by `view`, or a container of views."""
        from rerun import blueprint as rrb

        self._stream.send_blueprint(
            rrb.Blueprint(shown, rrb.TimePanel(timeline=STAMPS, state="collapsed"), rrb.SelectionPanel(state="hidden"))
        )

    def view(self, title: str, entities: Sequence[str], grid: GridSpec, world_T_grid: SE2) -> Any:
        """A view of `entities`, paths or their patterns, from above the window; x to the right and y up."""
        from rerun import blueprint as rrb

        side = grid.size * grid.cell_m
        (centre,) = world_T_grid.apply(np.array([grid.origin]) + side / 2)
        above, up = [*centre, 1.3 * side], [0.0, 1.0, 0.0]
        eye = rrb.EyeControls3D(position=above, look_target=[*centre, 0.0], eye_up=up, kind=rrb.Eye3DKind.Orbital)
        return rrb.Spatial3DView(
            contents=list(entities),
            name=printable(title),
            eye_controls=eye,
            line_grid=False,
            background=VIEW_COLOUR,
        )

    def occupancy(
        self, entity: Sequence[str], visible: Mask, occupied: Mask, grid: GridSpec, world_T_grid: SE2
    ) -> None:
        """A frame (M, M): free, occupied, and unknown where it is not visible."""
        values = np.where(occupied, OCCUPIED_CELL, np.where(visible, FREE_CELL, UNKNOWN_CELL))
        self.grid(entity, values, grid, world_T_grid)

    def grid(self, entity: Sequence[str], values: NDArray[Any], grid: GridSpec, world_T_grid: SE2) -> None:
        """Values (M, M) of cells, FREE_CELL to OCCUPIED_CELL or UNKNOWN_CELL; row 0 is the lowest."""
        rerun = self._rr
        (corner,) = world_T_grid.apply(np.array([grid.origin]))
        image = rerun.components.ImageFormat(width=grid.size, height=grid.size, color_model="L", channel_datatype="U8")
        self.log(
            entity,
            rerun.GridMap(
                data=values[::-1].astype(np.uint8).tobytes(),  # the rows of an image go down
                format=image,
                cell_size=grid.cell_m,
                translation=[*corner, 0.0],
                quaternion=self._turn(world_T_grid.theta),
                colormap=rerun.components.Colormap.RvizMap,
            ),
        )

    def outlines(
        self,
        entity: Sequence[str],
        outlines: Sequence[NDArray[Any]],
        colours: Sequence[Rgb],
        labels: Sequence[str] = (),
    ) -> None:
        """Closed outlines (N, 2), metres, world; they replace earlier ones."""
        strips = [np.column_stack([ring, np.full(len(ring), OUTLINE_Z_M)]) for ring in map(_closed, outlines)]
        lines = self._rr.LineStrips3D(strips, colors=_bytes(colours), labels=list(labels) or None, radii=0.03)
        self.log(entity, lines)

    def pose(self, entity: Sequence[str], world_T_sensor: SE2) -> None:
        """The pose of a sensor."""
        rotation = self._turn(world_T_sensor.theta)
        self.log(
            entity, self._rr.Transform3D(translation=[world_T_sensor.x, world_T_sensor.y, 0.0], quaternion=rotation)
        )

    def sensor(self, entity: Sequence[str]) -> None:
        """Draw an arrow along x of a sensor, at its pose at all times."""
        shape = {"vectors": [[SENSOR_ARROW_M, 0.0, 0.0]], "origins": [[0.0, 0.0, OUTLINE_Z_M]], "radii": 0.05}
        self.log(entity, self._rr.Arrows3D(colors=[[213, 94, 0]], **shape), static=True)

    def points(self, entity: Sequence[str], points: NDArray[Any]) -> None:
        """Points (N, 2), metres, world."""
        at = np.column_stack([points, np.full(len(points), OUTLINE_Z_M)])
        self.log(entity, self._rr.Points3D(at, radii=0.12, colors=[[213, 94, 0]]))

    def tracks(self, entity: Sequence[str], objects: Sequence[KeptObject], world_T_grid: SE2) -> None:
        """Boxes with the number of their track, and an arrow as long as each moves in one second."""
        rerun = self._rr
        box = np.array([one.box for one in objects], np.float64).reshape(-1, 5)
        velocity = np.array([one.velocity for one in objects], np.float64).reshape(-1, 2)
        centres = np.column_stack([world_T_grid.apply(box[:, :2]), np.full(len(box), HEIGHT_M / 2)])
        half_sizes = np.column_stack([box[:, 3:] / 2, np.full(len(box), HEIGHT_M / 2)])
        turned = SE2(theta=world_T_grid.theta).apply(velocity)
        self.log(
            entity,
            rerun.Boxes3D(
                centers=centres,
                half_sizes=half_sizes,
                quaternions=[self._turn(heading + world_T_grid.theta) for heading in box[:, 2]],
                labels=[str(one.track) for one in objects],
                colors=[[26, 115, 230]],
            ),
        )
        vectors = np.column_stack([turned, np.zeros(len(box))])
        self.log((*entity, "velocity"), rerun.Arrows3D(origins=centres, vectors=vectors, colors=[[26, 115, 230]]))

    def clear(self, entity: Sequence[str]) -> None:
        """Remove an entity and the entities below it from now on."""
        self.log(entity, self._rr.Clear(recursive=True))

    def _turn(self, theta: float) -> Any:
        return self._rr.Quaternion(xyzw=[0.0, 0.0, math.sin(theta / 2), math.cos(theta / 2)])


def colour_of_class(label: int) -> Rgb:
    """The colour of a class by its index; grey if it is not known."""
    return (0.5, 0.5, 0.5) if label == UNLABELLED else CLASS_COLOURS[label % len(CLASS_COLOURS)]


def _closed(outline: NDArray[Any]) -> NDArray[Any]:
    return np.concatenate([outline, outline[:1]])


def _bytes(colours: Sequence[Rgb]) -> list[list[int]]:
    return [[round(255 * value) for value in colour] for colour in colours]
