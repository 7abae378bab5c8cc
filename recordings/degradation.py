"""Degraded scans: lost beams and sectors, range noise, lost scans and pose noise, the same for every tracker."""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field

from gridtrack.common.config import Settings, parse_pairs, validated
from gridtrack.common.errors import ConfigurationError
from gridtrack.common.geometry import SE2
from gridtrack.common.scan import Scan

DEGRADE_OPTION = "--degrade"
JITTER_LEVER_M = 5.0
"""Standard deviation of the position over the heading's: at this distance both move a point equally."""
SECTORS, SECTOR_NS = 36, 2_000_000_000
"""Sectors of a turn about the sensor, and the time for which one is lost."""


class Degradation(Settings):
    """The amount of each kind of degradation; 0 is none. Names have hyphens on the command line and in messages."""

    model_config = ConfigDict(alias_generator=lambda name: name.replace("_", "-"), populate_by_name=True)

    beam_dropout: float = Field(0.0, ge=0.0, le=1.0)
    """Probability that a beam becomes invalid (NaN), independent for each beam of each scan."""
    sector_dropout: float = Field(0.0, ge=0.0, le=1.0)
    """Probability that a sector of ten degrees becomes invalid (NaN) for two seconds, as where a driver writes NaN for
    no return."""
    range_noise: float = Field(0.0, ge=0.0, le=100.0)
    """Standard deviation of the noise on the range of each return, metres; clipped to the laser's range limits."""
    frame_drop: float = Field(0.0, ge=0.0, le=1.0)
    """Probability that a scan is lost: its frame is then empty."""
    pose_jitter: float = Field(0.0, ge=0.0, le=100.0)
    """Standard deviation of the noise on the x and y of each pose, metres; a fifth of it on the heading, radians."""

    @property
    def kinds(self) -> tuple[str, ...]:
        """The names of the kinds that are not 0."""
        return tuple(kind for kind, value in self if value > 0.0)

    def only(self, kind: str) -> Degradation:
        """This degradation with one kind only."""
        return Degradation(**{kind: getattr(self, kind)})

    def scaled(self, share: float) -> Degradation:
        """This degradation with every kind at `share` of its value."""
        return Degradation(**{kind: share * value for kind, value in self})


def parse_degradation(text: str) -> Degradation:
    """Read `KIND=VALUE,...`, such as `beam-dropout=0.2,range-noise=0.05`.

    Raises ConfigurationError.
    """
    pairs = {kind.replace("_", "-"): value for kind, value in parse_pairs(text, DEGRADE_OPTION).items()}
    degradation = validated(Degradation, pairs, DEGRADE_OPTION)
    if not degradation.kinds:
        known = ", ".join(f"{field.alias}=..." for field in Degradation.model_fields.values())
        raise ConfigurationError(f"{DEGRADE_OPTION}: '{text}' degrades nothing; expected one or more of {known}")
    return degradation


def degrader(degradation: Degradation, seed: int) -> Callable[[Scan], Scan]:
    """A function that degrades one scan; labels and the true scene are not changed.

    The random numbers depend on `seed`, the scan's stamp and its sensor only. Every pass over a recording is thus
    degraded in the same way, and a stronger degradation drops the beams that a weaker one drops, and more.
    """

    def degrade(scan: Scan) -> Scan:
        # all are always drawn, in this order, so that one kind does not change the random numbers of another
        rng = np.random.default_rng([seed, scan.stamp_ns, zlib.crc32(scan.sensor.encode())])
        lost, (dx, dy, turn) = rng.random(), rng.standard_normal(3)
        dropped, noise = rng.random(scan.ranges.size), rng.standard_normal(scan.ranges.size)
        ranges = scan.ranges.astype(np.float32)
        returned = (ranges >= scan.range_min) & (ranges <= scan.range_max)
        noisy = ranges + degradation.range_noise * noise
        ranges[returned] = noisy[returned].clip(scan.range_min, scan.range_max)
        ranges[dropped < degradation.beam_dropout] = math.nan
        ranges[_of_sectors(scan, seed) < degradation.sector_dropout] = math.nan
        if lost < degradation.frame_drop:
            ranges[:] = math.nan
        pose, sigma = scan.world_T_sensor, degradation.pose_jitter
        jittered = SE2(pose.x + sigma * dx, pose.y + sigma * dy, pose.theta + sigma * turn / JITTER_LEVER_M)
        return replace(scan, ranges=ranges, world_T_sensor=jittered if sigma else pose)

    return degrade


def _of_sectors(scan: Scan, seed: int) -> NDArray[np.float64]:
    """A random number (B,) for each beam, in [0, 1): equal in a sector, and for SECTOR_NS."""
    rng = np.random.default_rng([seed, scan.stamp_ns // SECTOR_NS, zlib.crc32(scan.sensor.encode()), SECTORS])
    angles = scan.angle_min + scan.angle_increment * np.arange(scan.ranges.size)
    drawn: NDArray[np.float64] = rng.random(SECTORS)[np.floor(angles * SECTORS / math.tau).astype(np.int64) % SECTORS]
    return drawn
