"""The recorded outputs of a stack as an array file of forecasts (`common/forecast_file.py`)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from gridtrack.common.config import validated
from gridtrack.common.errors import ConfigurationError, RecordingError
from gridtrack.common.forecast_file import MAX_LEADS, ForecastFile, open_forecasts, write_forecasts
from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec, nearest_step
from gridtrack.common.options import Option, Seconds, from_text
from gridtrack.recordings.observation import cells_in_window
from gridtrack.recordings.outputs.grids import MAX_OUTPUT_BYTES, GridSource, parse_grid_source, write_grids
from gridtrack.recordings.outputs.messages import Notes, OutputTopics
from gridtrack.recordings.outputs.object_table import Numbers, ObjectList, TwistFrame, completed, read_table
from gridtrack.recordings.outputs.objects import OBJECT_MESSAGES, read_objects
from gridtrack.recordings.outputs.rasterise import StaticMap, draw_object
from gridtrack.recordings.read_options import ReadOptions, reading_options
from gridtrack.recordings.stream import GridStream, open_stream
from gridtrack.recordings.stretches import parse_stretch

TABLES = (".csv", ".parquet")
DEFAULT_WIDTH_M = 0.2
"""The width without a validation stretch."""
TRIED_WIDTHS_M = (0.0, 0.1, 0.2, 0.3, 0.45, 0.7)
FITTED_LEADS_S = (0.5, 1.0, 2.0)
MAX_FITTED_LISTS = 60
"""Limit of the lists that the width is fitted on, evenly spaced."""
SUREST = 1e-3
"""P(occupied) counts as at least this far from 0 and 1: drawn objects are surer than they can know."""


def metres(text: str) -> float:
    """`0.2m` or `0.2` in metres. Raises ConfigurationError."""
    try:
        return float(text.removesuffix("m"))
    except ValueError:
        raise ConfigurationError(f"'{text}': expected metres, such as 0.2m") from None


class OutputSettings(ReadOptions):
    """Where the forecasts are, in grids or in objects, and how the recording is read."""

    grid: Annotated[
        tuple[Annotated[GridSource, from_text(parse_grid_source)], ...], Option(metavar="TOPIC[:LAYER]=SECONDS")
    ] = ()
    """Topic of occupancy grids, or layer of grid maps, with its time ahead: /pred_05=0.5s; repeat for several"""
    objects: Annotated[str | None, Option(metavar="TOPIC|FILE")] = None
    """Topic of tracked or predicted objects, or a table of objects (.csv, .parquet)"""
    horizon_s: Seconds = Field(2.5, gt=0.0, le=60.0)
    """Longest time ahead of objects"""
    width_m: Annotated[float | None, Option("width", "METRES"), from_text(metres)] = Field(None, ge=0.0, le=10.0)
    """Standard deviation of the position of an object without a covariance; default: fitted on --validation"""
    validation: Annotated[str, Option(metavar="STRETCH")] = "validation"
    """Stretch of the recording on which the width is fitted, a name or 0s-60s"""
    twist_frame: Annotated[TwistFrame | None, Option(metavar="object|world")] = None
    """Frame of the velocities of objects: their own, or that of the message; default: by the type of the message"""


def write_outputs(
    recording: str | Path, out: Path, *, overwrite: bool = False, **values: Any
) -> tuple[ForecastFile, list[str]]:
    """Write the outputs in `RECORDING` or `RECORDING@STRETCH` to the array file `out`; returns it and lines to show.

    `values` are the fields of OutputSettings. Raises RecordingError, PluginError, ConfigurationError and OSError.
    """
    settings = validated(OutputSettings, values, "outputs")
    if bool(settings.grid) == bool(settings.objects):
        raise ConfigurationError("name the outputs with --grid TOPIC=SECONDS, or with --objects TOPIC (one of both)")
    if out.suffix != ".npz":
        raise ConfigurationError(f"{out}: forecasts are written as .npz")
    if not out.parent.is_dir():
        raise ConfigurationError(f"{out}: the folder {out.parent} does not exist: make it")
    if out.exists() and not overwrite:
        raise ConfigurationError(f"{out}: exists already; name another file, or replace it with --overwrite")
    stream, notes = open_stream(recording, **reading_options(values)), Notes()
    if settings.grid:
        write_grids(stream, list(settings.grid), out, notes)
    else:
        write_objects(stream, settings, out, notes)
    return open_forecasts(out), [*notes.all_lines(), *stream.recording.warnings]


class Placed(NamedTuple):
    """Objects of one stamp, P(occupied) (M, M) of the static map then, and the window, `world_T_grid`."""

    objects: ObjectList
    static: NDArray[np.float32]
    window: SE2


def _drawn(
    placed: Placed, twist_frame: TwistFrame, lead_s: Numbers, grid: GridSpec, width_m: float
) -> NDArray[np.float32]:
    """P(occupied) (T, M, M) of the objects over the static map, at `lead_s` (T,)."""
    planes = np.repeat(placed.static[None], len(lead_s), axis=0)
    for one in placed.objects.objects:
        draw_object(planes, one, one.velocities[twist_frame], lead_s, grid, placed.window, width_m)
    return planes


def write_objects(stream: GridStream, settings: OutputSettings, out: Path, notes: Notes) -> None:
    """Write the forecasts of objects, drawn into the grid of the stream, to the array file `out`."""
    lists, twist_frame = _lists(stream, settings, notes)
    lists = completed(lists, str(settings.objects), twist_frame, notes)
    grid, steps = stream.grid, nearest_step(settings.horizon_s, stream.period_s)
    lead_s = np.arange(steps + 1, dtype=np.float64) * stream.period_s
    if len(lead_s) > MAX_LEADS:
        raise ConfigurationError(f"--horizon: {len(lead_s)} frames ahead; at most {MAX_LEADS}")
    if len(lists) * len(lead_s) * grid.size**2 > MAX_OUTPUT_BYTES:
        raise RecordingError(
            f"{out}: {len(lists)} forecasts of {len(lead_s)} x {grid.size} x {grid.size} cells are more than 8 GiB:"
            f" name a part, {stream.recording.path}@0s-60s, or a shorter --horizon"
        )
    predicted = any(one.paths for item in lists for one in item.objects)
    width_m = settings.width_m
    if width_m is None:
        width_m = _fitted_width(stream, settings, lists, twist_frame, notes)
    origins = np.empty((len(lists), 2))
    with TemporaryDirectory(prefix=f"{out.name}.", dir=out.parent) as folder:
        shape = (len(lists), len(lead_s), *grid.shape)
        occupancy = np.lib.format.open_memmap(Path(folder) / "occupancy.npy", "w+", np.uint8, shape)
        for n, placed in enumerate(_placed(stream, lists)):
            occupancy[n] = np.rint(255.0 * _drawn(placed, twist_frame, lead_s, grid, width_m))
            origins[n] = placed.window.x + grid.origin[0], placed.window.y + grid.origin[1]
        write_forecasts(
            out,
            {
                "occupancy": occupancy,
                "stamp_ns": np.array([item.stamp_ns for item in lists], np.int64),
                "available_ns": np.array([item.available_ns for item in lists], np.int64),
                "lead_s": lead_s,
                "cell_m": np.array(grid.cell_m),
                "origin_xy": origins,
                "note": np.array(f"objects + {'predicted paths' if predicted else 'constant velocity'}"),
            },
        )


def _lists(stream: GridStream, settings: OutputSettings, notes: Notes) -> tuple[Iterable[ObjectList], TwistFrame]:
    """The objects of a table or a topic, and the frame of their velocities."""
    source = settings.objects or ""
    if source.endswith(TABLES):
        time = stream.recorded
        return read_table(Path(source), time.start_ns, time.end_ns, notes), settings.twist_frame or "world"
    topics = OutputTopics(stream, {source: tuple(OBJECT_MESSAGES)})
    message_type = OBJECT_MESSAGES[stream.recording.survey.topics[source][0]]
    return read_objects(topics, message_type, notes), settings.twist_frame or message_type.twist_frame


def _placed(stream: GridStream, lists: Iterable[ObjectList]) -> Iterator[Placed]:
    """Each list with the static map of the frames up to its stamp, at least one, and the window of the last of them."""
    static, ahead = StaticMap(stream.grid), iter(stream)
    frame: GridFrame | None = next(ahead)
    window = SE2()
    for item in lists:
        while frame is not None and frame.stamp_ns <= item.stamp_ns:
            static.add(frame)
            window, frame = frame.world_T_grid, next(ahead, None)
        yield Placed(item, static.probability, window)


def _fitted_width(
    stream: GridStream, settings: OutputSettings, lists: list[ObjectList], twist_frame: TwistFrame, notes: Notes
) -> float:
    """The width, metres, with the least log loss on the validation stretch; the default without one, noted."""
    if all(one.covariance is not None for item in lists for one in item.objects):
        return DEFAULT_WIDTH_M
    stretch = parse_stretch(f"{stream.recording.path}@{settings.validation}")[1]
    if isinstance(stretch, str) and stretch not in stream.recording.info.stretches:
        notes.note(
            f"--width is {DEFAULT_WIDTH_M} m, the default: with --validation 0s-60s it is fitted on a part of the"
            " recording that is not scored"
        )
        return DEFAULT_WIDTH_M
    of_fit = GridStream(stream.recording, stretch, grid=stream.grid)
    within = of_fit.recorded
    placed = [one for one in _placed(stream, lists) if within.start_ns <= one.objects.stamp_ns < within.end_ns]
    losses, forecasts = _losses(placed, of_fit, twist_frame, settings.horizon_s)
    if not forecasts:
        notes.note(f"--width is {DEFAULT_WIDTH_M} m, the default: no forecast and later frame lie in {of_fit.name}")
        return DEFAULT_WIDTH_M
    best_m = TRIED_WIDTHS_M[int(losses.argmin())]
    notes.note(f"--width is {best_m:g} m: the least log loss of {forecasts} predicted frames of {of_fit.name}")
    return best_m


def _losses(
    placed: Sequence[Placed], stream: GridStream, twist_frame: TwistFrame, horizon_s: float
) -> tuple[Numbers, int]:
    """The log loss of each of TRIED_WIDTHS_M on the visible cells of later frames, nats, and the number of forecasts.

    A forecast is of a frame that is FITTED_LEADS_S after its objects, to the nearest period.
    """
    leads_s = [lead for lead in FITTED_LEADS_S if lead <= horizon_s]
    losses, forecasts = np.zeros(len(TRIED_WIDTHS_M)), 0
    fitted = placed[:: max(1, -(-len(placed) // MAX_FITTED_LISTS))]
    for frame, one in ((frame, one) for frame in stream for one in fitted):
        ahead_s = (frame.stamp_ns - one.objects.stamp_ns) / 1e9
        if any(-0.5 * stream.period_s < ahead_s - lead <= 0.5 * stream.period_s for lead in leads_s):
            marks = np.stack([frame.visible, frame.occupied])
            visible, occupied = cells_in_window(marks, frame.world_T_grid, one.window, stream.grid)
            for number, width_m in enumerate(TRIED_WIDTHS_M):
                plane = _drawn(one, twist_frame, np.array([ahead_s]), stream.grid, width_m)[0]
                losses[number] += _log_loss(plane[visible], occupied[visible])
            forecasts += 1
    return losses, forecasts


def _log_loss(probabilities: NDArray[np.float32], occupied: NDArray[np.bool_]) -> float:
    """The sum of the log losses of cells (K,), nats."""
    of_outcome = np.where(occupied, probabilities, 1.0 - probabilities).astype(np.float64)
    return float(-np.log(of_outcome.clip(SUREST, 1.0 - SUREST)).sum())
