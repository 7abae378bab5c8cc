"""Errors of recorded odometry against reference relative poses, beside those of the simulated wheel odometry.

`python -m studies.odometry_errors LOG RELATIONS`: a CARMEN log and its relations as in Kuemmerle et al., "On measuring
the accuracy of SLAM algorithms" (Autonomous Robots 27, 2009): lines of two stamps and x y z roll pitch yaw. The
defaults of `WheelOdometry` are chosen by this table for the log of the ACES building (Radish), whose reference is tied
to odometry in steps of 5 cm and says nothing of smaller errors of position.
"""

from __future__ import annotations

import argparse
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.geometry import SE2, wrap_angle
from gridtrack.recordings import open_recording
from gridtrack.simulation.motion import WheelOdometry

LONGEST_S = 2.0
TURNS_RAD = (0.0, 0.02, 0.04, 0.08, 0.16, 0.32, 0.64)
MIN_DISTANCE_M = 0.1
SEEDS = 20


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("log", type=Path)
    parser.add_argument("relations", type=Path)
    arguments = parser.parse_args()
    scans = list(open_recording(arguments.log).scans())
    poses = np.array([(s.world_T_sensor.x, s.world_T_sensor.y, s.world_T_sensor.theta) for s in scans])
    number = {round(scan.stamp_ns / 1e3): i for i, scan in enumerate(scans)}
    pairs, true = [], []
    for first_s, last_s, *relation in np.loadtxt(arguments.relations).tolist():
        first, last = number.get(round(first_s * 1e6)), number.get(round(last_s * 1e6))
        if first is not None and last is not None and last_s - first_s <= LONGEST_S:
            pairs.append((first, last))
            true.append(SE2(relation[0], relation[1], relation[5]))
    spans = [poses[first : last + 1] for first, last in pairs]
    distance = np.array([np.hypot(*np.diff(span[:, :2], axis=0).T).sum() for span in spans])
    turn = np.array([np.abs(wrap_angle(np.diff(span[:, 2]))).sum() for span in spans])
    recorded = np.array(
        [wrap_angle(moved(poses, *pair).theta - pose.theta) for pair, pose in zip(pairs, true, strict=True)]
    )
    simulated = np.array([heading_errors(poses, pairs, seed) for seed in range(SEEDS)])
    print(f"{len(pairs)} pairs up to {LONGEST_S:g} s apart; heading errors in degrees")
    print("turn (rad)      pairs  distance (m)  recorded: std  95 %   simulated: std  95 %")
    for low, high in [*pairwise(TURNS_RAD), (0.0, np.inf)]:
        chosen = (turn >= low) & (turn < high) & ((distance > MIN_DISTANCE_M) | (high == np.inf))
        print(
            f"{low:4.2f} to {high:4.2f}  {chosen.sum():7d}  {distance[chosen].mean():12.2f}"
            f"  {spread(recorded[chosen])}  {spread(simulated[:, chosen]):>20}"
        )


def moved(poses: NDArray[np.float64], first: int, last: int) -> SE2:
    """The pose `first_T_last`."""
    return SE2(*poses[first]).inverse() @ SE2(*poses[last])


def heading_errors(poses: NDArray[np.float64], pairs: list[tuple[int, int]], seed: int) -> NDArray[np.float64]:
    """The errors that simulated wheel odometry would have had on the recorded path, radians."""
    found = WheelOdometry(seed=seed).recorded(poses)
    return np.array([wrap_angle(moved(found, *pair).theta - moved(poses, *pair).theta) for pair in pairs])


def spread(errors: NDArray[np.float64]) -> str:
    """Standard deviation and 95th percentile of the absolute value, degrees."""
    degrees = np.degrees(errors)
    return f"{degrees.std():13.2f}  {np.percentile(np.abs(degrees), 95.0):4.2f}"


if __name__ == "__main__":
    main()
