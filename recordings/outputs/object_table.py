"""One table for the objects of every source, in the world frame, and its file of CSV or Parquet."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.errors import RecordingError, one_line
from gridtrack.common.files import open_regular
from gridtrack.common.geometry import wrap_angle
from gridtrack.recordings.outputs.messages import Notes, available_ns

TwistFrame = Literal["object", "world"]
Numbers = NDArray[np.float64]
PERSON_WORDS = ("person", "pedestrian", "human", "people")
CLASS_EXTENTS = {
    "car": (4.5, 1.8),
    "vehicle": (4.5, 1.8),
    "truck": (8.0, 2.5),
    "bus": (11.0, 2.5),
    "trailer": (8.0, 2.5),
    "bicycle": (1.8, 0.6),
    "motorcycle": (2.0, 0.8),
}
"""Length and width in metres of a class, for objects without their own."""
UNKNOWN_EXTENT, CIRCLE_CORNERS = (0.5, 0.5), 16
"""Length and width of a person, and of an object without a known class."""
MAX_EXTENT_M, MAX_NUMBER, MAX_CORNERS, MAX_PATHS = 200.0, 1e9, 200, 100
"""Limits of an object: its size, any of its numbers, the corners of its outline, its predicted paths."""
MAX_RECORDED_OBJECTS, MAX_POSES = 500_000, 20_000_000
"""Limits of a file: its objects, and the poses of their predicted paths."""
VELOCITY_SPAN_NS = 500_000_000
"""An object without a velocity has the mean one of this time before its stamp."""
FAST_M_S, LEAST_ANGLES = 0.5, 10
"""The frame of velocities is checked on objects that are faster, if there are as many differences of positions."""
CLEAR_RAD = math.radians(20.0)
"""A frame of velocities fits clearly better if the median angle error is smaller by this."""
OBJECT_COLUMNS = (
    "stamp_ns", "track", "x", "y", "yaw", "vx", "vy", "length", "width", "existence", "label",
    "lead_s", "path", "probability",
)  # fmt: skip
NEEDED = ("stamp_ns", "x", "y")


@dataclass(frozen=True, slots=True)
class PredictedPath:
    """Poses (n, 3) of an object, x, y and heading in the world, at `lead_s` (n,), increasing from 0."""

    probability: float
    lead_s: Numbers
    poses: Numbers


@dataclass(frozen=True, slots=True)
class RecordedObject:
    """An object at one stamp, in the world frame.

    `pose` (3,): x, y, heading. `velocities` (2,) m/s by the frame that the source may have meant; empty: not known.
    `outline` (N, 2) in the frame of the object. `covariance` (2, 2) of the position in m2, or None.
    """

    track: str
    pose: Numbers
    velocities: dict[TwistFrame, Numbers]
    outline: Numbers
    existence: float = 1.0
    covariance: Numbers | None = None
    paths: tuple[PredictedPath, ...] = ()


@dataclass(frozen=True, slots=True)
class ObjectList:
    """The objects of one stamp. `available_ns`: when they were known, at first the time of their reception."""

    stamp_ns: int
    available_ns: int
    objects: tuple[RecordedObject, ...]


def outline_of(label: str, length: float, width: float, *, is_round: bool = False) -> Numbers:
    """Outline (N, 2) of a box about the object's origin, or of a circle for a person or `is_round`.

    A size that is not known (NaN, 0 or below) is the class's.
    """
    is_person = any(word in label.lower() for word in PERSON_WORDS)
    usual = next((size for word, size in CLASS_EXTENTS.items() if word in label.lower()), UNKNOWN_EXTENT)
    sizes = [own if own > 0.0 else of_class for own, of_class in zip((length, width), usual, strict=True)]
    half = np.array(sizes) / 2.0
    if is_round or is_person:
        angles = np.arange(CIRCLE_CORNERS) * (2.0 * math.pi / CIRCLE_CORNERS)
        return np.stack([np.cos(angles), np.sin(angles)], axis=1) * half
    return np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)]) * half


def is_usable(one: RecordedObject) -> bool:
    """Whether all numbers of an object are finite, and its size, existence and number of paths possible."""
    if len(one.outline) > MAX_CORNERS or len(one.paths) > MAX_PATHS or not 0.0 <= one.existence <= 1.0:
        return False
    numbers = [one.pose, *one.velocities.values(), one.outline.ravel()]
    numbers += [array.ravel() for path in one.paths for array in (path.lead_s, path.poses)]
    finite = all(np.isfinite(array).all() and np.abs(array).max(initial=0.0) < MAX_NUMBER for array in numbers)
    return finite and bool(np.abs(one.outline).max() <= MAX_EXTENT_M)


def completed(lists: Iterable[ObjectList], source: str, twist_frame: TwistFrame, notes: Notes) -> list[ObjectList]:
    """The lists in the order of their stamps: usable objects, each with one velocity, and when they were known.

    Raises RecordingError without any list, or for more than MAX_RECORDED_OBJECTS objects or MAX_POSES predicted poses.
    """
    ordered: list[ObjectList] = []
    count = poses = 0
    for one in lists:
        usable = tuple(filter(is_usable, one.objects))
        notes.left_out["objects with numbers that are not finite or impossible"] += len(one.objects) - len(usable)
        ordered.append(replace(one, objects=usable))
        count += len(usable)
        poses += sum(len(path.lead_s) for each in usable for path in each.paths)
        if count > MAX_RECORDED_OBJECTS or poses > MAX_POSES:
            raise RecordingError(
                f"{source}: more than {MAX_RECORDED_OBJECTS} objects or {MAX_POSES} predicted poses: name a part of the"
                " recording, RECORDING@0s-60s"
            )
    if not ordered:
        raise RecordingError("; ".join([f"{source}: no list of objects that can be used", *notes.all_lines()]))
    ordered.sort(key=lambda one: one.stamp_ns)
    single = [next(same) for _, same in groupby(ordered, key=lambda one: one.stamp_ns)]
    notes.left_out["lists of objects with a stamp that another one had before"] += len(ordered) - len(single)
    if count and not any(one.existence for item in single for one in item.objects):
        notes.note(f"{source}: existence is 0 for all objects: taken as not filled in, and as 1")
        single = [replace(item, objects=tuple(replace(o, existence=1.0) for o in item.objects)) for item in single]
    _check_twist_frame(single, twist_frame, notes)
    stamps = [item.stamp_ns for item in single]
    known_ns = available_ns(source, stamps, [item.available_ns for item in single], notes)
    moving = _with_velocities(single, twist_frame)
    return [replace(item, available_ns=at_ns) for item, at_ns in zip(moving, known_ns, strict=True)]


def _with_velocities(lists: Iterable[ObjectList], twist_frame: TwistFrame) -> Iterator[ObjectList]:
    """The lists with one velocity for each object: the given one, else from earlier positions of its track, else 0."""
    earlier: deque[tuple[int, dict[str, Numbers]]] = deque()
    for item in lists:
        while earlier and earlier[0][0] < item.stamp_ns - VELOCITY_SPAN_NS:
            earlier.popleft()
        objects = []
        for one in item.objects:
            velocity = one.velocities.get(twist_frame)
            if velocity is None:
                first = next(((at_ns, places[one.track]) for at_ns, places in earlier if one.track in places), None)
                velocity = np.zeros(2) if first is None else _velocity(*first, item.stamp_ns, one.pose)
            objects.append(replace(one, velocities={twist_frame: velocity}))
        earlier.append((item.stamp_ns, {one.track: one.pose for one in item.objects if one.track}))
        yield replace(item, objects=tuple(objects))


def _velocity(before_ns: int, before: Numbers, after_ns: int, after: Numbers) -> Numbers:
    found: Numbers = (after[:2] - before[:2]) / ((after_ns - before_ns) / 1e9)
    return found


def _check_twist_frame(lists: list[ObjectList], twist_frame: TwistFrame, notes: Notes) -> None:
    """Note if velocities fit the motion of their tracks clearly better in the other frame."""
    errors: dict[TwistFrame, list[float]] = {"object": [], "world": []}
    last: dict[str, tuple[int, RecordedObject]] = {}
    for item in lists:
        for one in item.objects:
            if not one.track or len(one.velocities) < 2:
                continue
            before_ns, before = last.setdefault(one.track, (item.stamp_ns, one))
            if item.stamp_ns - before_ns < VELOCITY_SPAN_NS // 2:
                continue
            last[one.track] = item.stamp_ns, one
            moved = _velocity(before_ns, before.pose, item.stamp_ns, one.pose)
            if math.hypot(*moved) >= FAST_M_S and math.hypot(*one.velocities[twist_frame]) >= FAST_M_S:
                for frame, found in errors.items():
                    mean = (before.velocities[frame] + one.velocities[frame]) / 2.0
                    found.append(abs(wrap_angle(math.atan2(mean[1], mean[0]) - math.atan2(moved[1], moved[0]))))
    other: TwistFrame = "world" if twist_frame == "object" else "object"
    if len(errors[other]) >= LEAST_ANGLES:
        own, better = float(np.median(errors[twist_frame])), float(np.median(errors[other]))
        if better + CLEAR_RAD < own:
            notes.note(
                f"velocities are {math.degrees(own):.0f} degrees off the motion of their tracks in the frame"
                f" '{twist_frame}', and {math.degrees(better):.0f} in '{other}': try --twist-frame {other}"
            )


def weighted(paths: list[PredictedPath]) -> tuple[PredictedPath, ...]:
    """The paths with probabilities that sum to 1, in their proportion; equal ones if they are all 0."""
    total = sum(max(path.probability, 0.0) for path in paths)
    if not math.isfinite(total):
        return ()
    shares = [max(path.probability, 0.0) / total if total > 0 else 1.0 / len(paths) for path in paths]
    return tuple(replace(path, probability=share) for path, share in zip(paths, shares, strict=True) if share > 0.0)


def read_table(path: Path, start_ns: int, end_ns: int, notes: Notes) -> Iterator[ObjectList]:
    """The objects of a CSV or Parquet file with OBJECT_COLUMNS, in the world frame, with stamps in [start_ns, end_ns).

    Rows with `lead_s` above 0 are predicted poses of the object in the row with the same stamp and track. Raises
    RecordingError for a file that cannot be read, and columns or values that are missing or wrong.
    """
    rows = sorted(_rows(path, start_ns, end_ns, notes), key=lambda row: row["stamp_ns"])
    for stamp_ns, group in groupby(rows, key=lambda row: row["stamp_ns"]):
        by_track: dict[Any, list[dict[str, Any]]] = {}
        for number, row in enumerate(group):
            by_track.setdefault(row["track"] if row["track"] is not None else number, []).append(row)
        yield ObjectList(stamp_ns, stamp_ns, tuple(_object_of(path, own) for own in by_track.values()))


def _rows(path: Path, start_ns: int, end_ns: int, notes: Notes) -> list[dict[str, Any]]:
    """The rows in the time of the scans; None for what a row or the file lacks."""
    import polars

    kinds: dict[str, Any] = dict.fromkeys(OBJECT_COLUMNS, polars.Float64)
    kinds |= {"stamp_ns": polars.Int64, "track": polars.String, "label": polars.String, "path": polars.String}
    try:
        with open_regular(path):
            is_parquet = path.suffix == ".parquet"
        frame = (
            polars.scan_parquet(path, glob=False)
            if is_parquet
            else polars.scan_csv(path, infer_schema=False, glob=False)
        )
        names = frame.collect_schema().names()
        unknown, missing = sorted(set(names) - set(OBJECT_COLUMNS)), [name for name in NEEDED if name not in names]
        if unknown or missing:
            found = one_line(f"no {', '.join(missing)}" if missing else f"unknown {', '.join(unknown)}", 80)
            raise RecordingError(f"{path}: {found}; the columns are {', '.join(OBJECT_COLUMNS)}")
        table = frame.select(polars.col(name).cast(kinds[name]) for name in names)
        count, without = (
            table.select(polars.len(), polars.any_horizontal(polars.col(NEEDED).is_null()).sum().alias("n"))
            .collect()
            .row(0)
        )
        if without:
            raise RecordingError(f"{path}: {without} rows without {', '.join(NEEDED)}")
        inside = table.filter(polars.col("stamp_ns").is_between(start_ns, end_ns, closed="left"))
        rows = inside.head(MAX_RECORDED_OBJECTS + 1).collect()
    except (OSError, polars.exceptions.PolarsError) as error:
        raise RecordingError(f"{path}: cannot be read as a table of objects: {one_line(str(error), 300)}") from None
    if len(rows) > MAX_RECORDED_OBJECTS:
        raise RecordingError(
            f"{path}: more than {MAX_RECORDED_OBJECTS} rows: name a part of the recording, RECORDING@0s-60s"
        )
    notes.left_out["rows with a stamp before or after the scans"] += count - len(rows)
    return [dict.fromkeys(OBJECT_COLUMNS) | row for row in rows.iter_rows(named=True)]


def _object_of(path: Path, rows: list[dict[str, Any]]) -> RecordedObject:
    """The object of the rows with one stamp and track. Raises RecordingError without a single row of its present."""
    present = [row for row in rows if not row["lead_s"]]
    if len(present) != 1:
        found = f"track {rows[0]['track']} at {rows[0]['stamp_ns']}"
        raise RecordingError(f"{path}: {found} has {len(present)} rows with lead_s 0 or none: expected one")
    (now,) = present
    velocity = np.array([_number(now, "vx"), _number(now, "vy")])
    moves = bool(np.isfinite(velocity).all())
    yaw = _number(now, "yaw", math.atan2(velocity[1], velocity[0]) if moves else 0.0)
    pose = np.array([now["x"], now["y"], yaw])
    label = now["label"] or ""
    outline = outline_of(label, _number(now, "length"), _number(now, "width"))
    velocities = in_both_frames(velocity, 0.0, yaw) if moves else {}
    ahead = sorted((row for row in rows if row["lead_s"]), key=lambda row: (row["path"] or "", row["lead_s"]))
    paths = []
    for _, group in groupby(ahead, key=lambda row: row["path"] or ""):
        own = list(group)
        poses = np.array([pose, *((row["x"], row["y"], _number(row, "yaw", yaw)) for row in own)])
        leads = np.array([0.0, *(row["lead_s"] for row in own)])
        if (np.diff(leads) <= 0).any():
            raise RecordingError(f"{path}: a path of track {now['track']} at {now['stamp_ns']} has a lead_s twice")
        paths.append(PredictedPath(_number(own[0], "probability", 1.0), leads, poses))
    track = "" if now["track"] is None else now["track"]
    return RecordedObject(track, pose, velocities, outline, _number(now, "existence", 1.0), paths=weighted(paths))


def _number(row: dict[str, Any], name: str, default: float = math.nan) -> float:
    return default if row[name] is None else float(row[name])


def in_both_frames(velocity: Numbers, frame_rad: float, object_rad: float) -> dict[TwistFrame, Numbers]:
    """A velocity (2,) in the world: given in a frame with heading `frame_rad` there, or in the object's own."""

    def turned(by: float) -> Numbers:
        c, s = math.cos(by), math.sin(by)
        return np.array([c * velocity[0] - s * velocity[1], s * velocity[0] + c * velocity[1]])

    return {"world": turned(frame_rad), "object": turned(object_rad)}
