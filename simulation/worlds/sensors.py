"""The lasers of worlds, drawn near real products, their windows, and good standing poses."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from gridtrack.common.geometry import SE2
from gridtrack.common.scene import UNLABELLED, Outline, Scene
from gridtrack.simulation.laser import Laser, LaserErrors, sweep
from gridtrack.simulation.tracks import Corner

GRID_CELLS = 100
CELLS_M = (0.05, 0.06, 0.08, 0.1, 0.12, 0.15, 0.2)
BEHIND = 0.2
"""Share of the window's side behind a laser with a limited field of view."""
SHIN_M, HIP_M = (0.08, 0.45), (0.8, 1.1)
"""Heights of mounted lasers: never at the height of a table top."""
SHIN_SHARE = 0.85
TRY_BEAMS = 240
SLOWEST_HZ, FASTEST_HZ = 5.0, 20.0
THINNED_SHARE = 0.4
"""Share of recordings with every second scan or fewer, if the rate allows it."""
UNKNOWN_SHARE = 0.35
"""Share of the drivers that report NaN for a beam without a return, as those of many cheap lasers do."""
SHORT_SHARE, SHORT_REACH = 0.5, (0.7, 1.5)
"""Share of these lasers that lose their returns beyond a short reach, and the reach by half of the window's side: in
recordings of such lasers 40 to 80 % of the ranges are NaN."""


class LaserProduct(NamedTuple):
    """A laser: field of view, beams, maximum range (m), scans per second, and the errors of the ranges (m)."""

    view_deg: float
    beams: int
    range_m: float
    rate_hz: float
    std_m: float
    std_per_m: float
    resolution_m: float


# The range errors of the first three are measured on static surfaces in real recordings (leg_tracker package: 4 to
# 11 mm); data sheets state larger errors.
PRODUCTS = (
    LaserProduct(240, 683, 5.6, 10, 0.003, 0.001, 0.001),  # Hokuyo URG-04LX
    LaserProduct(180, 512, 5.6, 10, 0.003, 0.001, 0.001),
    LaserProduct(270, 768, 11.0, 7.5, 0.0035, 0.0002, 0.001),
    LaserProduct(270, 1081, 30.0, 20, 0.008, 0.0004, 0.001),  # Hokuyo UTM-30LX, every second scan
    LaserProduct(180, 181, 80.0, 12, 0.005, 0.0004, 0.01),  # SICK LMS 200
    LaserProduct(180, 361, 80.0, 18, 0.005, 0.0004, 0.01),
    LaserProduct(270, 811, 25.0, 15, 0.015, 0.001, 0.001),  # SICK TiM571
    LaserProduct(360, 360, 12.0, 5.5, 0.003, 0.003, 0.001),  # RPLIDAR A1
    LaserProduct(360, 360, 8.0, 12.5, 0.004, 0.003, 0.001),
    LaserProduct(360, 800, 16.0, 10, 0.003, 0.002, 0.001),  # RPLIDAR A2
    LaserProduct(360, 1440, 30.0, 10, 0.01, 0.0005, 0.001),  # RPLIDAR S2
    LaserProduct(360, 900, 80.0, 10, 0.012, 0.0002, 0.002),  # one ring of a Velodyne
)
OUTDOOR_RANGE_M = 16.0


@dataclass(frozen=True)
class WorldSensor:
    """A laser without a pose, its rate, its height, and the cell size of the window."""

    laser: Laser
    rate_hz: float
    plane_m: float
    cell_m: float

    @property
    def view_rad(self) -> float:
        """The angle from the first beam to the last."""
        return self.laser.angle_increment * (self.laser.beams - 1)

    def grid(self, standing: bool) -> str:
        """The window: ahead of a standing laser with a limited field of view, else centred on the laser."""
        side_m = GRID_CELLS * self.cell_m
        ahead = standing and self.view_rad < math.radians(300.0)
        return f"{GRID_CELLS}x{self.cell_m:g}@{-(BEHIND if ahead else 0.5) * side_m:g},{-0.5 * side_m:g}"


def draw_sensor(random: np.random.Generator, outdoors: bool) -> WorldSensor:
    """A random laser near one of PRODUCTS, with a random driver."""
    # a generator of its own: the worlds of the other drivers stay as they were before drivers were drawn
    (driver,) = random.spawn(1)
    return _with_driver(driver, _draw_laser(random, outdoors))


def _with_driver(random: np.random.Generator, sensor: WorldSensor) -> WorldSensor:
    """The sensor with a driver that reports NaN or +inf for a beam without a return."""
    laser = sensor.laser
    if laser.errors is None or random.random() >= UNKNOWN_SHARE:
        return sensor
    changes: dict[str, object] = {"errors": laser.errors.model_copy(update={"no_return": "nan"})}
    if random.random() < SHORT_SHARE:
        reach_m = random.uniform(*SHORT_REACH) * GRID_CELLS * sensor.cell_m / 2.0
        changes["range_max"] = round(min(laser.range_max, float(reach_m)), 2)
    return replace(sensor, laser=laser.model_copy(update=changes))


def _draw_laser(random: np.random.Generator, outdoors: bool) -> WorldSensor:
    suited = [one for one in PRODUCTS if not outdoors or one.range_m >= OUTDOOR_RANGE_M]
    one = suited[random.integers(len(suited))]
    beams = int(np.clip(round(one.beams * random.choice([0.5, 1.0, 1.0, 1.3])), 180, 1440))
    range_m = float(np.clip(one.range_m * random.uniform(0.9, 1.2), 5.0, 80.0))
    view = math.radians(one.view_deg)
    step = view / beams if one.view_deg == 360 else view / (beams - 1)
    laser = Laser(
        angle_min=round(-view / 2.0, 6),
        angle_increment=round(step, 8),
        beams=beams,
        range_min=round(float(random.uniform(0.02, 0.15)), 3),
        range_max=round(range_m, 2),
        errors=_draw_errors(random, one),
    )
    reach_m = min(range_m, random.uniform(8.0, 11.0) if outdoors else random.uniform(2.8, 7.0))
    cell_m = CELLS_M[int(np.abs(np.array(CELLS_M) - 2.0 * reach_m / GRID_CELLS).argmin())]
    plane_m = random.uniform(*(SHIN_M if random.random() < SHIN_SHARE else HIP_M))
    rate_hz = _draw_rate(random, one.rate_hz)
    return WorldSensor(laser, rate_hz, round(float(plane_m), 3), cell_m)


def _draw_rate(random: np.random.Generator, product_hz: float) -> float:
    """Recorded scans per second, a multiple of 0.5 Hz: all scans of the laser, or every n-th."""
    rate_hz = float(np.clip(product_hz * random.uniform(0.9, 1.1), SLOWEST_HZ, FASTEST_HZ))
    most = int(rate_hz / SLOWEST_HZ)
    thinned = most > 1 and random.random() < THINNED_SHARE
    return round(rate_hz / (random.integers(2, most + 1) if thinned else 1) * 2.0) / 2.0


def _draw_errors(random: np.random.Generator, one: LaserProduct) -> LaserErrors:
    factor = random.uniform(0.6, 1.6)
    rough = random.random() < 0.3
    values = {
        "std_m": one.std_m * factor,
        "std_per_m": one.std_per_m * factor,
        "lost": random.uniform(0.0, 0.05 if rough else 0.005),
        "invalid": random.uniform(0.0, 0.01) if random.random() < 0.4 else 0.0,
        "mixed": random.uniform(0.0, 0.6),
        "glass_seen": random.uniform(0.05, 0.6),
        "dark_reach": random.uniform(0.4, 1.0),
    }
    rounded = {name: round(float(value), 5) for name, value in values.items()}
    return LaserErrors.model_validate(rounded | {"resolution_m": one.resolution_m})


def standing_pose(
    sensor: WorldSensor, outlines: list[Outline], candidates: list[Corner], random: np.random.Generator
) -> SE2:
    """A pose at one of the candidate places with the widest views (two thirds), facing a wide view."""
    scene = Scene(tuple(outlines), UNLABELLED, ())
    views = [_widest_view(scene, sensor, at, random) for at in candidates]
    best = sorted(views, key=lambda view: -view[0])[: max(len(views) * 2 // 3, 1)]
    return best[random.integers(len(best))][1]


def _widest_view(scene: Scene, sensor: WorldSensor, at: Corner, random: np.random.Generator) -> tuple[float, SE2]:
    """The mean range in one of the wider directions, and the pose facing it."""
    reach_m = GRID_CELLS * sensor.cell_m
    turn = math.tau / TRY_BEAMS
    ranges, _ = sweep(scene, SE2(*at, 0.0), 0.0, turn, TRY_BEAMS, reach_m)
    seen = np.minimum(ranges.astype(np.float64), reach_m)
    if sensor.view_rad > math.radians(300.0):
        return float(seen.mean()), SE2(*at, float(random.uniform(0.0, math.tau)))
    half = round(sensor.view_rad / 2.0 / turn)
    means = [float(np.take(seen, np.arange(k - half, k + half + 1), mode="wrap").mean()) for k in range(TRY_BEAMS)]
    better = np.argsort(means, kind="stable")[TRY_BEAMS * 2 // 3 :]
    chosen = int(better[random.integers(len(better))])
    return means[chosen], SE2(*at, chosen * turn)
