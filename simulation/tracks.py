"""Tracks as a file: the pose of every road user in each frame, from which a recording is rendered.

A Parquet file with one row for each road user in each frame, integers in the unit of measurement in the column's name,
and the rest of the recording (TracksInfo) as JSON in its metadata. An hour of a busy junction takes about two
megabytes.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray
from pydantic import Field, field_validator

from gridtrack.common.config import Settings, validated
from gridtrack.common.errors import RecordingError
from gridtrack.common.geometry import SE2
from gridtrack.common.scan import MIN_RATE_HZ, Scan
from gridtrack.common.scene import UNLABELLED, Scene, SceneObject
from gridtrack.recordings.recording import RecordingInfo
from gridtrack.simulation.bodies import body_outline
from gridtrack.simulation.laser import MAX_SCENE_M, Laser

TRACKS_SCHEMA = 1
METADATA_KEY = b"gridtrack.tracks"
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
MAX_TRACK_ROWS, MAX_FRAMES, MAX_USERS_PER_FRAME = 5_000_000, 5_000_000, 1000
HALF_TURN_MRAD = 3141
MAX_RENDERED_BEAMS = 1_000_000_000
"""Limit of the beams in all frames together: the rendered recording of a small file must not fill the disk."""
MAX_OUTLINES, MAX_OUTLINE_CORNERS = 1000, 1000
MAX_INTERSECTIONS = 1_000_000_000
"""Limit of the beams of a frame times the corners of the static outlines: a frame is rendered within seconds."""

Corner = tuple[float, float]


class TracksInfo(Settings):
    """The input of a recording besides its tracks.

    `static` outlines are corners in metres, world frame, counter-clockwise; `noise_seed` seeds the laser's noise.
    """

    recording: RecordingInfo
    laser: Laser
    frames: int = Field(ge=1, le=MAX_FRAMES)
    rate_hz: float = Field(ge=MIN_RATE_HZ, le=1000.0)
    noise_seed: int = Field(default=0, ge=0, lt=1 << 63)
    static: tuple[tuple[Corner, ...], ...] = Field(default=(), max_length=MAX_OUTLINES)
    static_class: str | None = None
    made_with: dict[str, str] = Field(default_factory=dict)
    """Versions of the programs that made the tracks."""

    @field_validator("static")
    @classmethod
    def _check_corners(cls, static: tuple[tuple[Corner, ...], ...]) -> tuple[tuple[Corner, ...], ...]:
        if any(not 3 <= len(outline) <= MAX_OUTLINE_CORNERS for outline in static):
            raise ValueError(f"an outline has 3 to {MAX_OUTLINE_CORNERS} corners")
        if any(abs(value) > MAX_SCENE_M for outline in static for corner in outline for value in corner):
            raise ValueError(f"a corner is further than {MAX_SCENE_M:g} m from the origin")
        return static


@dataclass(frozen=True)
class Tracks:
    """Road users over time, row by row in the order of frame and track.

    `frame` and `track` (N,) int64; `label` (N,) int64 indexes `info.recording.classes`; `pose` (N, 3) float64 is x, y,
    heading of the body's centre, world frame; `size` (N, 2) float64 its length and width; metres and radians.
    """

    info: TracksInfo
    frame: NDArray[np.int64]
    track: NDArray[np.int64]
    label: NDArray[np.int64]
    pose: NDArray[np.float64]
    size: NDArray[np.float64]

    def scenes(self) -> Iterator[Scene]:
        """The true scene of each frame, in order."""
        classes = self.info.recording.classes
        static = tuple(np.array(outline, np.float32) for outline in self.info.static)
        static_label = classes.index(self.info.static_class) if self.info.static_class else UNLABELLED
        starts = np.searchsorted(self.frame, np.arange(self.info.frames + 1)).tolist()
        for rows in itertools.starmap(slice, itertools.pairwise(starts)):
            columns = (column[rows].tolist() for column in (self.track, self.label, self.pose, self.size))
            objects = tuple(
                SceneObject(track, label, SE2(*pose), body_outline(classes[label], *size))
                for track, label, pose, size in zip(*columns, strict=True)
            )
            yield Scene(static, static_label, objects)

    def scans(self) -> Iterator[Scan]:
        """The scan of each frame; its noise depends on the seed and the frame number only."""
        period_ns = round(1e9 / self.info.rate_hz)
        for frame, scene in enumerate(self.scenes()):
            random = np.random.default_rng([self.info.noise_seed, frame])
            yield self.info.laser.scan(scene, frame * period_ns, random)

    def where(self, kept: NDArray[np.bool_]) -> Tracks:
        """The rows (N,) that are kept."""
        return replace(
            self,
            frame=self.frame[kept],
            track=self.track[kept],
            label=self.label[kept],
            pose=self.pose[kept],
            size=self.size[kept],
        )

    def rounded(self) -> Tracks:
        """The tracks with the resolution of the file."""
        heading = np.arctan2(np.sin(self.pose[:, 2]), np.cos(self.pose[:, 2]))
        heading_mrad = np.clip(np.round(heading * 1000.0), -HALF_TURN_MRAD, HALF_TURN_MRAD)
        whole = np.column_stack([np.round(self.pose[:, :2] * 100.0), heading_mrad])
        rounded = whole / (100.0, 100.0, 1000.0)
        return replace(self, pose=rounded, size=np.round(self.size * 100.0) / 100.0)


def write_tracks(file: BinaryIO, tracks: Tracks) -> None:
    """Write `tracks`, positions to the centimetre and headings to the milliradian; same input, same bytes.

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
    about = json.dumps({"schema": TRACKS_SCHEMA} | tracks.info.model_dump(mode="json"))
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


def read_tracks(path: Path) -> Tracks:
    """The tracks of an untrusted file. Raises RecordingError for one that is damaged or exceeds a limit."""
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
    """The metadata of the file, read before any of its columns is decompressed."""
    about = (file.schema_arrow.metadata or {}).get(METADATA_KEY)
    if about is None or file.metadata.num_rows > MAX_TRACK_ROWS:
        reason = "not a file of tracks" if about is None else f"more than {MAX_TRACK_ROWS} rows"
        raise RecordingError(f"{path}: {reason}; expected one that `gridtrack simulate` wrote")
    for name, kind in TRACK_COLUMNS.items():
        if name not in file.schema_arrow.names or file.schema_arrow.field(name).type != kind:
            raise RecordingError(f"{path}: damaged (no column {name} of {kind})")
    try:
        values = json.loads(about)
    except (ValueError, RecursionError):
        raise RecordingError(f"{path}: its metadata are not JSON") from None
    schema = values.pop("schema", None) if isinstance(values, dict) else None
    if schema != TRACKS_SCHEMA:
        raise RecordingError(f"{path}: schema {schema!r:.20}; this gridtrack reads {TRACKS_SCHEMA}: simulate again")
    return validated(TracksInfo, values, f"{path}: its metadata")


def _check_rows(path: Path, info: TracksInfo, columns: dict[str, NDArray[np.int64]]) -> None:
    """Raise RecordingError for rows that are not a scene."""
    frame, track = columns["frame"], columns["track"]
    classes = info.recording.classes
    if info.static_class is not None and info.static_class not in classes:
        raise RecordingError(f"{path}: its static class is not one of its classes")
    beams = info.frames * info.laser.beams
    if beams > MAX_RENDERED_BEAMS:
        raise RecordingError(
            f"{path}: {beams} beams to render; at most {MAX_RENDERED_BEAMS}: fewer frames, or a coarser laser"
        )
    intersections = info.laser.beams * sum(map(len, info.static))
    if intersections > MAX_INTERSECTIONS:
        raise RecordingError(
            f"{path}: {intersections} pairs of a beam and a static corner; at most {MAX_INTERSECTIONS}: fewer corners,"
            " or a coarser laser"
        )
    if not frame.size:
        return
    _raise_if(path, f"a frame outside 0 to {info.frames - 1}", frame.min() < 0 or frame.max() >= info.frames)
    _raise_if(path, "a track below 0", track.min() < 0)
    _raise_if(path, f"a class beyond the {len(classes)} that it names", columns["class"].max() >= len(classes))
    _raise_if(path, "a body without extent", min(columns["length_cm"].min(), columns["width_cm"].min()) < 1)
    _raise_if(path, "a track twice in one frame", ((np.diff(frame) == 0) & (np.diff(track) == 0)).any())
    _raise_if(
        path,
        f"more than {MAX_USERS_PER_FRAME} road users in one frame",
        np.bincount(frame).max() > MAX_USERS_PER_FRAME,
    )


def _raise_if(path: Path, fault: str, found: bool | np.bool_) -> None:
    if found:
        raise RecordingError(f"{path}: damaged ({fault})")
