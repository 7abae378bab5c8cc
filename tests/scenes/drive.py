"""A drive through two rooms with truth: walls, pillars, people who walk and one who stands."""

from __future__ import annotations

import io
import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from gridtrack.common.geometry import SE2
from gridtrack.common.scan import Scan
from gridtrack.common.scene import Scene, SceneObject
from gridtrack.recordings import RecordingInfo, write_native
from gridtrack.simulation.laser import sweep

from scenes.drives import box
from scenes.read_once import write_shared

CLASSES = ("pedestrian", "static")
GRID, CELL_M, RATE_HZ, BEAMS, RANGE_MAX_M = "60x0.2", 0.2, 10, 720, 20.0


WALLS = (
    box(-6.1, -5.1, 30.2, 0.2),
    box(-6.1, 4.9, 30.2, 0.2),
    box(-6.1, -4.9, 0.2, 9.8),
    box(23.9, -4.9, 0.2, 9.8),
    box(8.9, -4.9, 0.2, 3.3),
    box(8.9, 1.6, 0.2, 3.3),
    *(box(x, y, 0.6, 0.6) for x, y in ((-2.3, 2.5), (3.7, -3.1), (13.3, 2.1), (17.7, -2.9))),
)
PERSON = box(-0.25, -0.2, 0.5, 0.4)


def scene(index, people=True):
    """Two people walk across the rooms at 1.2 m/s, and one stands."""
    along = abs((0.12 * index + 4.0) % 16.0 - 8.0) - 4.0
    at = ((1.5, along, math.pi / 2), (15.5, -along, -math.pi / 2), (6.2, 3.2, 0.0))
    bodies = tuple(SceneObject(track, 0, SE2(*pose), PERSON) for track, pose in enumerate(at))
    return Scene(WALLS, 1, bodies if people else ())


def true_pose(index, speed_mps):
    """To and fro through the door along the x axis, swaying, at `speed_mps`."""
    along = (speed_mps * index / RATE_HZ) % 48.0
    x = -3.0 + (along if along < 24.0 else 48.0 - along)
    return SE2(x, 0.6 * math.sin(0.4 * x), 0.25 * math.cos(0.4 * x) + 0.1 * math.sin(0.3 * index))


def scan(index, speed_mps=1.0, range_noise_m=0.0, pose_noise=(0.0, 0.0), people=True, with_truth=True):
    """A scan; the pose that trackers get is off by a normal error of `pose_noise`, metres and radians."""
    random = np.random.default_rng([7, index])
    truth, pose = scene(index, people), true_pose(index, speed_mps)
    ranges, labels = sweep(truth, pose, -math.pi, 2.0 * math.pi / BEAMS, BEAMS, RANGE_MAX_M)
    position_m, heading = pose_noise
    dx, dy, turn = random.standard_normal(3) * (position_m, position_m, heading)
    noisy = SE2(pose.x + dx, pose.y + dy, pose.theta + turn)
    made = Scan(
        stamp_ns=1_000_000_000_000 + index * 1_000_000_000 // RATE_HZ,
        ranges=(ranges + range_noise_m * random.standard_normal(BEAMS)).astype(np.float32),
        angle_min=-math.pi,
        angle_increment=2.0 * math.pi / BEAMS,
        range_min=0.05,
        range_max=RANGE_MAX_M,
        world_T_sensor=noisy,
    )
    return replace(made, labels=labels, scene=truth, reference_T_sensor=pose) if with_truth else made


def write_recording(path: Path, seconds=20, **how):
    """A native recording of a drive; `how` as of `scan`."""
    classes = CLASSES if how.get("with_truth", True) else ()
    info = RecordingInfo(site="rooms", grid=GRID, rate_hz=RATE_HZ, classes=classes)
    content = io.BytesIO()
    write_native(content, info, (scan(index, **how) for index in range(seconds * RATE_HZ)))
    return write_shared(path, content.getvalue())
