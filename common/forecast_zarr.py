"""Forecasts in a Zarr store (version 2 or 3): a folder with an array in each folder, and its texts as attributes.

Only codecs that cannot run code are used: a store may name others, such as pickle.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.errors import RecordingError
from gridtrack.common.files import read_json, refuse_links

GROUPS, ARRAYS = (".zgroup", "zarr.json"), (".zarray", "zarr.json")
"""Files that describe a group, and an array, in versions 2 and 3."""
CODECS = frozenset({"bytes", "blosc", "zlib", "gzip", "zstd", "lz4", "bz2", "lzma", "crc32c", "transpose"})
MAX_DESCRIPTION_BYTES = 1 << 20
MAX_CHUNK_BYTES = 1 << 31


def is_zarr(path: Path) -> bool:
    """Whether a folder is a group of a Zarr store."""
    return any((path / name).is_file() for name in GROUPS)


def zarr_arrays(path: Path, read_at_once: Iterable[str], max_bytes: int) -> dict[str, Any]:
    """The arrays of a group, and the texts among its attributes as arrays.

    Arrays `read_at_once` have at most `max_bytes`; the others read a chunk when they are indexed. Raises
    RecordingError, and errors of zarr for damaged chunks.
    """
    refuse_links(path, RecordingError)
    attributes = _attributes(path)
    found: dict[str, Any] = {name: np.array(text) for name, text in attributes.items() if isinstance(text, str)}
    small = set(read_at_once)
    for folder in sorted(entry for entry in path.iterdir() if entry.is_dir()):
        array = _opened(folder)
        if folder.name in small and array.nbytes > max_bytes:
            raise RecordingError(f"{folder}: {array.nbytes} bytes; at most {max_bytes}")
        found[folder.name] = np.asarray(array[...]) if folder.name in small else array
    return found


def _opened(folder: Path) -> NDArray[Any]:
    """The array in a folder; it reads its chunks when it is indexed."""
    try:
        import zarr
    except ImportError:
        raise RecordingError(f"{folder}: a Zarr store needs pip install 'gridtrack[zarr]'") from None
    used = set(_codecs(_description(folder)))
    if unknown := sorted(used - CODECS):
        raise RecordingError(f"{folder}: the codec '{unknown[0][:40]}'; known: {', '.join(sorted(CODECS))}")
    array: Any = zarr.open_array(str(folder), mode="r")
    if array.dtype.kind not in "fiub":
        raise RecordingError(f"{folder}: values of type {array.dtype}; expected numbers (texts are attributes)")
    if int(np.prod(array.chunks, dtype=object)) * array.dtype.itemsize > MAX_CHUNK_BYTES:
        raise RecordingError(f"{folder}: chunks of {array.chunks}; at most {MAX_CHUNK_BYTES} bytes each")
    opened: NDArray[Any] = array
    return opened


def _description(folder: Path) -> dict[str, Any]:
    for name in ARRAYS:
        if (folder / name).is_file():
            return read_json(folder / name, MAX_DESCRIPTION_BYTES, RecordingError)
    raise RecordingError(f"{folder}: no array of a Zarr store")


def _attributes(path: Path) -> Mapping[str, Any]:
    """The attributes of a group."""
    for name, key in ((".zattrs", ""), ("zarr.json", "attributes")):
        if (path / name).is_file():
            content = read_json(path / name, MAX_DESCRIPTION_BYTES, RecordingError)
            found = content.get(key, {}) if key else content
            return found if isinstance(found, dict) else {}
    return {}


def _codecs(description: Mapping[str, Any]) -> Iterable[str]:
    """The names of the codecs of an array."""
    version2 = [description.get("compressor"), *(description.get("filters") or ())]
    codecs = [one for one in (*version2, *(description.get("codecs") or ())) if one is not None]
    for one in codecs:
        yield str(one.get("id") or one.get("name")) if isinstance(one, dict) else str(one)
