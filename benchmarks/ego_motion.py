"""Scan matching beside kiss-icp's own pipeline on the same scans: scans a second on one core.

`python -m benchmarks.ego_motion` (ten seconds). Aim: at least 100 scans/s. kiss-icp's command line reads three
dimensional clouds and saves results as well: its pipeline is called here, with the same range and voxels, without
deskewing and with one thread.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence

import numpy as np
from kiss_icp.config import KISSConfig
from kiss_icp.kiss_icp import KissICP

from gridtrack.common.geometry import SE2
from gridtrack.common.scan import Scan
from gridtrack.recordings import open_recording
from gridtrack.recordings.ego_motion import MatchingSettings, matched_trajectory
from gridtrack.recordings.ego_motion.returns import returns_of

from studies.support.shipped import DEMO


def scans_per_second(run: Callable[[], object], scans: int) -> float:
    """By processor time, so that other processes do not count."""
    begun = time.process_time()
    run()
    return scans / (time.process_time() - begun)


def kiss_icp_pipeline(scans: Sequence[Scan], settings: MatchingSettings) -> None:
    config = KISSConfig()
    config.data.max_range, config.data.deskew = settings.max_range_m, False
    config.mapping.voxel_size, config.registration.max_num_threads = settings.voxel_m, 1
    pipeline = KissICP(config)
    for scan in scans:
        points = returns_of(scan, settings.max_range_m, SE2(), 0.0).points
        pipeline.register_frame(np.column_stack([points, np.zeros(len(points))]), np.empty(0))


def main() -> None:
    argparse.ArgumentParser(description=__doc__.partition("\n")[0]).parse_args()
    scans, settings = list(open_recording(DEMO).scans()), MatchingSettings()
    ours = scans_per_second(lambda: matched_trajectory(scans, "kiss-icp", settings), len(scans))
    refined = scans_per_second(lambda: matched_trajectory(scans, "refined", settings), len(scans))
    theirs = scans_per_second(lambda: kiss_icp_pipeline(scans, settings), len(scans))
    print(f"{len(scans)} scans of the demo, scans/s of one core")
    print(f"  kiss-icp's pipeline {theirs:6.0f}")
    for name, rate in (("from scans alone", ours), ("refined", refined)):
        print(f"  {name:19} {rate:6.0f}, {theirs / rate:.1f} x the time of kiss-icp's pipeline")


if __name__ == "__main__":
    main()
