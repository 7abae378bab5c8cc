"""The file of simulated tracks, from which a recording is rendered."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from gridtrack.common.config import validated
from gridtrack.common.errors import RecordingError
from gridtrack.common.files import atomic_write
from gridtrack.common.untrusted import parse_json
from gridtrack.recordings.formats.native import write_native
from gridtrack.simulation.tracks import MAX_USERS_PER_FRAME, ONLY_LASER, Tracks, TracksInfo

STANDING_SCHEMA, TRACKS_SCHEMA, WORLD_SCHEMA = 1, 2, 3
"""Schema of a file with one standing laser, with several lasers or a carrier, and of a world with walkers, surfaces and
laser errors."""
METADATA_KEY = b"gridtrack.tracks"
SIMULATED_SUFFIXES = (".tracks", ".mcap")
TRACK_COLUMNS = {
    "frame": pa.int32(),
    "track": pa.int32(),
    "class": pa.uint8(),
    "x_cm": pa.int32(),
    "y_cm": pa.int32(),
    "heading_mrad": pa.int16(),
    "length_cm": pa.uint16(),
    "width_cm": pa.uint16(),
}
MAX_TRACK_ROWS = 5_000_000
MAX_RENDERED_BEAMS = 1_000_000_000
"""Limit of the beams of all frames: the rendering of a small file must not fill the disk."""
MAX_INTERSECTIONS = 1_000_000_000
"""Limit of the beams of a frame times the corners of the static outlines, so that a frame renders within seconds."""


def write_tracks(file: BinaryIO, tracks: Tracks) -> None:
    """Write `tracks` with positions in centimetres and headings in milliradians; same input, same bytes.

    Rows are sorted by track, so that successive numbers differ little and take a byte or two.
    """
    tracks = tracks.rounded()
    order = np.lexsort((tracks.frame, tracks.track))
    values = {
        "frame": tracks.frame,
        "track": tracks.track,
        "class": tracks.label,
        "x_cm": np.round(tracks.pose[:, 0] * 100.0),
        "y_cm": np.round(tracks.pose[:, 1] * 100.0),
        "heading_mrad": np.round(tracks.pose[:, 2] * 1000.0),
        "length_cm": np.round(tracks.size[:, 0] * 100.0),
        "width_cm": np.round(tracks.size[:, 1] * 100.0),
    }
    about = json.dumps(_metadata(tracks.info))
    schema = pa.schema(list(TRACK_COLUMNS.items()), metadata={METADATA_KEY: about})
    columns = [pa.array(values[name][order].astype(kind.to_pandas_dtype())) for name, kind in TRACK_COLUMNS.items()]
    delta_encoded = [name for name in TRACK_COLUMNS if name not in ("class", "length_cm", "width_cm")]
    pq.write_table(
        pa.Table.from_arrays(columns, schema=schema),
        file,
        compression="zstd",
        compression_level=19,
        use_dictionary=["class", "length_cm", "width_cm"],
        column_encoding=dict.fromkeys(delta_encoded, "DELTA_BINARY_PACKED"),
        write_statistics=False,
        row_group_size=MAX_TRACK_ROWS,
        data_page_size=1 << 20,
    )


def _metadata(info: TracksInfo) -> dict[str, Any]:
    values = info.model_dump(mode="json")
    if info.world is not None:
        return {"schema": WORLD_SCHEMA} | values
    del values["world"]
    for laser in values["lasers"].values():
        if laser.pop("errors") is not None:
            raise RecordingError("a laser with errors needs a world: its plane and walkers")
    if info.carrier is None and list(info.lasers) == [ONLY_LASER]:
        one = {"laser" if name == "lasers" else name: value for name, value in values.items() if name != "carrier"}
        return {"schema": STANDING_SCHEMA} | one | {"laser": values["lasers"][ONLY_LASER]}
    return {"schema": TRACKS_SCHEMA} | values


def read_tracks(path: Path) -> Tracks:
    """The tracks of an untrusted file. Raises RecordingError if it is damaged or exceeds a limit."""
    try:
        with pq.ParquetFile(path) as file:
            info = _read_info(path, file)
            table = file.read(columns=list(TRACK_COLUMNS))
    except (pa.ArrowException, OSError) as error:
        raise RecordingError(
            f"{path}: damaged ({str(error).splitlines()[0] if str(error) else 'unreadable'})"
        ) from None
    _raise_if(path, "a value is missing", any(table[name].null_count for name in TRACK_COLUMNS))
    columns = {name: table[name].to_numpy().astype(np.int64) for name in TRACK_COLUMNS}
    order = np.lexsort((columns["track"], columns["frame"]))
    columns = {name: column[order] for name, column in columns.items()}
    _check_rows(path, info, columns)
    return Tracks(
        info=info,
        frame=columns["frame"],
        track=columns["track"],
        label=columns["class"],
        pose=np.stack([columns["x_cm"] / 100.0, columns["y_cm"] / 100.0, columns["heading_mrad"] / 1000.0], axis=1),
        size=np.stack([columns["length_cm"] / 100.0, columns["width_cm"] / 100.0], axis=1),
    )


def _read_info(path: Path, file: pq.ParquetFile) -> TracksInfo:
    """The metadata of the file, read before any column is decompressed."""
    about = (file.schema_arrow.metadata or {}).get(METADATA_KEY)
    if about is None or file.metadata.num_rows > MAX_TRACK_ROWS:
        reason = "not a file of tracks" if about is None else f"more than {MAX_TRACK_ROWS} rows"
        raise RecordingError(f"{path}: {reason}; expected one that `gridtrack simulate` wrote")
    for name, kind in TRACK_COLUMNS.items():
        if name not in file.schema_arrow.names or file.schema_arrow.field(name).type != kind:
            raise RecordingError(f"{path}: damaged (no column {name} of {kind})")
    try:
        values = parse_json(about)
    except ValueError as error:
        raise RecordingError(f"{path}: its metadata are not valid JSON ({str(error)[:80]})") from None
    schema = values.pop("schema", None) if isinstance(values, dict) else None
    if schema not in (STANDING_SCHEMA, TRACKS_SCHEMA, WORLD_SCHEMA):
        readable = f"{STANDING_SCHEMA} to {WORLD_SCHEMA}"
        raise RecordingError(f"{path}: schema {schema!r:.20}; this gridtrack reads {readable}: simulate again")
    if schema == STANDING_SCHEMA:
        values["lasers"] = {ONLY_LASER: values.pop("laser", None)}
    return validated(TracksInfo, values, f"{path}: its metadata")


def _check_rows(path: Path, info: TracksInfo, columns: dict[str, NDArray[np.int64]]) -> None:
    """Raise RecordingError for rows that cannot be rendered."""
    frame, track = columns["frame"], columns["track"]
    classes = info.recording.classes
    if info.static_class is not None and info.static_class not in classes:
        raise RecordingError(f"{path}: its static class is not one of its classes")
    in_frame = sum(laser.beams for laser in info.lasers.values())
    beams = info.frames * in_frame
    if beams > MAX_RENDERED_BEAMS:
        raise RecordingError(
            f"{path}: {beams} beams to render; at most {MAX_RENDERED_BEAMS}: fewer frames, or a coarser laser"
        )
    intersections = in_frame * sum(map(len, info.static))
    if intersections > MAX_INTERSECTIONS:
        raise RecordingError(
            f"{path}: {intersections} pairs of a beam and a static corner; at most {MAX_INTERSECTIONS}: fewer corners,"
            " or a coarser laser"
        )
    if info.world is not None:
        numbers = info.world.glass | info.world.dark
        beyond = [number for number in numbers if not 0 <= number < len(info.static)]
        _raise_if(path, "a glass or dark surface without a static outline", bool(beyond))
    if info.carrier is not None and not np.array_equal(frame[track == info.carrier.track], np.arange(info.frames)):
        raise RecordingError(f"{path}: damaged (the carrier of the lasers is not in every frame)")
    if frame.size:
        _check_values(path, info, columns)


def _check_values(path: Path, info: TracksInfo, columns: dict[str, NDArray[np.int64]]) -> None:
    frame, track, classes = columns["frame"], columns["track"], info.recording.classes
    _raise_if(path, f"a frame outside 0 to {info.frames - 1}", frame.min() < 0 or frame.max() >= info.frames)
    _raise_if(path, "a track below 0", track.min() < 0)
    _raise_if(path, f"a class above {len(classes) - 1}", columns["class"].max() >= len(classes))
    _raise_if(path, "a body of size 0", min(columns["length_cm"].min(), columns["width_cm"].min()) < 1)
    _raise_if(path, "a track twice in one frame", ((np.diff(frame) == 0) & (np.diff(track) == 0)).any())
    _raise_if(
        path,
        f"more than {MAX_USERS_PER_FRAME} road users in one frame",
        np.bincount(frame).max() > MAX_USERS_PER_FRAME,
    )


def _raise_if(path: Path, fault: str, found: bool | np.bool_) -> None:
    if found:
        raise RecordingError(f"{path}: damaged ({fault})")


def check_suffix(out: Path) -> None:
    """Raise RecordingError if the suffix is neither .tracks nor .mcap; for use before a long simulation."""
    if out.suffix not in SIMULATED_SUFFIXES:
        raise RecordingError(f"{out}: a simulated recording is a .tracks or .mcap file")


def write_recording(out: Path, tracks: Tracks) -> None:
    """Write `tracks` as .tracks, or their scans as .mcap; both give the same scans.

    Same tracks, same bytes. Raises RecordingError; `out` is then unchanged.
    """
    check_suffix(out)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(out) as file:
            if out.suffix == ".tracks":
                write_tracks(file, tracks)
            else:
                write_native(file, tracks.info.recording, tracks.scans())
    except OSError as error:
        raise RecordingError(f"{out}: cannot be written ({error.strerror})") from None
