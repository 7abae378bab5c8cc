"""Regions of a stretch: the kinds of its cells in the world give region maps of the window of any frame."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from gridtrack.common.grid import GridSpec
from gridtrack.evaluation.scoring.observed_kinds import BLOCK_NS, observed_kinds
from gridtrack.evaluation.scoring.strata import STRATA, RegionMaps, region_maps_of
from gridtrack.evaluation.scoring.world_kinds import CellKinds, KindsOfOutlines
from gridtrack.recordings.observation import Observation
from gridtrack.recordings.stream import GridStream


class Regions:
    """The regions of a stretch, in the window of any of its frames; `strata` are the names of those scored.

    Bands of range are about the sensors at the frame whose window it is, the one that a forecast is made at.
    """

    def __init__(self, grid: GridSpec, kinds: CellKinds, strata: tuple[str, ...] = STRATA) -> None:
        self.strata = strata
        self._grid, self._kinds = grid, kinds
        self._newest: tuple[object, RegionMaps] | None = None

    def of(self, observation: Observation) -> RegionMaps:
        """The region maps of the window of an observation. Raises RecordingError for a scene that cannot be placed."""
        pose, origins, stamp_ns = observation.reference_T_grid, observation.frame.origins, observation.frame.stamp_ns
        key, newest = (pose, origins.tobytes(), stamp_ns // BLOCK_NS), self._newest
        if newest is not None and newest[0] == key:
            return newest[1]
        maps = region_maps_of(self._kinds.at(pose, stamp_ns), self._grid, origins, self.strata)
        self._newest = key, maps
        return maps


def regions_of(stream: GridStream, strata: tuple[str, ...], check: Callable[[], None] = lambda: None) -> Regions:
    """Regions of a stretch: from the true scene, without truth from a pass over the whole recording.

    `check()` is called at each frame of the pass; what it raises ends it. Raises RecordingError.
    """
    scene = next((one.scene for one in stream.observations() if one.scene), None) if stream.has_truth else None
    if scene:
        return Regions(stream.grid, KindsOfOutlines(scene, stream.grid), strata)
    return Regions(stream.grid, observed_kinds(_checked(stream.all_observations(), check), stream.grid), strata)


def _checked(observations: Iterator[Observation], check: Callable[[], None]) -> Iterator[Observation]:
    for observation in observations:
        check()
        yield observation
