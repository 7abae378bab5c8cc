"""Forecasts on disk: arrays in one `.npz` file, as `.npy` files in a folder, or in a Zarr store, of any program.

The arrays, N forecasts of T times ahead on H x W cells:

| name | shape and type | meaning |
|---|---|---|
| `occupancy` | (N, T, H, W) float16, float32, or uint8 as 255 p | P(occupied); NaN: no forecast of this cell |
| `stamp_ns` | (N,) int64, increasing | stamp of the last frame used, in the clock of the recording |
| `lead_s` | (T,), increasing | time ahead of the stamp, seconds |
| `cell_m` | () | side of a cell, metres |
| `origin_xy` | (2,) or (N, 2) | lower-left corner of cell [0, 0] in the frame, metres |
| `frame` | text | "world" (default), or "sensor" with `pose` |
| `pose` | (N, 3) or (N, T, 3) | world_T_sensor of each forecast or plane: x, y (metres), heading (radians) |
| `axes` | text | "yx" (default): occupancy[..., row, column], rows along y; "xy": occupancy[..., x, y] |
| `available_ns` | (N,) int64 | when the forecast was known; default: its stamp |
| `velocity` | (N, T, 2, H, W) | optional: x and y along the axes of the frame, m/s; NaN: no velocity |
| `futures` | (N, F, T, H, W) | optional: sampled futures |
| `note` | text | optional: how the forecasts were made |

Nothing is unpickled. Arrays that are not compressed stay on disk until they are used.
"""

from __future__ import annotations

import sys
import tokenize
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from gridtrack.common.errors import RecordingError, one_line
from gridtrack.common.files import atomic_write, open_regular, refuse_links
from gridtrack.common.forecast_zarr import is_zarr, zarr_arrays
from gridtrack.common.geometry import SE2

REQUIRED = ("occupancy", "stamp_ns", "lead_s", "cell_m", "origin_xy")
OPTIONAL = ("frame", "pose", "axes", "available_ns", "velocity", "futures", "note")
PLANES = ("occupancy", "velocity", "futures")
"""The arrays that may be large; the others are read at once."""
SMALL = tuple(name for name in (*REQUIRED, *OPTIONAL) if name not in PLANES)
FRAMES, AXES = ("world", "sensor"), ("yx", "xy")
MAX_SMALL_BYTES = 1 << 28
"""Limit of an array that is no plane."""
MAX_UNPACKED_BYTES = 1 << 31
"""Limit of a compressed array, which is unpacked as a whole."""
MAX_SIDE, MAX_LEADS, MAX_NOTE = 4096, 1000, 200
DAMAGE = (
    *(OSError, ValueError, EOFError, NotImplementedError, RuntimeError),
    *(zipfile.BadZipFile, zlib.error, tokenize.TokenError, TypeError),
)
"""Errors of zipfile and numpy for damaged files."""
_LOCAL_HEADER = 30
"""Bytes of the header of a member of a zip file before its name."""


@dataclass(frozen=True)
class ForecastFile:
    """The forecasts of a file, by their number n = 0..N-1, in the order of their stamps."""

    path: Path
    stamp_ns: NDArray[np.int64]
    """(N,)."""
    available_ns: NDArray[np.int64]
    """(N,)."""
    lead_s: NDArray[np.float64]
    """(T,)."""
    cell_m: float
    shape: tuple[int, int]
    """Numbers of rows and columns, (H, W)."""
    note: str
    _origin: NDArray[np.float64]
    _pose: NDArray[np.float64] | None
    _transposed: bool
    _planes: Mapping[str, NDArray[Any]]

    def __len__(self) -> int:
        return len(self.stamp_ns)

    @property
    def has_futures(self) -> bool:
        """Whether the forecasts have sampled futures."""
        return "futures" in self._planes

    @property
    def has_velocity(self) -> bool:
        """Whether the forecasts have velocities."""
        return "velocity" in self._planes

    def world_T_grid(self, n: int, lead: int) -> SE2:
        """The pose of the lower-left corner of cell [0, 0] of a plane, in the world; x along its columns."""
        corner = SE2(*self._origin[n])
        if self._pose is None:
            return corner
        return SE2(*(self._pose[n] if self._pose.ndim == 2 else self._pose[n, lead])) @ corner

    def occupancy(self, n: int, lead: int) -> NDArray[np.float32]:
        """P(occupied) (H, W); NaN: no forecast. Raises RecordingError for values outside [0, 1]."""
        return self._probabilities("occupancy", n, lead)

    def futures(self, n: int, lead: int) -> NDArray[np.float32]:
        """The sampled futures (F, H, W) at one time ahead. Raises RecordingError for values outside [0, 1]."""
        return self._probabilities("futures", n, slice(None), lead)

    def velocity(self, n: int, lead: int) -> NDArray[np.float32]:
        """The velocity (2, H, W) along the axes of the frame, m/s. Raises RecordingError for infinite values."""
        found = self._turned(self._read("velocity", n, lead).astype(np.float32))
        if np.isinf(found).any():
            raise RecordingError(f"{self.path}: velocity of forecast {n} is infinite")
        return found

    def _read(self, name: str, *index: Any) -> NDArray[Any]:
        try:
            return np.asarray(self._planes[name][index])
        except DAMAGE as error:
            raise RecordingError(f"{self.path}: {name} is damaged: {one_line(str(error), 200)}") from None

    def _probabilities(self, name: str, *index: Any) -> NDArray[np.float32]:
        n, stored = index[0], self._read(name, *index)
        found = self._turned(stored.astype(np.float32) / np.float32(255 if stored.dtype == np.uint8 else 1))
        if not (np.isnan(found) | ((found >= 0.0) & (found <= 1.0))).all():
            raise RecordingError(f"{self.path}: {name} of forecast {n} is outside [0, 1]: write probabilities")
        return found

    def _turned(self, planes: NDArray[np.float32]) -> NDArray[np.float32]:
        return planes.swapaxes(-1, -2) if self._transposed else planes


def write_forecasts(path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write the arrays to the `.npz` file `path`, not compressed, so that they stay on disk. Raises OSError."""
    with atomic_write(path) as file:
        np.savez(file, allow_pickle=False, **arrays)


def open_forecasts(path: Path) -> ForecastFile:
    """The forecasts in `path`: a `.npz` file, a folder of `.npy` files or a Zarr store, with the names above.

    Raises RecordingError if an array is missing, unknown or damaged, or the arrays do not fit each other.
    """
    arrays = _arrays_in(path)
    _refuse_names(path, arrays)
    occupancy = arrays["occupancy"]
    if occupancy.ndim != 4 or occupancy.dtype not in (np.float16, np.float32, np.uint8):
        raise _refusal(path, "occupancy", occupancy, "(N, T, H, W) float16, float32 or uint8")
    count, leads, *cells = occupancy.shape
    texts = {
        "frame": _text(path, arrays, "frame", FRAMES),
        "axes": _text(path, arrays, "axes", AXES),
        "note": one_line(_text(path, arrays, "note", ()), MAX_NOTE),
    }
    rows, columns = cells if texts["axes"] == "yx" else cells[::-1]
    if not (0 < rows <= MAX_SIDE and 0 < columns <= MAX_SIDE and 0 < leads <= MAX_LEADS):
        limits = f"1 to {MAX_SIDE} cells a side, and 1 to {MAX_LEADS} times ahead"
        raise _refusal(path, "occupancy", occupancy, limits)
    stamps = _stamps(path, arrays, "stamp_ns", count)
    if (np.diff(stamps) <= 0).any():
        n = int((np.diff(stamps) <= 0).argmax()) + 1
        raise RecordingError(f"{path}: stamp_ns of forecast {n} is not after the one before: sort them")
    lead_s = _numbers(path, arrays, "lead_s", [(leads,)])
    if lead_s[0] < 0 or (np.diff(lead_s) <= 0).any():
        raise RecordingError(f"{path}: lead_s must increase from 0 or above")
    cell_m = float(_numbers(path, arrays, "cell_m", [()]))
    if not 0.001 <= cell_m <= 100.0:
        raise RecordingError(f"{path}: cell_m is {cell_m:g}; expected 0.001 to 100 m")
    if (texts["frame"] == "sensor") != ("pose" in arrays):
        raise RecordingError(f'{path}: frame "sensor" needs pose, and frame "world" has none')
    pose = _numbers(path, arrays, "pose", [(count, 3), (count, leads, 3)]) if "pose" in arrays else None
    _refuse_planes(path, arrays, (count, leads, *cells))
    return ForecastFile(
        path=path,
        stamp_ns=stamps,
        available_ns=_stamps(path, arrays, "available_ns", count) if "available_ns" in arrays else stamps,
        lead_s=lead_s,
        cell_m=cell_m,
        shape=(rows, columns),
        note=texts["note"],
        _origin=np.broadcast_to(_numbers(path, arrays, "origin_xy", [(2,), (count, 2)]), (count, 2)),
        _pose=pose,
        _transposed=texts["axes"] == "xy",
        _planes={name: arrays[name] for name in PLANES if name in arrays},
    )


def _refuse_names(path: Path, arrays: Mapping[str, Any]) -> None:
    missing = [name for name in REQUIRED if name not in arrays]
    unknown = sorted(set(arrays) - {*REQUIRED, *OPTIONAL})
    if missing or unknown:
        parts = [f"no {', '.join(missing)}"] if missing else []
        parts += [f"unknown arrays {one_line(', '.join(unknown), 80)}"] if unknown else []
        known = ", ".join((*REQUIRED, *OPTIONAL))
        raise RecordingError(f"{path}: {' and '.join(parts)}; the arrays are {known}")


def _refuse_planes(path: Path, arrays: Mapping[str, NDArray[Any]], shape: tuple[int, ...]) -> None:
    """Refuse velocities and futures that do not fit the shape (N, T, H, W) of the occupancy."""
    count, leads, *cells = shape
    velocity, futures = arrays.get("velocity"), arrays.get("futures")
    if velocity is not None and (velocity.shape != (count, leads, 2, *cells) or velocity.dtype.kind != "f"):
        raise _refusal(path, "velocity", velocity, f"{(count, leads, 2, *cells)} float")
    if futures is not None and (
        futures.ndim != 5
        or (futures.shape[0], *futures.shape[2:]) != shape
        or futures.dtype not in (np.bool_, np.float16, np.float32, np.uint8)
    ):
        raise _refusal(path, "futures", futures, f"({count}, F, {', '.join(map(str, shape[1:]))}) bool, float or uint8")


def _refusal(path: Path, name: str, found: NDArray[Any], expected: str) -> RecordingError:
    return RecordingError(f"{path}: {name} is {found.shape} {found.dtype}; expected {expected}")


def _text(path: Path, arrays: Mapping[str, NDArray[Any]], name: str, allowed: tuple[str, ...]) -> str:
    """The text in an array; one of the `allowed`, the first by default."""
    found = arrays.get(name)
    if found is None:
        return allowed[0] if allowed else ""
    text = ""
    if found.shape == () and found.dtype.kind == "U":
        # numpy makes text of any numbers, and Python fails on those above its last character
        codes = np.frombuffer(found.tobytes(), np.dtype(np.uint32).newbyteorder(found.dtype.byteorder))[:MAX_NOTE]
        text = "".join(chr(code) for code in codes if code <= sys.maxunicode).rstrip("\0")
    if not text or (allowed and text not in allowed):
        raise RecordingError(f"{path}: {name} must be {' or '.join(allowed) or 'text'}")
    return text


def _stamps(path: Path, arrays: Mapping[str, NDArray[Any]], name: str, count: int) -> NDArray[np.int64]:
    found = arrays[name]
    if found.shape != (count,) or found.dtype != np.int64 or not count:
        raise _refusal(path, name, found, f"({count},) int64, nanoseconds, at least one")
    return found


def _numbers(
    path: Path, arrays: Mapping[str, NDArray[Any]], name: str, shapes: list[tuple[int, ...]]
) -> NDArray[np.float64]:
    found = arrays[name]
    if found.shape not in shapes or found.dtype.kind not in "fiu":
        raise _refusal(path, name, found, " or ".join(map(str, shapes)))
    numbers = found.astype(np.float64)
    if not np.isfinite(numbers).all():
        raise RecordingError(f"{path}: {name} has values that are not finite")
    return numbers


def _arrays_in(path: Path) -> dict[str, NDArray[Any]]:
    """The arrays by name; the planes stay on disk unless they are compressed. Raises RecordingError."""
    try:
        if is_zarr(path):
            return zarr_arrays(path, SMALL, MAX_SMALL_BYTES)
        if path.is_dir():
            refuse_links(path, RecordingError)
            return {file.stem: _read_file(file) for file in sorted(path.glob("*.npy"))}
        with open_regular(path) as file, zipfile.ZipFile(file) as packed:
            return {member.filename.removesuffix(".npy"): _read_member(packed, member) for member in packed.infolist()}
    except DAMAGE as error:
        reason = getattr(error, "strerror", None) or one_line(str(error), 200)
        raise RecordingError(
            f"{path}: no arrays of forecasts (.npz, a folder of .npy files, or Zarr): {reason}"
        ) from None


def _read_file(path: Path) -> NDArray[Any]:
    with open_regular(path) as file:
        return _read(file, path.stem)


def _read_member(packed: zipfile.ZipFile, member: zipfile.ZipInfo) -> NDArray[Any]:
    name = member.filename.removesuffix(".npy")
    if member.compress_type == zipfile.ZIP_STORED:
        assert packed.fp is not None
        packed.fp.seek(member.header_offset)
        header = packed.fp.read(_LOCAL_HEADER)
        lengths = (int.from_bytes(header[at : at + 2], "little") for at in (26, 28))
        packed.fp.seek(member.header_offset + _LOCAL_HEADER + sum(lengths))
        return _read(packed.fp, name)  # type: ignore[arg-type]
    with packed.open(member) as file:
        return _read(file, name, compressed=True)  # type: ignore[arg-type]


def _read(file: BinaryIO, name: str, *, compressed: bool = False) -> NDArray[Any]:
    """The array that begins in `file`. A plane stays on disk unless it is `compressed`."""
    shape, fortran, dtype = _header(file)
    needed = int(np.prod(shape, dtype=object)) * dtype.itemsize
    if dtype.hasobject or fortran:
        raise ValueError(
            f"{name} has Python objects" if dtype.hasobject else f"{name} is in Fortran order: use C order"
        )
    if name in PLANES and not compressed:
        return np.memmap(file, dtype, "r", file.tell(), shape)
    if needed > (MAX_UNPACKED_BYTES if name in PLANES else MAX_SMALL_BYTES):
        raise ValueError(f"{name} has {needed} bytes; save large arrays with numpy.savez, which does not compress")
    content = file.read(needed)
    if len(content) < needed:
        raise EOFError(f"{name} is cut: {len(content)} of {needed} bytes")
    return np.frombuffer(content, dtype).reshape(shape)


def _header(file: BinaryIO) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    version = npy.read_magic(file)
    if version not in ((1, 0), (2, 0)):
        raise ValueError(f"version {version} of the .npy format")
    read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
    shape, fortran, dtype = read(file)
    return tuple(shape), bool(fortran), dtype
