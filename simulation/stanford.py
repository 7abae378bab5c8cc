"""Annotations in the format of the Stanford Drone Dataset as tracks: recorded paths for a simulated laser.

One line per road user and video frame, separated by spaces: `track xmin ymin xmax ymax frame lost occluded generated
"Label"`, boxes in pixels, y downwards, 30 frames a second (Robicquet et al., "Learning social etiquette", ECCV 2016).
Boxes are parallel to the image axes: headings come from the smoothed motion, and sizes from the class.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from gridtrack.common.config import Settings
from gridtrack.common.errors import RecordingError
from gridtrack.common.options import Option, from_text
from gridtrack.recordings.recording_info import RecordingInfo
from gridtrack.simulation.laser import Laser
from gridtrack.simulation.motion import headings, smoothed, unbroken_tracks
from gridtrack.simulation.tracks import MAX_USERS_PER_FRAME, ONLY_LASER, Tracks, TracksInfo

VIDEO_HZ = 30.0
SMOOTHING_STEPS = 10.0
"""A third of a second: removes the jitter of hand-drawn boxes but not the motion."""
STANFORD_CLASSES = ("pedestrian", "cyclist", "car", "bus")
ROAD_USERS = {
    "Pedestrian": ("pedestrian", 0.3, 0.5),
    "Skater": ("pedestrian", 0.3, 0.5),
    "Biker": ("cyclist", 1.75, 0.6),
    "Cart": ("car", 2.4, 1.2),
    "Car": ("car", 4.5, 1.82),
    "Bus": ("bus", 11.5, 2.55),
}
"""Class, length and width in metres of each label of the annotations."""
ANNOTATION_COLUMNS = 10
CLEARANCE_M = 0.75
"""Distance between a chosen position of the laser and the centre of every road user."""
MAX_ANNOTATION_LINES, MAX_PIXELS, MAX_FRAME = 5_000_000, 1e6, 5_000_000


class Video(Settings):
    """Values that the annotations do not contain."""

    scale: Annotated[float, Option(metavar="METRES")] = Field(gt=0.0, le=10.0)
    """Metres per pixel"""
    site: str = Field(min_length=1)
    """Site of the recording"""
    rate_hz: float = Field(default=8.0, gt=0.0, le=VIDEO_HZ)
    """Scans per second"""
    grid: Annotated[str, Option(metavar="CELLSxMETRES[@X,Y]")] = "100x0.2"
    """Grid around the laser"""
    laser_at: Annotated[tuple[float, float] | None, Option(metavar="X,Y"), from_text(lambda text: text.split(","))] = (
        None
    )
    """Position of the laser, metres from the image's upper left corner, x right and y up; default: the position nearest
    to the median of all paths that is clear of every road user"""
    seed: int = Field(default=0, ge=0)
    """Seed of the range noise"""
    licence: Annotated[str, Option(metavar="TEXT")] = ""
    """Licence of the recording"""
    credit: Annotated[str, Option(metavar="TEXT")] = ""
    """Authors of the annotations"""


@dataclass(frozen=True)
class _Boxes:
    """Rows of the file: `track`, `frame` (N,) int64, `box` (N, 4) float64, pixels, `label` (N,) index of ROAD_USERS."""

    track: NDArray[np.int64]
    frame: NDArray[np.int64]
    box: NDArray[np.float64]
    label: NDArray[np.int64]


def read_stanford(path: Path, video: Video, command: str = "") -> Tracks:
    """The road users of an annotation file as tracks, at the video's rate. Raises RecordingError."""
    boxes = _read(path)
    middle = np.column_stack([boxes.box[:, [0, 2]].mean(axis=1), -boxes.box[:, [1, 3]].mean(axis=1)]) * video.scale
    first = boxes.frame.min()
    parts = unbroken_tracks(boxes.track, boxes.frame)
    columns = []
    for number, rows in enumerate(parts):
        time_s, resting = (boxes.frame[rows] - first) / VIDEO_HZ, _resting_heading(boxes, rows)
        columns.append(_resampled(number, time_s, middle[rows], resting, video.rate_hz))
    frame, track, pose = (np.concatenate(column) for column in zip(*columns, strict=True))
    kinds = [list(ROAD_USERS.values())[boxes.label[rows.start]] for rows in parts]
    order = np.lexsort((track, frame))
    frame, track, pose = frame[order], track[order], pose[order]
    if np.bincount(frame).max() > MAX_USERS_PER_FRAME:
        raise RecordingError(f"{path}: more than {MAX_USERS_PER_FRAME} road users in one frame")
    frames = int(frame.max()) + 1
    laser = _laser(video.laser_at or _clear_position(path, pose[:, :2]))
    tracks = Tracks(
        info=_info(video, laser, frames, command),
        frame=frame,
        track=track,
        label=np.array([STANFORD_CLASSES.index(name) for name, _, _ in kinds])[track],
        pose=pose,
        size=np.array([size for _, *size in kinds])[track],
    )
    return tracks.rounded()


def _info(video: Video, laser: Laser, frames: int, command: str) -> TracksInfo:
    recording = RecordingInfo(
        site=video.site,
        classes=STANFORD_CLASSES,
        grid=video.grid,
        rate_hz=video.rate_hz,
        licence=video.licence,
        credit=video.credit,
        command=command,
    )
    return TracksInfo(
        recording=recording,
        lasers={ONLY_LASER: laser},
        frames=frames,
        rate_hz=video.rate_hz,
        noise_seed=video.seed,
    )


def _read(path: Path) -> _Boxes:
    """The rows that are not marked as lost, sorted by track and frame."""
    rows = []
    try:
        with path.open(encoding="utf-8", newline="") as file:
            for number, row in _lines(path, file):
                values = _values(path, number, row)
                if not int(values[6]):
                    rows.append((*values[:6], list(ROAD_USERS).index(row[9])))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise RecordingError(f"{path}: cannot be read ({error})") from None
    if not rows:
        raise RecordingError(f"{path}: no road user is ever in view")
    table = np.array(rows)
    order = np.lexsort((table[:, 5], table[:, 0]))
    table = table[order]
    return _Boxes(
        track=table[:, 0].astype(np.int64),
        frame=table[:, 5].astype(np.int64),
        box=table[:, 1:5],
        label=table[:, 6].astype(np.int64),
    )


def _lines(path: Path, file: Iterator[str]) -> Iterator[tuple[int, list[str]]]:
    for number, row in enumerate(csv.reader(file, delimiter=" "), 1):
        if number > MAX_ANNOTATION_LINES:
            raise RecordingError(f"{path}: more than {MAX_ANNOTATION_LINES} lines")
        if row:
            yield number, row


def _values(path: Path, number: int, row: list[str]) -> list[float]:
    """The nine numbers of a line. Raises RecordingError."""
    if len(row) < ANNOTATION_COLUMNS or row[9] not in ROAD_USERS:
        raise RecordingError(
            f"{path}, line {number}: expected `track xmin ymin xmax ymax frame lost occluded generated"
            f' "Label"` with one of {", ".join(ROAD_USERS)}'
        )
    try:
        values = [float(text) for text in row[:9]]
    except ValueError:
        raise RecordingError(f"{path}, line {number}: a value is not a number") from None
    sizes = all(abs(value) <= MAX_PIXELS for value in values[:5])
    if not (sizes and values[0] >= 0 and 0 <= values[5] <= MAX_FRAME and values[6] in (0, 1)):
        raise RecordingError(f"{path}, line {number}: a track, box or frame outside the valid range")
    return values


def _resting_heading(boxes: _Boxes, rows: slice) -> float:
    """The heading of a road user without motion: along the longer side of its box."""
    left, top, right, bottom = boxes.box[rows.start]
    return math.pi / 2.0 if bottom - top > right - left else 0.0


def _resampled(
    number: int, time_s: NDArray[np.float64], position: NDArray[np.float64], resting: float, rate_hz: float
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Frames, track and poses (n, 3) of one unbroken track at the recording's ticks."""
    position = smoothed(position, SMOOTHING_STEPS)
    heading = headings(position, 1.0 / VIDEO_HZ, SMOOTHING_STEPS, resting)
    frame = np.arange(math.ceil(time_s[0] * rate_hz - 1e-9), math.floor(time_s[-1] * rate_hz + 1e-9) + 1)
    columns = [np.interp(frame / rate_hz, time_s, column) for column in (*position.T, heading)]
    return frame, np.full(len(frame), number), np.stack(columns, axis=1)


def _laser(at: tuple[float, float]) -> Laser:
    """A laser with a field of view of 360 degrees."""
    return Laser(x=at[0], y=at[1], angle_min=-math.pi, beams=1440)


def _clear_position(path: Path, positions: NDArray[np.float64]) -> tuple[float, float]:
    """The position on a raster nearest to the median of all paths with CLEARANCE_M to every road user's centre."""
    raster = CLEARANCE_M / 3.0
    low = positions.min(axis=0)
    cells = np.unique(np.floor((positions - low) / raster).astype(np.int64), axis=0)
    taken = np.zeros(tuple(cells.max(axis=0) + 1), np.bool_)
    taken[tuple(cells.T)] = True
    reach = math.ceil(CLEARANCE_M / raster) + 1
    padded = np.pad(taken, reach)
    near = np.zeros_like(taken)
    for i in range(2 * reach + 1):
        for j in range(2 * reach + 1):
            if math.hypot(i - reach, j - reach) <= reach:
                near |= padded[i : i + taken.shape[0], j : j + taken.shape[1]]
    free = low + (np.argwhere(~near) + 0.5) * raster
    if not len(free):
        raise RecordingError(f"{path}: no position is clear of road users; give one with --laser-at X,Y")
    best = free[np.argmin(np.linalg.norm(free - np.median(positions, axis=0), axis=1))]
    return round(float(best[0]), 2), round(float(best[1]), 2)
