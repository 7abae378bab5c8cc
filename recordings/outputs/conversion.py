"""The recorded outputs of a stack as an array file of forecasts (`common/forecast_file.py`)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from gridtrack.common.config import validated
from gridtrack.common.errors import ConfigurationError, RecordingError
from gridtrack.common.forecast_file import MAX_LEADS, ForecastFile, open_forecasts, write_forecasts
from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, nearest_step
from gridtrack.common.options import Option, Seconds, from_text
from gridtrack.recordings.outputs.grids import MAX_OUTPUT_BYTES, GridSource, parse_grid_source, write_grids
from gridtrack.recordings.outputs.messages import Notes, OutputTopics
from gridtrack.recordings.outputs.object_table import ObjectList, TwistFrame, completed, read_table
from gridtrack.recordings.outputs.objects import OBJECT_MESSAGES, read_objects
from gridtrack.recordings.outputs.rasterise import StaticMap
from gridtrack.recordings.outputs.width import DEFAULT_WIDTH_M, Placed, WidthFit, drawn
from gridtrack.recordings.read_options import ReadOptions, reading_options
from gridtrack.recordings.stream import GridStream, open_stream
from gridtrack.recordings.stretches import parse_stretch

TABLES = (".csv", ".parquet")


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
            occupancy[n] = np.rint(255.0 * drawn(placed, twist_frame, lead_s, grid, width_m))
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
    fit = WidthFit(placed, twist_frame, stream.grid, settings.horizon_s)
    for frame in of_fit:
        fit.add(frame, of_fit.period_s)
    if not fit.forecasts:
        notes.note(f"--width is {DEFAULT_WIDTH_M} m, the default: no forecast and later frame lie in {of_fit.name}")
        return DEFAULT_WIDTH_M
    notes.note(f"--width is {fit.best_m:g} m: the least log loss of {fit.forecasts} predicted frames of {of_fit.name}")
    return fit.best_m
