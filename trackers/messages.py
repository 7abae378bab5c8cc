"""Streams, frames and forecasts as the JSON fields and named arrays of messages, in both directions."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.files import LABEL_RULE, is_label
from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec
from gridtrack.trackers.contract import MAX_FUTURES, ComparedPart, Forecast, Role, StreamSpec, TrackedObject
from gridtrack.trackers.wire import Message, WireError

MAX_OBJECTS = 4096
MAX_CLASSES = 255
"""The most classes that a recording's labels can name; it bounds the size of an answer before memory is allocated."""
FORECAST_DTYPES = ("float32", "float16")
FUTURES_DTYPES = ("bool", "float16")

Arrays = dict[str, NDArray[Any]]


def stream_fields(stream: StreamSpec) -> dict[str, Any]:
    """`stream` as JSON, for `start`."""
    return {
        "size": stream.grid.size,
        "cell_m": stream.grid.cell_m,
        "origin_m": list(stream.grid.origin),
        "period_s": stream.period_s,
        "site": stream.site,
        "classes": list(stream.classes),
        "weights": None if stream.weights is None else str(stream.weights.absolute()),
        "weights_sha256": stream.weights_sha256 or None,
        "velocity_scored": stream.velocity_scored,
    }


def stream_from(message: Message) -> StreamSpec:
    """The stream in `start`. Raises WireError, ConfigurationError."""
    fields = message.value("stream", dict)
    stream = Message("stream", 0, fields)
    origin = stream.value("origin_m", list)
    if len(origin) != 2 or not all(isinstance(value, int | float) for value in origin):
        raise WireError(f"'stream': origin_m is {origin!r:.80}; expected x and y")
    x, y = origin
    weights = None if fields.get("weights") is None else Path(stream.value("weights", str))
    return StreamSpec(
        GridSpec(stream.value("size", int), stream.value("cell_m", float), (float(x), float(y))),
        stream.value("period_s", float),
        stream.value("site", str),
        tuple(stream.value("classes", list)),
        weights,
        str(fields.get("weights_sha256") or ""),
        fields.get("velocity_scored") is True,
    )


def role_from(message: Message) -> Role:
    """The role that `started` and `described` name; "tracker" by default. Raises WireError."""
    found: Any = message.fields.get("role", "tracker")
    if found not in get_args(Role):
        raise WireError(f"'{message.kind}': role is {found!r:.80}; expected one of {', '.join(get_args(Role))}")
    role: Role = found
    return role


def code_sha256_from(message: Message) -> str:
    """The hash of the tracker's code in `started`; "" if it gives none. Raises WireError."""
    found: Any = message.fields.get("code_sha256", "")
    if not isinstance(found, str) or len(found) not in (0, 64) or set(found) - set("0123456789abcdef"):
        raise WireError(f"'{message.kind}': code_sha256 is {found!r:.80}; expected 64 hexadecimal digits")
    return found


def device_from(message: Message) -> str:
    """The name of the tracker's device in `started`; "" if it gives none. Raises WireError."""
    found: Any = message.fields.get("device", "")
    if not isinstance(found, str) or (found and not is_label(found)):
        raise WireError(f"'{message.kind}': device is {found!r:.80}: {LABEL_RULE}")
    return found


def reference_for_from(message: Message) -> frozenset[ComparedPart]:
    """The comparisons that `started` and `described` list in `reference_for`; none by default. Raises WireError."""
    found: Any = message.fields.get("reference_for", [])
    if not isinstance(found, list) or not all(name in get_args(ComparedPart) for name in found):
        expected = ", ".join(get_args(ComparedPart))
        raise WireError(f"'{message.kind}': reference_for is {found!r:.80}; expected a list of {expected}")
    return frozenset(found)


def frame_arrays(frame: GridFrame) -> Arrays:
    """`frame` as arrays, for `update`."""
    pose = frame.world_T_grid
    return {
        "stamp_ns": np.array([frame.stamp_ns], np.int64),
        "world_T_grid": np.array([pose.x, pose.y, pose.theta], np.float64),
        "origins": frame.origins,
        "points": frame.points,
        "point_origin": frame.point_origin,
        "visible": frame.visible,
        "occupied": frame.occupied,
    }


def frame_from(message: Message) -> GridFrame:
    """The frame in `update`. Raises WireError."""
    points = message.array("points", "float32", (None, 2))
    visible = message.array("visible", "bool", (None, None))
    return GridFrame(
        stamp_ns=int(message.array("stamp_ns", "int64", (1,))[0]),
        visible=visible,
        occupied=message.array("occupied", "bool", visible.shape),
        world_T_grid=SE2(*message.array("world_T_grid", "float64", (3,)).tolist()),
        origins=message.array("origins", "float32", (None, 2)),
        points=points,
        point_origin=message.array("point_origin", "uint8", points.shape[:1]),
    )


def forecast_fields(forecast: Forecast) -> tuple[dict[str, Any], Arrays]:
    """`forecast` as JSON fields and arrays, for the answer to `predict`.

    Raises WireError for a plane that is not an array and an object that is not a TrackedObject.
    """
    planes = {name: getattr(forecast, name) for name in ("occupancy", "semantics", "velocity", "futures")}
    arrays = {name: plane for name, plane in planes.items() if plane is not None}
    for name, plane in arrays.items():
        if not isinstance(plane, np.ndarray):
            raise WireError(f"{name} is a {type(plane).__name__}; expected a numpy array")
    _refuse_other_objects(forecast.objects)
    if not forecast.objects:
        return {}, arrays
    objects = forecast.objects
    labels = sorted({o.label for o in objects} - {""})
    try:
        arrays |= {
            "object_track": np.array([o.track for o in objects], np.int64),
            "object_box": np.stack([o.box for o in objects]).astype(np.float32),
            "object_velocity": np.stack([o.velocity for o in objects]).astype(np.float32),
            "object_covariance": np.stack([o.covariance for o in objects]).astype(np.float32),
            "object_label": np.array([labels.index(o.label) if o.label else -1 for o in objects], np.int32),
        }
    except (TypeError, ValueError) as error:
        raise WireError(f"the objects of the forecast are not numbers, or differ in shape ({error})") from None
    return {"labels": labels}, arrays


def _refuse_other_objects(objects: Any) -> None:
    """Raises WireError unless all `objects` are TrackedObjects."""
    if objects is not None and not isinstance(objects, (tuple, list)):
        raise WireError(f"objects is a {type(objects).__name__}; expected a tuple of TrackedObject")
    for tracked in objects or ():
        if not isinstance(tracked, TrackedObject):
            raise WireError(f"objects has an element of type {type(tracked).__name__}; expected only TrackedObject")


def forecast_limit(grid: GridSpec, steps: int, classes: int) -> int:
    """Upper bound of the body of an answer to `predict`, in bytes."""
    of_a_cell = 4 * (1 + classes + 2) + 2 * MAX_FUTURES
    return (steps + 1) * grid.size**2 * of_a_cell + MAX_OBJECTS * (8 + 4 * (5 + 2 + 16 + 1))


def forecast_from(message: Message, grid: GridSpec, steps: int, classes: int, *, gaps: bool = False) -> Forecast:
    """The forecast in the answer to `predict`: shapes, types and ranges of `Forecast` are checked. Raises WireError.

    `classes`: number of classes of the tracker; `gaps`: its occupancy may be NaN, in cells without a forecast.
    """
    semantics = None
    occupancy = _plane(message, "occupancy", (steps + 1, *grid.shape))
    _in_unit_range("occupancy", np.nan_to_num(occupancy) if gaps else occupancy)
    if "semantics" in message.arrays:
        if not classes:
            raise WireError("semantics from a tracker that names no classes")
        semantics = _plane(message, "semantics", (steps + 1, classes, *grid.shape))
        _in_unit_range("semantics", semantics)
        _sums_to_one(semantics)
    velocity, futures = _velocity(message, grid, steps), _futures(message, grid, steps)
    return Forecast(occupancy, semantics, velocity, objects_from(message), futures)


def without_semantics(forecast: Forecast) -> Forecast:
    """`forecast` without its class probabilities, copied, so that the memory of the message can be freed."""
    velocity, futures = forecast.velocity, forecast.futures
    return Forecast(
        forecast.occupancy.copy(),
        None,
        None if velocity is None else velocity.copy(),
        tuple(
            replace(one, box=one.box.copy(), velocity=one.velocity.copy(), covariance=one.covariance.copy())
            for one in forecast.objects
        ),
        None if futures is None else futures.copy(),
    )


def _velocity(message: Message, grid: GridSpec, steps: int) -> NDArray[np.float32] | None:
    if "velocity" not in message.arrays:
        return None
    now_alone, at_steps = (2, *grid.shape), (steps + 1, 2, *grid.shape)
    shape = message.arrays["velocity"].shape
    if shape not in (now_alone, at_steps):
        raise WireError(f"velocity has shape {shape}; expected {at_steps}, or {now_alone} for step 0 alone")
    velocity = _plane(message, "velocity", shape)
    if np.isinf(velocity).any():
        raise WireError(f"velocity has {np.count_nonzero(np.isinf(velocity))} infinite values; NaN says: no velocity")
    return velocity


def _futures(message: Message, grid: GridSpec, steps: int) -> NDArray[np.bool_] | NDArray[np.float16] | None:
    if "futures" not in message.arrays:
        return None
    futures = message.array("futures", message.arrays["futures"].dtype.name, (None, steps + 1, *grid.shape))
    if futures.dtype.name not in FUTURES_DTYPES:
        raise WireError(f"futures is {futures.dtype}; expected {' or '.join(FUTURES_DTYPES)}")
    if not 2 <= len(futures) <= MAX_FUTURES:
        raise WireError(f"{len(futures)} futures in one forecast; expected 2 to {MAX_FUTURES}")
    if futures.dtype != np.bool_:
        _in_unit_range("futures", futures)
    return futures


def _plane(message: Message, name: str, shape: tuple[int, ...]) -> NDArray[np.float32]:
    """The array `name` as float32; its dtype and shape checked."""
    found = message.arrays.get(name)
    if found is None:
        raise WireError(f"the forecast has no '{name}'")
    if found.shape != shape:
        raise WireError(f"{name} has shape {found.shape}; expected {shape}")
    if found.dtype.name not in FORECAST_DTYPES:
        raise WireError(f"{name} is {found.dtype}; expected {' or '.join(FORECAST_DTYPES)}")
    return found.astype(np.float32, copy=False)


def _in_unit_range(name: str, values: NDArray[np.floating]) -> None:
    low, high = values.min(), values.max()  # NaN passes through both
    if not (low >= 0.0 and high <= 1.0):
        _finite(name, values)
        raise WireError(f"{name} goes from {low:g} to {high:g}; expected probabilities in [0, 1]")


def _finite(name: str, values: NDArray[np.floating]) -> None:
    if not np.isfinite(values).all():
        raise WireError(f"{name} has {np.count_nonzero(~np.isfinite(values))} values that are not finite")


def _sums_to_one(semantics: NDArray[np.float32]) -> None:
    # 5e-3: bound of the rounding error of K classes in float16
    worst = float(np.abs(semantics.sum(axis=1) - 1.0).max())
    if worst > 5e-3:
        raise WireError(f"semantics must sum to 1 over the classes; the largest error is {worst:.3g}")


def objects_from(message: Message) -> tuple[TrackedObject, ...]:
    """The objects in the answer to `predict`: shapes, types and labels are checked. Raises WireError."""
    if "object_track" not in message.arrays:
        return ()
    track = message.array("object_track", "int64", (None,))
    count = len(track)
    if count > MAX_OBJECTS:
        raise WireError(f"{count} objects in one forecast; at most {MAX_OBJECTS}")
    box = message.array("object_box", "float32", (count, 5))
    velocity = message.array("object_velocity", "float32", (count, 2))
    covariance = message.array("object_covariance", "float32", (count, 4, 4))
    index = message.array("object_label", "int32", (count,))
    labels = message.value("labels", list)
    for name, values in (("object_box", box), ("object_velocity", velocity), ("object_covariance", covariance)):
        _finite(name, values)
    if count and not (index.min() >= -1 and index.max() < len(labels)):
        raise WireError(f"object_label goes from {index.min()} to {index.max()}; there are {len(labels)} labels")
    if not all(isinstance(label, str) and is_label(label) for label in labels):
        raise WireError(f"the labels of the objects are not all names: {LABEL_RULE}")
    return tuple(
        TrackedObject(int(track[i]), box[i], velocity[i], covariance[i], labels[index[i]] if index[i] >= 0 else "")
        for i in range(count)
    )


def update_limit(grid: GridSpec) -> int:
    """Upper bound of the body of an `update`, in bytes: two planes, and a million returns from 256 sensors."""
    return 2 * grid.size**2 + 32 + 256 * 8 + (1 << 20) * 9
