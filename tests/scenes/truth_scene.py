"""A scene with truth: a room, a screen that hides part of it, and boxes that move behind and in front of it."""

import io

import numpy as np

from gridtrack.common.geometry import SE2
from gridtrack.common.scan import Scan
from gridtrack.common.scene import Scene, SceneObject
from gridtrack.recordings import RecordingInfo, write_native
from gridtrack.simulation.laser import sweep

from scenes.drives import box
from scenes.read_once import write_shared

CLASSES = ("pedestrian", "cyclist", "static")
GRID = "40x0.25@-5,-1"
RATE_HZ, BEAMS, RANGE_MAX_M = 10, 721, 20.0
ANGLE_MIN, STEP = -np.pi / 2, np.pi / 360
WALKER, RIDER = 0, 1


SCREEN = box(-1.6, 3.0, 3.2, 0.3)
ROOM = (
    box(-4.6, -0.8, 9.2, 0.3),
    box(-4.6, 8.4, 9.2, 0.3),
    box(-4.8, -0.6, 0.3, 9.2),
    box(4.5, -0.6, 0.3, 9.2),
    SCREEN,
)
WALKERS_OUTLINE, RIDERS_OUTLINE = box(-0.3, -0.3, 0.6, 0.6), box(-0.8, -0.3, 1.6, 0.6)


def to_and_fro(time_s, period_s, reach_m):
    """A position between -reach_m and reach_m, metres, moving to and fro at constant speed."""
    share = time_s / period_s % 1.0
    return reach_m * (4 * share - 1 if share < 0.5 else 3 - 4 * share)


def scene(index):
    """The pedestrian walks behind the screen, four seconds each way; the cyclist rides in front of it."""
    time_s = index / RATE_HZ
    return Scene(
        ROOM,
        CLASSES.index("static"),
        (
            SceneObject(1, WALKER, SE2(to_and_fro(time_s, 8.0, 3.4), 5.0, 0.3), WALKERS_OUTLINE),
            SceneObject(2, RIDER, SE2(to_and_fro(time_s, 5.0, 2.8), 1.7, 0.0), RIDERS_OUTLINE),
        ),
    )


def scan(index, noise_m=0.0, with_truth=True):
    """Scan of the scene by a laser at the origin, looking along y."""
    true_scene, pose = scene(index), SE2(0.0, 0.0, np.pi / 2)
    ranges, labels = sweep(true_scene, pose, ANGLE_MIN, STEP, BEAMS, RANGE_MAX_M)
    noise = noise_m * np.random.default_rng(index).standard_normal(BEAMS)
    return Scan(
        stamp_ns=1_000_000_000_000 + index * 1_000_000_000 // RATE_HZ,
        ranges=(ranges + noise).astype(np.float32),
        angle_min=ANGLE_MIN,
        angle_increment=STEP,
        range_min=0.05,
        range_max=RANGE_MAX_M,
        world_T_sensor=pose,
        labels=labels if with_truth else None,
        scene=true_scene if with_truth else None,
    )


def write_recording(path, seconds=20, noise_m=0.0, with_truth=True, stretches=None):
    """A native recording of the scene."""
    info = RecordingInfo(
        site="room",
        grid=GRID,
        rate_hz=RATE_HZ,
        classes=CLASSES if with_truth else (),
        stretches={"validation": (0.0, 7.0), "test": (7.0, None)} if stretches is None else stretches,
    )
    content = io.BytesIO()
    write_native(content, info, (scan(index, noise_m, with_truth) for index in range(seconds * RATE_HZ)))
    return write_shared(path, content.getvalue())
