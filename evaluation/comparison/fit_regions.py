"""Regions that the `score` of a training counts on: those of the referee, of whole stretches, as files.

The command finds them, because static outlines and speeds are truth that `fit` does not receive. They are found once
for each stretch, so every tracker, and every part of a stretch, is scored on the same cells.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.errors import RecordingError
from gridtrack.common.grid import GridSpec, Mask
from gridtrack.evaluation.scoring.in_process import score_in_process
from gridtrack.evaluation.scoring.motion import ObservedMotion, parts_of
from gridtrack.evaluation.scoring.strata import CELL_KINDS, cell_kinds_around, cell_kinds_of, region_maps_of
from gridtrack.recordings.stream import GridStream, Observation
from gridtrack.recordings.truth import static_cells
from gridtrack.trackers.contract import FrameSource, StretchScore, Tracker


def cell_kinds_for(stream: GridStream, streams: Iterable[GridStream]) -> NDArray[np.uint8]:
    """Kind of each cell (M, M) of `stream`, one of the `streams` of a training. Raises RecordingError.

    Static cells are those of the true scene. Without truth they are found in all stretches of the recording that the
    training has, and in no other: the rest of the recording may be scored later.
    """
    first = next(iter(stream.observations()))
    pose = first.frame.world_T_grid
    if first.scene is not None:
        return cell_kinds_around(static_cells(first.scene, stream.grid, pose))
    given = [other for other in streams if other.sha256 == stream.sha256 and other.grid == stream.grid]
    return cell_kinds_of(chain.from_iterable(given), stream.grid, pose)


class RegionsWriter:
    """Collects the regions of a stretch while its observations pass, and writes them."""

    def __init__(self, stream: GridStream, cell_kinds: NDArray[np.uint8]) -> None:
        self._stream, self._cell_kinds = stream, cell_kinds
        self._motion = ObservedMotion(stream, cell_kinds == CELL_KINDS.index("dynamic"))
        self._stamps_ns: list[int] = []
        self._moving: list[NDArray[np.int64]] = []

    def add(self, observation: Observation) -> None:
        """Find the returns in motion of the next observation. Raises RecordingError."""
        self._stamps_ns.append(observation.frame.stamp_ns)
        self._moving.append(np.flatnonzero(self._motion.moving(observation)))

    def write(self, path: Path) -> None:
        """Write an .npz file. Raises OSError."""
        np.savez_compressed(
            path,
            sha256=np.array(self._stream.sha256),
            grid=np.array(str(self._stream.grid)),
            cell_kinds=self._cell_kinds,
            stamps_ns=np.array(self._stamps_ns, np.int64),
            starts=np.cumsum([0, *map(len, self._moving)]),
            moving=np.concatenate([np.zeros(0, np.int64), *self._moving]).astype(np.int32),
        )


@dataclass(frozen=True, slots=True)
class StretchRegions:
    """The regions of one stretch.

    `cell_kinds` (M, M) uint8; `stamps_ns` (N,) int64 of its frames; the returns in motion of frame n are the cells
    `moving[starts[n] : starts[n + 1]]`, row * M + column.
    """

    sha256: str
    grid: str
    cell_kinds: NDArray[np.uint8]
    stamps_ns: NDArray[np.int64]
    starts: NDArray[np.int64]
    moving: NDArray[np.int32]

    @classmethod
    def read(cls, path: Path) -> StretchRegions:
        """From the file of `RegionsWriter.write`. Raises OSError."""
        with np.load(path, allow_pickle=False) as stored:
            arrays = (stored[name] for name in ("cell_kinds", "stamps_ns", "starts", "moving"))
            return cls(str(stored["sha256"]), str(stored["grid"]), *arrays)

    def has(self, source: FrameSource, stamp_ns: int) -> bool:
        """Whether the frame of `source` with this stamp is one of the stretch."""
        n = self._number(stamp_ns)
        same = source.sha256 == self.sha256 and str(source.grid) == self.grid
        return same and n < len(self.stamps_ns) and int(self.stamps_ns[n]) == stamp_ns

    def moving_at(self, stamp_ns: int, grid: GridSpec) -> Mask:
        """The returns in motion (M, M) of the frame with this stamp."""
        n = self._number(stamp_ns)
        mask = np.zeros(grid.shape, np.bool_)
        mask.reshape(-1)[self.moving[self.starts[n] : self.starts[n + 1]]] = True
        return mask

    def _number(self, stamp_ns: int) -> int:
        return int(np.searchsorted(self.stamps_ns, stamp_ns))


class StoredMotion:
    """Motion in a source whose frames are those of a stretch, or some of them."""

    def __init__(self, regions: StretchRegions, source: FrameSource) -> None:
        self._regions, self._source = regions, source
        self._dynamic = regions.cell_kinds == CELL_KINDS.index("dynamic")

    def of(self, observation: Observation) -> NDArray[np.uint8]:
        """`motion` (M, M) uint8 of the next observation."""
        frame, grid = observation.frame, self._source.grid
        return parts_of(self._regions.moving_at(frame.stamp_ns, grid), frame.occupied, self._dynamic, grid)


class FitScores:
    """The `score` function of a training: it scores stretches that `fit` received, and parts of them."""

    def __init__(self, regions: Sequence[StretchRegions]) -> None:
        self._regions = tuple(regions)

    def score(self, tracker: Tracker, source: FrameSource, steps: int) -> StretchScore:
        """Stream `source` through the tracker and score its forecasts. Raises RecordingError."""
        first = next(iter(source))
        regions = next((one for one in self._regions if one.has(source, first.stamp_ns)), None)
        if regions is None:
            raise RecordingError(f"{source.name}: not a stretch that fit received, nor a part of one: score needs one")
        maps = region_maps_of(regions.cell_kinds, source.grid, first.origins)
        return score_in_process(tracker, source, steps, maps, StoredMotion(regions, source))
