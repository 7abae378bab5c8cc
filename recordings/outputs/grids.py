"""Grids that a stack publishes as forecasts: nav_msgs/OccupancyGrid, and layers of grid_map_msgs/GridMap.

Each topic, or layer, has the forecasts of one time ahead; grids with one stamp are one forecast.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.errors import ConfigurationError, RecordingError
from gridtrack.common.forecast_file import MAX_LEADS, MAX_SIDE, write_forecasts
from gridtrack.common.geometry import SE2
from gridtrack.common.options import seconds
from gridtrack.recordings.outputs.messages import Notes, OutputMessage, OutputTopics, available_ns, in_plane
from gridtrack.recordings.stream import GridStream

OCCUPANCY_GRID, GRID_MAP = "nav_msgs/msg/OccupancyGrid", "grid_map_msgs/msg/GridMap"
MAX_OUTPUT_BYTES = 1 << 33
"""Limit of the occupancy in a file: 8 GiB."""
CELL_DIGITS = 7
"""Decimals of a cell's side: nav_msgs has it as float32."""


class GridSource(NamedTuple):
    """A topic, or a layer on it, with forecasts `lead_s` ahead."""

    topic: str
    layer: str
    lead_s: float

    @property
    def name(self) -> str:
        """As the user wrote it."""
        return f"{self.topic}:{self.layer}" if self.layer else self.topic


class Size(NamedTuple):
    """Rows, columns, and the side of a cell in metres."""

    rows: int
    columns: int
    cell_m: float

    def __str__(self) -> str:
        return f"{self.rows} x {self.columns} cells of {self.cell_m:g} m"


class Plane(NamedTuple):
    """A grid of one message: `values` (H, W), P(occupied), NaN for no forecast; rows along y of `world_T_corner`."""

    world_T_corner: SE2
    cell_m: float
    values: NDArray[np.float32]

    @property
    def size(self) -> Size:
        """Its size."""
        rows, columns = self.values.shape
        return Size(rows, columns, self.cell_m)


def parse_grid_source(text: str) -> GridSource:
    """Read `/pred_05=0.5s` or `/map:layer=0.5s`. Raises ConfigurationError."""
    match = re.fullmatch(r"([^:=]+)(?::([^=]+))?=(.+)", text)
    if match is None:
        raise ConfigurationError(f"--grid {text}: expected TOPIC=SECONDS, as in /pred_05=0.5s, or TOPIC:LAYER=SECONDS")
    lead_s = seconds(match[3])
    if not 0.0 <= lead_s <= 60.0:
        raise ConfigurationError(f"--grid {text}: expected 0 to 60 seconds ahead")
    return GridSource(match[1], match[2] or "", lead_s)


def write_grids(stream: GridStream, sources: list[GridSource], out: Path, notes: Notes) -> None:
    """Write the forecasts of `sources` to the array file `out`. Raises RecordingError, ConfigurationError, OSError."""
    sources = sorted(sources, key=lambda source: source.lead_s)
    _check_sources(sources)
    kinds = {one.topic: (GRID_MAP if one.layer else OCCUPANCY_GRID,) for one in sources}
    topics = OutputTopics(stream, kinds)
    headers, size = _headers(topics, sources, notes)
    stamps = sorted({stamp_ns for stamp_ns, _ in headers})
    row_of = {stamp_ns: row for row, stamp_ns in enumerate(stamps)}
    shape = (len(stamps), len(sources), size.rows, size.columns)
    if np.prod(shape, dtype=object) * 2 > MAX_OUTPUT_BYTES:
        raise RecordingError(f"{out}: {shape} cells are more than 8 GiB: name a part, {stream.recording.path}@0s-60s")
    with TemporaryDirectory(prefix=f"{out.name}.", dir=out.parent) as folder:
        occupancy = np.lib.format.open_memmap(Path(folder) / "occupancy.npy", "w+", np.float16, shape)
        occupancy[:] = np.nan
        written = set()
        for message in topics.messages(Notes()):  # the first pass has noted everything
            for lead, plane in _planes(message, sources, Notes()):
                if (message.stamp_ns, lead) not in written:
                    written.add((message.stamp_ns, lead))
                    occupancy[row_of[message.stamp_ns], lead] = plane.values
        write_forecasts(
            out,
            {
                "occupancy": occupancy,
                "stamp_ns": np.array(stamps, np.int64),
                "available_ns": np.array(_available(headers, sources, notes), np.int64),
                "lead_s": np.array([source.lead_s for source in sources]),
                "cell_m": np.array(size.cell_m),
                "origin_xy": np.zeros(2),
                "frame": np.array("sensor"),
                "pose": _poses(headers, stamps, len(sources)),
                "note": np.array(f"grids of {', '.join(source.name for source in sources)}"[:200]),
            },
        )


Headers = dict[tuple[int, int], tuple[int, SE2]]
"""(stamp, lead) -> time of reception, world_T_corner."""


def _check_sources(sources: list[GridSource]) -> None:
    if len({source.lead_s for source in sources}) < len(sources):
        raise ConfigurationError("--grid: two topics for one time ahead: give each time once")
    if len(sources) > MAX_LEADS:
        raise ConfigurationError(f"--grid: more than {MAX_LEADS} times ahead")
    for topic, group in groupby(sorted(sources), key=lambda source: source.topic):
        layers = {source.layer for source in group}
        if "" in layers and len(layers) > 1:
            raise ConfigurationError(f"--grid {topic}: an occupancy grid has no layers, a grid map needs one")


def _headers(topics: OutputTopics, sources: list[GridSource], notes: Notes) -> tuple[Headers, Size]:
    """What the first pass finds: every grid without its cells, and the size that all of them have."""
    headers: Headers = {}
    first: tuple[str, Size] | None = None
    for message in topics.messages(notes):
        for lead, plane in _planes(message, sources, notes):
            name, size = sources[lead].name, plane.size
            first = first or (name, size)
            if size != first[1]:
                raise RecordingError(f"{name} has {size}, and {first[0]} {first[1]}: forecasts need one size")
            if (message.stamp_ns, lead) in headers:
                notes.left_out[f"grids of {name} with a stamp that it had before"] += 1
            else:
                headers[message.stamp_ns, lead] = message.received_ns, plane.world_T_corner
    if first is None:
        raise RecordingError("; ".join(["no grid that can be used", *notes.all_lines()]))
    counts = {source.name: sum(lead == k for _, lead in headers) for k, source in enumerate(sources)}
    stamps = len({stamp_ns for stamp_ns, _ in headers})
    if min(counts.values()) < stamps:
        each = ", ".join(f"{name} {count}" for name, count in counts.items())
        notes.note(f"of {stamps} stamps these have a grid: {each}; a forecast has no prediction where one is missing")
    return headers, first[1]


def _available(headers: Headers, sources: list[GridSource], notes: Notes) -> list[int]:
    """When each forecast was complete, in the order of the stamps: the latest of its grids."""
    latest: dict[int, int] = {}
    for lead, source in enumerate(sources):
        own = {stamp_ns: received_ns for (stamp_ns, one), (received_ns, _) in headers.items() if one == lead}
        if own:
            known_ns = available_ns(source.name, list(own), list(own.values()), notes)
            for stamp_ns, at_ns in zip(own, known_ns, strict=True):
                latest[stamp_ns] = max(latest.get(stamp_ns, stamp_ns), at_ns)
    return [latest[stamp_ns] for stamp_ns in sorted(latest)]


def _poses(headers: Headers, stamps: list[int], leads: int) -> NDArray[np.float64]:
    """world_T_corner (N, T, 3); a grid that is missing gets the pose of another one of its forecast."""
    poses = np.empty((len(stamps), leads, 3))
    for row, stamp_ns in enumerate(stamps):
        own = {lead: headers[stamp_ns, lead][1] for lead in range(leads) if (stamp_ns, lead) in headers}
        for lead in range(leads):
            pose = own.get(lead, next(iter(own.values())))
            poses[row, lead] = pose.x, pose.y, pose.theta
    return poses


def _planes(message: OutputMessage, sources: list[GridSource], notes: Notes) -> Iterator[tuple[int, Plane]]:
    """The grids in a message, with the index of their time ahead."""
    for lead, source in enumerate(sources):
        if source.topic == message.topic:
            plane = _of_layer(message, source) if source.layer else _of_occupancy_grid(message)
            if isinstance(plane, Plane):
                yield lead, plane
            else:
                notes.left_out[f"grids of {source.name} with {plane}"] += 1


def _of_occupancy_grid(message: OutputMessage) -> Plane | str:
    """The plane, or why it cannot be used. Raises RecordingError for values that are no percentages."""
    grid, info = message.content, message.content.info
    corner = in_plane(message.world_T_frame, info.origin)
    if problem := _problem(corner, info.height, info.width, info.resolution, grid.data.size):
        return problem
    assert corner is not None
    values = np.asarray(grid.data, np.float32).reshape(info.height, info.width)
    if values.min() < -1 or values.max() > 100:
        found = values.min() if values.min() < -1 else values.max()
        raise RecordingError(f"{message.topic} has the value {found:g}: expected percentages, or -1 for unknown")
    return Plane(corner, round(float(info.resolution), CELL_DIGITS), np.where(values < 0, np.nan, values / 100))


def _of_layer(message: OutputMessage, source: GridSource) -> Plane | str:
    """The layer of a grid map. Raises RecordingError for a layer that is missing, or values that are not probabilities.

    Row i of the map is along -x and column j along -y from the corner of greatest x and y; both indices are circular,
    and begin at the start indices of the message.
    """
    grid, info = message.content, message.content.info
    if source.layer not in grid.layers[: len(grid.data)]:
        raise RecordingError(f"{message.topic} has no layer '{source.layer}'; its layers: {', '.join(grid.layers)}")
    array = grid.data[grid.layers.index(source.layer)]
    centre = in_plane(message.world_T_frame, info.pose)
    lengths = np.array([info.length_x, info.length_y]) / (info.resolution or np.nan)
    rows, columns = (round(length) if np.isfinite(length) else 0 for length in lengths.tolist())
    if problem := _problem(centre, rows, columns, info.resolution, array.data.size):
        return problem
    assert centre is not None
    by_row = bool(array.layout.dim) and array.layout.dim[0].label == "row_index"
    cells = np.asarray(array.data, np.float32).reshape((rows, columns) if by_row else (columns, rows))
    cells = np.roll(cells if by_row else cells.T, (-grid.outer_start_index, -grid.inner_start_index), axis=(0, 1))
    known = cells[~np.isnan(cells)]
    if known.size and not (known.min() >= 0.0 and known.max() <= 1.0):
        raise RecordingError(f"{source.name} has values from {known.min():g} to {known.max():g}: expected 0 to 1")
    corner = centre @ SE2(-info.length_x / 2, -info.length_y / 2)
    return Plane(corner, round(float(info.resolution), CELL_DIGITS), cells[::-1, ::-1].T)


def _problem(pose: SE2 | None, rows: int, columns: int, cell_m: Any, numbers: int) -> str:
    """Why a grid cannot be used; empty if it can."""
    if pose is None:
        return "a pose that is not finite, tilted or upside down"
    if not 0.001 <= cell_m <= 100.0:
        return f"a cell of {cell_m:g} m"
    if not (0 < rows <= MAX_SIDE and 0 < columns <= MAX_SIDE and rows * columns == numbers):
        return f"{rows} x {columns} cells and {numbers} values (at most {MAX_SIDE} cells a side)"
    return ""
