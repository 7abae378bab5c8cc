"""Ego-motion on logs of robots: settings chosen on one half of a log and reported on the other; sharpness of maps.

`python -m studies.ego_motion relations LOG RELATIONS [--out FILE]` and `python -m studies.ego_motion maps RECORDING...`
take some minutes each.

`relations` needs reference poses of pairs of scans, a line `t1 t2 x y z roll pitch yaw` each, as in Kümmerle et al.,
"On measuring the accuracy of SLAM algorithms", Autonomous Robots 2009; docs/results has the log aces. `maps` needs no
truth. It measures the median distance of returns, across the walls, from the map of the earlier scans at the poses of
each source, and the cells of 5 cm that a minute of returns covers: thin walls in the map give fewer cells. RECORDING
may be an .npz (studies/support/real_recordings.py).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import islice, product
from pathlib import Path

import numpy as np
from kiss_icp.mapping import VoxelHashMap
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gridtrack.common.geometry import SE2, wrap_angle
from gridtrack.common.scan import Scan
from gridtrack.recordings import open_recording
from gridtrack.recordings.ego_motion import MatchingSettings, matched_trajectory
from gridtrack.recordings.ego_motion.fit import Fit, fit_at, walls_of
from gridtrack.recordings.ego_motion.matching import POINTS_PER_VOXEL
from gridtrack.recordings.ego_motion.returns import homogeneous, measured_points, returns_of
from gridtrack.recordings.read_options import PoseSource

from studies.support.real_recordings import npz_scans
from studies.support.results_file import ResultSection, measured_table, study_parser, write_section

MAX_APART_S = 2.0
NEAREST_S = 0.01
AIMS = (0.035, 0.10, 1.0)
"""Median and 95th percentile of the position's error, metres, and 95th percentile of the heading's, degrees."""
KERNELS_M, VOXELS_M = (0.1, 0.2), (0.3, 0.5)
MAP_SCANS, MAP_S, MAP_CELL_M = 600, 60.0, 0.05
COLUMNS = ("pairs", "median, m", "95 %, m", "heading 95 %, deg")
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Pairs:
    """Pairs of scans: indices (P, 2), seconds (P,) of the first scan, and the true relative poses."""

    indices: NDArray[np.int64]
    seconds: Array
    relative: list[SE2]


def pairs_of(path: Path, scans: Sequence[Scan]) -> Pairs:
    """The pairs at most MAX_APART_S apart, if both scans are in the log."""
    rows = np.loadtxt(path)
    rows = rows[rows[:, 1] - rows[:, 0] <= MAX_APART_S]
    stamps = np.array([scan.stamp_ns for scan in scans]) / 1e9
    nearest = np.abs(stamps[:, None] - rows[:, :2].reshape(1, -1)).argmin(axis=0).reshape(-1, 2)
    known = (np.abs(stamps[nearest] - rows[:, :2]) < NEAREST_S).all(axis=1)
    rows, nearest = rows[known], nearest[known]
    return Pairs(nearest, stamps[nearest[:, 0]] - stamps[0], [SE2(row[2], row[3], row[7]) for row in rows])


def errors(poses: Sequence[SE2], pairs: Pairs) -> Array:
    """Errors (P, 2) of position, metres, and heading, degrees."""
    found = []
    for (first, second), true in zip(pairs.indices, pairs.relative, strict=True):
        off = true.inverse() @ (poses[first].inverse() @ poses[second])
        found.append((math.hypot(off.x, off.y), abs(math.degrees(wrap_angle(off.theta)))))
    return np.array(found)


def figures(found: Array) -> tuple[float, float, float]:
    return (
        float(np.median(found[:, 0])),
        float(np.percentile(found[:, 0], 95)),
        float(np.percentile(found[:, 1], 95)),
    )


def worst(found: Array) -> float:
    """The largest ratio of a figure to its aim: settings are chosen by it."""
    return max(value / aim for value, aim in zip(figures(found), AIMS, strict=True))


def cross_fitted(candidates: dict[str, Array], halves: Sequence[NDArray[np.bool_]]) -> tuple[list[str], Array]:
    """The candidate chosen for each half on the other half, and the errors of every pair with it."""
    chosen = [min(candidates, key=lambda name: worst(candidates[name][~half])) for half in halves]
    together = np.empty_like(next(iter(candidates.values())))
    for half, name in zip(halves, chosen, strict=True):
        together[half] = candidates[name][half]
    return chosen, together


def relations(log: Path, path: Path, out: Path | None) -> None:
    scans = list(open_recording(log).scans())
    pairs = pairs_of(path, scans)
    first = pairs.seconds < (scans[-1].stamp_ns - scans[0].stamp_ns) / 2e9
    halves = {"first half": first, "second half": ~first}
    odometry = errors([scan.world_T_sensor for scan in scans], pairs)
    candidates = {}
    for kernel_m, voxel_m in product(KERNELS_M, VOXELS_M):
        settings = MatchingSettings(kernel_m=kernel_m, voxel_m=voxel_m)
        name = f"kernel {kernel_m:g} m, voxels {voxel_m:g} m"
        candidates[name] = errors(matched_trajectory(scans, "refined", settings).matched, pairs)
        print(name, figures(candidates[name]), flush=True)
    chosen, refined = cross_fitted(candidates, list(halves.values()))
    alone = errors(matched_trajectory(scans, "kiss-icp", MatchingSettings()).matched, pairs)
    ways = {"odometry": odometry, "refined": refined, "kiss-icp": alone}
    rows = [
        [f"{way}, {name}", str(half.sum()), *(f"{value:.3f}" for value in figures(found[half]))]
        for name, half in {**halves, "all": first | ~first}.items()
        for way, found in ways.items()
    ]
    searched = [
        [name, *(f"{worst(found[half]):.2f}" for half in halves.values())] for name, found in candidates.items()
    ]
    values = {f"chosen for the {half}": name for half, name in zip(halves, chosen, strict=True)}
    tables = {
        "errors": measured_table(("poses", *COLUMNS), rows),
        "search": measured_table(("settings", *halves), searched),
    }
    finish(out, "aces", ResultSection(command="python -m studies.ego_motion relations", tables=tables, values=values))


def scans_of(path: Path, most: int) -> list[Scan]:
    """The first `most` scans of a recording or an .npz."""
    scans = npz_scans(path) if path.suffix == ".npz" else open_recording(path).scans()
    return list(islice(scans, most))


def covered_cells(scans: Sequence[Scan], poses: Sequence[SE2], max_range_m: float) -> float:
    """Cells of MAP_CELL_M per hundred returns in MAP_S seconds, mean over the recording."""
    start_ns, parts = scans[0].stamp_ns, dict[int, list[Array]]()
    for scan, pose in zip(scans, poses, strict=True):
        points = pose.apply(measured_points(scan, max_range_m)[0])
        parts.setdefault(round((scan.stamp_ns - start_ns) / 1e9 // MAP_S), []).append(points)
    shares = []
    for part in parts.values():
        cells = np.floor(np.concatenate(part) / MAP_CELL_M).astype(np.int64)
        if len(cells):
            shares.append(100.0 * len(np.unique(cells, axis=0)) / len(cells))
    return float(np.mean(shares))


def fits(scans: Sequence[Scan], poses: Sequence[SE2], settings: MatchingSettings) -> list[Fit]:
    """The fit of each scan but the first, at its pose, to a local map of the earlier scans at their poses."""
    local_map, found = VoxelHashMap(settings.voxel_m, settings.max_range_m, POINTS_PER_VOXEL), []
    for number, (scan, pose) in enumerate(zip(scans, poses, strict=True)):
        motion, motion_s = SE2(), 0.0
        if number:
            motion = poses[number - 1].inverse() @ pose
            motion_s = (scan.stamp_ns - scans[number - 1].stamp_ns) / 1e9
        returns = returns_of(scan, settings.max_range_m, motion, motion_s)
        if number and len(returns.points):
            found.append(fit_at(pose, walls_of(returns), cKDTree(local_map.point_cloud()[:, :2]), settings.kernel_m))
        local_map.update(np.column_stack([returns.points, np.zeros(len(returns.points))]), homogeneous(pose))
    return found


def maps(recordings: Iterable[Path], most: int, out: Path | None) -> None:
    rows, settings = [], MatchingSettings()
    sources: tuple[PoseSource, ...] = ("refined", "kiss-icp")
    for path in recordings:
        scans, name = scans_of(path, most), path.name.split(".")[0]
        trajectories = {source: matched_trajectory(scans, source, settings) for source in sources}
        poses = {"recorded": [scan.world_T_sensor for scan in scans]} | {k: v.matched for k, v in trajectories.items()}
        for source, found in poses.items():
            on_map = fits(scans, found, settings)
            residual = float(np.median([fit.residual_m for fit in on_map]))
            fell_back = [q.fell_back for q in trajectories[source].qualities] if source in trajectories else []
            rows.append(
                [
                    f"{name}, {source}",
                    str(len(scans)),
                    f"{1000 * residual:.0f}",
                    f"{covered_cells(scans, found, settings.max_range_m):.2f}",
                    f"{100 * np.mean(fell_back):.1f}" if fell_back else "",
                ]
            )
            print(*rows[-1], flush=True)
    columns = ("poses", "scans", "median residual, mm", "cells per 100 returns", "fell back, %")
    tables = {"table": measured_table(columns, rows)}
    finish(out, "maps", ResultSection(command="python -m studies.ego_motion maps", tables=tables))


def finish(out: Path | None, name: str, section: ResultSection) -> None:
    print(section.text())
    write_section(out, name, section)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = study_parser(__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    one = commands.add_parser("relations")
    one.add_argument("log", type=Path)
    one.add_argument("relations", type=Path)
    many = commands.add_parser("maps")
    many.add_argument("recordings", type=Path, nargs="+")
    many.add_argument("--scans", type=int, default=MAP_SCANS, help="number of scans, from the first of each recording")
    for command in (one, many):
        command.add_argument("--out", type=Path, help="docs/results/moving/ego_motion.json")
    given = parser.parse_args(arguments)
    if given.command == "relations":
        relations(given.log, given.relations, given.out)
    else:
        maps(given.recordings, given.scans, given.out)


if __name__ == "__main__":
    main()
