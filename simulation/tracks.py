"""Tracks: the pose of every road user in each frame, and the lasers, from which scans are rendered."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_serializer, field_validator

from gridtrack.common.config import Settings
from gridtrack.common.files import NAME_RULE, is_name
from gridtrack.common.geometry import SE2
from gridtrack.common.scan import MIN_RATE_HZ, Scan
from gridtrack.common.scene import UNLABELLED, Outline, Scene, SceneObject
from gridtrack.recordings.recording_info import RecordingInfo
from gridtrack.simulation.bodies import Walker, body_outline, outlines_of
from gridtrack.simulation.laser import MATT, MAX_SCENE_M, Laser, SceneSurfaces
from gridtrack.simulation.motion import WheelOdometry, unbroken_tracks

MAX_FRAMES, MAX_USERS_PER_FRAME = 5_000_000, 1000
HALF_TURN_MRAD = 3141
MAX_OUTLINES, MAX_OUTLINE_CORNERS = 1000, 1000
MAX_LASERS = 8
MAX_WALKERS = 5000
ONLY_LASER = "scan"
"""The name of the laser if there is only one."""

Corner = tuple[float, float]


class Carrier(Settings):
    """The road user that carries the lasers in all frames; it is neither in the scans nor in the true scene.

    Without `odometry` the true poses are recorded.
    """

    track: int = Field(ge=0)
    odometry: WheelOdometry | None = None


class World(Settings):
    """The scene at the height of the lasers: people as walkers, and surfaces other than matt.

    `walkers` are the persons by track number; `glass` and `dark` are indices of static outlines.
    """

    plane_m: float = Field(ge=0.02, le=3.0)
    """Height of the lasers' plane above the ground."""
    walkers: dict[int, Walker] = Field(default_factory=dict, max_length=MAX_WALKERS)
    glass: frozenset[int] = frozenset()
    dark: frozenset[int] = frozenset()

    def surfaces(self) -> SceneSurfaces:
        """The surfaces for a laser."""
        clothes = frozenset(track for track, walker in self.walkers.items() if walker.dark)
        return SceneSurfaces(self.glass, self.dark, clothes)

    @field_serializer("glass", "dark")
    def _sorted(self, numbers: frozenset[int]) -> list[int]:
        return sorted(numbers)


class TracksInfo(Settings):
    """The input of a rendered recording besides its tracks.

    The poses of `lasers` are `world_T_sensor`, or with a carrier `carrier_T_sensor`. `static` outlines are corners in
    metres, world frame, counter-clockwise. `noise_seed` seeds the noise of the lasers.
    """

    recording: RecordingInfo
    lasers: dict[str, Laser] = Field(min_length=1, max_length=MAX_LASERS)
    frames: int = Field(ge=1, le=MAX_FRAMES)
    rate_hz: float = Field(ge=MIN_RATE_HZ, le=1000.0)
    noise_seed: int = Field(default=0, ge=0, lt=1 << 63)
    static: tuple[tuple[Corner, ...], ...] = Field(default=(), max_length=MAX_OUTLINES)
    static_class: str | None = None
    made_with: dict[str, str] = Field(default_factory=dict)
    """Versions of the simulation programs."""
    carrier: Carrier | None = None
    world: World | None = None
    """None: every road user has the outline of its class, at any height."""

    @field_validator("lasers")
    @classmethod
    def _check_names(cls, lasers: dict[str, Laser]) -> dict[str, Laser]:
        if any(not is_name(name) for name in lasers):
            raise ValueError(f"the name of a laser: {NAME_RULE}")
        return lasers

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
    """Road users over time, one row for each frame and track, sorted by frame, then track.

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
        seen = self.without_carrier()
        outlines = seen._walker_outlines()
        starts = np.searchsorted(seen.frame, np.arange(self.info.frames + 1)).tolist()
        for first, end in itertools.pairwise(starts):
            columns = (column[first:end].tolist() for column in (seen.track, seen.label, seen.pose, seen.size))
            objects = tuple(
                SceneObject(track, label, SE2(*pose), outline)
                for row, track, label, pose, size in zip(range(first, end), *columns, strict=True)
                for outline in outlines.get(row) or (body_outline(classes[label], *size),)
            )
            yield Scene(static, static_label, objects)

    def _walker_outlines(self) -> dict[int, tuple[Outline, ...]]:
        """The outlines of walkers by row."""
        world = self.info.world
        if world is None:
            return {}
        found: dict[int, tuple[Outline, ...]] = {}
        order = np.lexsort((self.frame, self.track))
        for part in unbroken_tracks(self.track[order], self.frame[order]):
            rows = order[part]
            walker = world.walkers.get(int(self.track[rows[0]]))
            if walker is not None:
                length_m, width_m = self.size[rows[0]].tolist()
                position, heading = self.pose[rows, :2], np.unwrap(self.pose[rows, 2])
                outlines = outlines_of(walker, world.plane_m, (length_m, width_m), position, heading, self.info.rate_hz)
                found.update(zip(rows.tolist(), outlines, strict=True))
        return found

    def scans(self) -> Iterator[Scan]:
        """The scans of each frame, in the order of the lasers.

        Their noise depends on the seed, the frame number and the index of the laser only.
        """
        info = self.info
        period_ns = round(1e9 / info.rate_hz)
        true = {name: self.sensor_poses(name).tolist() for name in info.lasers}
        recorded = self._recorded_poses()
        surfaces = MATT if info.world is None else info.world.surfaces()
        for frame, scene in enumerate(self.scenes()):
            for number, (name, laser) in enumerate(info.lasers.items()):
                random = np.random.default_rng([info.noise_seed, frame, number] if number else [info.noise_seed, frame])
                pose = SE2(*true[name][frame])
                scan = replace(laser.scan(scene, frame * period_ns, pose, random, surfaces), sensor=name)
                if name in recorded:
                    scan = replace(scan, world_T_sensor=SE2(*recorded[name][frame]), reference_T_sensor=pose)
                yield scan

    def sensor_poses(self, name: str) -> NDArray[np.float64]:
        """The true pose `world_T_sensor` of a laser in each frame: x, y, heading (frames, 3)."""
        laser = self.info.lasers[name]
        if self.info.carrier is None:
            return np.broadcast_to([laser.x, laser.y, laser.theta], (self.info.frames, 3))
        return _mounted(self.pose[self.track == self.info.carrier.track], laser)

    def _recorded_poses(self) -> dict[str, list[list[float]]]:
        """The recorded poses of each laser, if they differ from the true ones."""
        carrier = self.info.carrier
        if carrier is None or carrier.odometry is None:
            return {}
        recorded = carrier.odometry.recorded(self.pose[self.track == carrier.track])
        return {name: _mounted(recorded, laser).tolist() for name, laser in self.info.lasers.items()}

    def without_carrier(self) -> Tracks:
        """The rows of the road users except the carrier."""
        return self if self.info.carrier is None else self.where(self.track != self.info.carrier.track)

    def where(self, kept: NDArray[np.bool_]) -> Tracks:
        """The rows marked by `kept` (N,)."""
        return replace(
            self,
            frame=self.frame[kept],
            track=self.track[kept],
            label=self.label[kept],
            pose=self.pose[kept],
            size=self.size[kept],
        )

    def rounded(self) -> Tracks:
        """The tracks rounded to the resolution of the file."""
        heading = np.arctan2(np.sin(self.pose[:, 2]), np.cos(self.pose[:, 2]))
        heading_mrad = np.clip(np.round(heading * 1000.0), -HALF_TURN_MRAD, HALF_TURN_MRAD)
        whole = np.column_stack([np.round(self.pose[:, :2] * 100.0), heading_mrad])
        rounded = whole / (100.0, 100.0, 1000.0)
        return replace(self, pose=rounded, size=np.round(self.size * 100.0) / 100.0)


def _mounted(bodies: NDArray[np.float64], laser: Laser) -> NDArray[np.float64]:
    """The poses (n, 3) of a laser mounted on bodies with the poses (n, 3)."""
    poses = (SE2(*body) @ laser.pose for body in bodies.tolist())
    return np.array([(pose.x, pose.y, pose.theta) for pose in poses])
