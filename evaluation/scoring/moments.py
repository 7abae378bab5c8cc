"""Moments of a stretch: observed frames that give a target in the window of any forecast.

The window of a forecast stays where it was at the frame that it was made at. Where the sensor has moved since then, the
scans of a later frame are cast into that window from their own poses; the frame itself is not shifted.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol, runtime_checkable

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame
from gridtrack.evaluation.scoring.motion import MotionFinder, ReturnsInMotion, parts_of
from gridtrack.evaluation.scoring.regions import Regions
from gridtrack.evaluation.scoring.strata import RegionMaps
from gridtrack.evaluation.scoring.target import Target, target_of
from gridtrack.recordings.observation import Observation
from gridtrack.trackers.contract import FrameSource


class Moment:
    """One observed frame of a `source` with these `regions`; `in_motion` of its returns."""

    def __init__(
        self, observation: Observation, in_motion: ReturnsInMotion, source: FrameSource, regions: Regions
    ) -> None:
        self._observation, self._in_motion, self._source, self._regions = observation, in_motion, source, regions
        self._newest: tuple[SE2, RegionMaps, Target] | None = None

    @property
    def frame(self) -> GridFrame:
        """The frame as a tracker receives it."""
        return self._observation.frame

    @property
    def cell_m(self) -> float:
        """Side of a cell, metres."""
        return self._source.grid.cell_m

    @property
    def window(self) -> SE2:
        """`reference_T_grid` of the frame."""
        return self._observation.reference_T_grid

    @property
    def region_maps(self) -> RegionMaps:
        """The regions of the cells of the frame's own window. Raises RecordingError."""
        return self._regions.of(self._observation)

    def target_in(self, window: SE2, region_maps: RegionMaps) -> Target:
        """The target in the window of a forecast, whose cells have these regions. Raises RecordingError."""
        newest = self._newest
        # the regions of a window change with time too (`observed_kinds.BLOCK_NS`)
        if newest is None or newest[0] != window or newest[1] is not region_maps:
            grid = self._source.grid
            seen = self._observation.seen_in(window, grid)
            moving = self._in_motion.among(seen, grid)
            motion = parts_of(moving, seen.frame.occupied, region_maps.dynamic, grid)
            bodies = self._in_motion.bodies
            target = target_of(seen, grid, self._source.classes, motion, bodies)
            self._newest = newest = window, region_maps, target
        return newest[2]

    @property
    def target(self) -> Target:
        """The target in the frame's own window. Raises RecordingError."""
        return self.target_in(self.window, self.region_maps)


@runtime_checkable
class Observed(Protocol):
    """A source that has observations, and not only frames."""

    def observations(self) -> Iterator[Observation]: ...  # noqa: D102


def moments(stream: FrameSource, regions: Regions, motion: MotionFinder) -> Iterator[Moment]:
    """The frames of a stretch as moments; with the truth and labels that its source has."""
    observations = stream.observations() if isinstance(stream, Observed) else map(Observation, stream)
    return (Moment(observation, motion.of(observation), stream, regions) for observation in observations)
