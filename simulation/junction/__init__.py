"""Simulation of a signalled junction with pedestrians, cyclists, cars and buses, and a laser on its corner."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from importlib import resources
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.errors import ConfigurationError
from gridtrack.recordings.recording_info import RecordingInfo
from gridtrack.simulation.junction import layout, road_users
from gridtrack.simulation.junction.road_users import Patience
from gridtrack.simulation.laser import Laser
from gridtrack.simulation.motion import headings, smoothed, trailing_headings, unbroken_tracks
from gridtrack.simulation.sumo import STEP_S, Movements, run_sumo, sumo_version
from gridtrack.simulation.tracks import ONLY_LASER, Carrier, Tracks, TracksInfo

WARM_UP_S = 300.0
"""From the empty streets to steady traffic: three signal cycles of 96 s."""
MAX_MINUTES = 600.0
MARGIN_S = 3.0
"""Simulated before and after the recording for the smoothing."""
WALKING_STD_STEPS, ROLLING_STD_STEPS = 4.0, 1.0
WHEELS_BEHIND = 0.8
"""Distance of a vehicle's rear wheels from the front bumper, as a share of its length."""
JUNCTION_SET = {
    "train": (65.0, 1, WARM_UP_S),
    "validation": (5.0, 2, WARM_UP_S),
    **{f"test-{101 + k}": (1.0, 101 + k, WARM_UP_S + 5.0 * k) for k in range(20)},
}
"""Minutes, seed and start (s) of the packaged recordings. Training and test have different seeds; the tests are shorter
than a signal cycle and start at different times of it."""
LICENCE = "BSD-3-Clause"
CREDIT = "simulated with Eclipse SUMO and JuPedSim"


@dataclass(frozen=True)
class View:
    """The lasers, the road user that carries them (if any), the window, and the static outlines in range."""

    grid: str = layout.JUNCTION_GRID
    lasers: Mapping[str, Laser] = field(default_factory=lambda: {ONLY_LASER: layout.LASER})
    carrier: Carrier | None = None
    static: tuple[layout.CornerList, ...] = field(default_factory=layout.static_outlines)


ONE_CORNER = View()
TWO_CORNERS = View(lasers=layout.CORNER_LASERS, static=layout.static_outlines(south_eastern_post=False))


def simulate_junction(minutes: float, seed: int, start_s: float = WARM_UP_S, view: View = ONE_CORNER) -> Tracks:
    """`minutes` of the junction, `start_s` seconds after a start with empty streets; same seed, same tracks.

    Raises ConfigurationError if SUMO is not installed or the times are invalid, SimulationError if it fails.
    """
    traffic = simulate_traffic(frames_of(minutes), seed, start_s)
    return seen(
        traffic, view, command_of(minutes, seed, start_s) + (" --sensor corners" if view is TWO_CORNERS else "")
    )


def frames_of(minutes: float) -> int:
    """The number of frames in `minutes`. Raises ConfigurationError."""
    if not 0.0 < minutes <= MAX_MINUTES:
        raise ConfigurationError(f"{minutes:g} minutes: expected more than 0 and at most {MAX_MINUTES:g}")
    return max(round(minutes * 60.0 * layout.RATE_HZ), 1)


def command_of(minutes: float, seed: int, start_s: float) -> str:
    """The command line of a simulation with the laser on one corner."""
    start_s = round(start_s / STEP_S) * STEP_S
    return f"gridtrack simulate junction --minutes {minutes:g} --seed {seed} --start {start_s:g}s"


def simulate_traffic(frames: int, seed: int, start_s: float) -> Tracks:
    """The road users on the whole streets, even beyond the range of the laser on the corner.

    Raises ConfigurationError if SUMO is not installed or the start is invalid, SimulationError if it fails.
    """
    if not 0.0 <= start_s <= MAX_MINUTES * 60.0:
        raise ConfigurationError(f"a start at {start_s:g} s: expected one from 0 to {MAX_MINUTES * 60.0:g} s")
    start_s = round(start_s / STEP_S) * STEP_S
    before_s = min(MARGIN_S, start_s)
    span_s = (start_s - before_s, start_s + frames * STEP_S + MARGIN_S)
    here = Path(str(resources.files("gridtrack.simulation.junction")))
    with tempfile.TemporaryDirectory() as folder:
        signals = (here / "signals.add.xml",)
        movements = run_sumo(
            Path(folder),
            here / "network.net.xml",
            road_users.routes(),
            signals,
            span_s,
            seed,
            Patience(layout.JUNCTION_NODE),
        )
    return _tracks(_traffic_info(frames, seed), movements, round(before_s / STEP_S))


def seen(traffic: Tracks, view: View, command: str) -> Tracks:
    """The tracks within the range of a laser of `view`, rounded to the resolution of the file."""
    tracks = replace(traffic, info=_info(traffic.info, view, command))
    near = np.zeros(len(tracks.frame), np.bool_)
    for name, laser in view.lasers.items():
        x, y, _ = tracks.sensor_poses(name)[tracks.frame].T
        distance = np.hypot(tracks.pose[:, 0] - x, tracks.pose[:, 1] - y)
        near |= distance < laser.range_max + tracks.size[:, 0] / 2.0
    return tracks.where(near).rounded()


def _info(traffic: TracksInfo, view: View, command: str) -> TracksInfo:
    recording = traffic.recording.model_dump() | {"grid": view.grid, "command": command}
    return TracksInfo(
        recording=RecordingInfo(**recording),
        lasers=dict(view.lasers),
        frames=traffic.frames,
        rate_hz=traffic.rate_hz,
        noise_seed=traffic.noise_seed,
        static=view.static,
        static_class=traffic.static_class,
        made_with=traffic.made_with,
        carrier=view.carrier,
    )


def _traffic_info(frames: int, seed: int) -> TracksInfo:
    return TracksInfo(
        recording=RecordingInfo(
            site=layout.JUNCTION_SITE,
            classes=layout.JUNCTION_CLASSES,
            rate_hz=layout.RATE_HZ,
            cycle_s=layout.CYCLE_S,
            licence=LICENCE,
            credit=CREDIT,
        ),
        lasers=dict(ONE_CORNER.lasers),
        frames=frames,
        rate_hz=layout.RATE_HZ,
        noise_seed=seed,
        static_class="static",
        made_with={"eclipse-sumo": sumo_version()},
    )


def _tracks(info: TracksInfo, movements: Movements, first_step: int) -> Tracks:
    """Smoothed tracks from SUMO's positions; each unbroken part is a track, in the order of the road users' names."""
    poses, users = np.empty((len(movements.user), 3)), np.empty(len(movements.user), np.int64)
    for number, rows in enumerate(unbroken_tracks(movements.user, movements.step)):
        kind = road_users.ROAD_USER_TYPES[movements.kind[movements.user[rows.start]]]
        users[rows] = number
        walks = kind.label == "pedestrian"
        poses[rows] = pedestrian_poses(movements, rows) if walks else vehicle_poses(movements, rows, kind)
    kinds = [road_users.ROAD_USER_TYPES[name] for name in movements.kind]
    frame = movements.step - first_step
    kept = (frame >= 0) & (frame < info.frames)
    order = np.lexsort((users[kept], frame[kept]))
    of_row = movements.user[kept][order]
    return Tracks(
        info=info,
        frame=frame[kept][order],
        track=users[kept][order],
        label=np.array([layout.JUNCTION_CLASSES.index(kind.label) for kind in kinds])[of_row],
        pose=poses[kept][order],
        size=np.array([(kind.length_m, kind.width_m) for kind in kinds])[of_row],
    )


def pedestrian_poses(movements: Movements, rows: slice) -> NDArray[np.float64]:
    """Poses (n, 3), smoothed because pedestrians of JuPedSim sway and turn on the spot."""
    position = smoothed(movements.position[rows], WALKING_STD_STEPS)
    return np.column_stack([position, headings(position, STEP_S, WALKING_STD_STEPS)])


def vehicle_poses(movements: Movements, rows: slice, kind: road_users.RoadUserType) -> NDArray[np.float64]:
    """Poses (n, 3) of the centre, from the front bumper; the rear follows because vehicles of SUMO turn on the spot."""
    front = smoothed(movements.position[rows], ROLLING_STD_STEPS)
    heading = trailing_headings(front, WHEELS_BEHIND * kind.length_m, float(movements.heading[rows.start]))
    ahead = np.column_stack([np.cos(heading), np.sin(heading)])
    return np.column_stack([front - kind.length_m / 2.0 * ahead, heading])
