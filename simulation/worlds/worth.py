"""Whether there is something to see in a world: how often a beam ends on a road user in the window."""

from __future__ import annotations

import numpy as np

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridSpec
from gridtrack.simulation.laser import sweep
from gridtrack.simulation.tracks import ONLY_LASER, Tracks

EVERY_S = 1.0
LEAST_BEAMS = 2
MOVED_M = 1.0


def seen_share(tracks: Tracks) -> float:
    """The share of the seconds of a world in which at least LEAST_BEAMS beams end on somebody who moves in it.

    Who stays in one place all the time, such as a parked car, does not count.
    """
    info = tracks.info
    laser, poses = info.lasers[ONLY_LASER], tracks.sensor_poses(ONLY_LASER)
    grid = GridSpec.parse(info.recording.grid or "")
    half_m = grid.size * grid.cell_m / 2.0
    every = max(round(EVERY_S * info.rate_hz), 1)
    of_track = {number: tracks.pose[tracks.track == number, :2] for number in np.unique(tracks.track).tolist()}
    moving = [number for number, position in of_track.items() if np.ptp(position, axis=0).max() > MOVED_M]
    sampled = tracks.where(np.isin(tracks.track, moving) & (tracks.frame % every == 0))
    seen = []
    for frame, scene in enumerate(sampled.scenes()):
        if frame % every == 0:
            beams = (laser.angle_min, laser.angle_increment, laser.beams, min(laser.range_max, half_m))
            _, labels = sweep(scene, SE2(*poses[frame].tolist()), *beams)
            on_users = labels < info.recording.classes.index("static")
            seen.append(int(on_users.sum()) >= LEAST_BEAMS)
    return float(np.mean(seen))
