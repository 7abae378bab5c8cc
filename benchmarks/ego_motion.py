"""Scan matching beside kiss-icp's own command line on the same scans: scans a second on one core.

`python -m benchmarks.ego_motion [RECORDING...] [--out FILE]` (a minute). Aim: at least 100 scans/s. kiss-icp's command
line reads the returns of each scan as a cloud with z = 0, with the same range and voxels, one thread and no deskewing;
it writes its own rate, without reading. All take turns, and the best of several rounds counts, by the clock: the
machine should be idle.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np

from gridtrack.common.scan import Scan
from gridtrack.recordings import open_recording
from gridtrack.recordings.ego_motion import MatchingSettings, matched_trajectory
from gridtrack.recordings.ego_motion.returns import measured_points
from gridtrack.recordings.read_options import PoseSource

from studies.support.results_file import ResultSection, measured_table, study_parser, write_section
from studies.support.shipped import DATA, DEMO

RECORDINGS = (DEMO, DATA / "drives" / "car-202.tracks", DATA / "drives" / "robot-203.tracks")
AIM_HZ = 100.0
PEER = "kiss-icp's command line"
ROUNDS = 3


def rates_hz(scans: Sequence[Scan], settings: MatchingSettings) -> dict[str, float]:
    """Scans per second of PEER and of each way to match, the best of ROUNDS."""
    with tempfile.TemporaryDirectory() as folder:
        clouds = Path(folder, "clouds")
        write_clouds(scans, settings, clouds)
        runs: Mapping[str, Callable[[], float]] = {
            PEER: partial(rate_of_peer, clouds, settings),
            "from scans alone": partial(rate_of_ours, "kiss-icp", scans, settings),
            "refined": partial(rate_of_ours, "refined", scans, settings),
        }
        rounds = [{name: rate() for name, rate in runs.items()} for _ in range(ROUNDS)]
    return {name: max(found[name] for found in rounds) for name in runs}


def write_clouds(scans: Sequence[Scan], settings: MatchingSettings, folder: Path) -> None:
    """Write the returns of each scan as a cloud of KITTI: (N, 4) float32 of x, y, z and intensity."""
    folder.mkdir()
    for number, scan in enumerate(scans):
        points, _ = measured_points(scan, settings.max_range_m)
        cloud = np.column_stack([points, np.zeros((len(points), 2))])
        cloud.astype("<f4").tofile(folder / f"{number:06d}.bin")


def rate_of_peer(clouds: Path, settings: MatchingSettings) -> float:
    """The mean rate that kiss-icp writes beside its poses, scans/s."""
    program, out = Path(sys.executable).with_name("kiss_icp_pipeline"), clouds.with_name("poses")
    given = {
        "data": {"max_range": settings.max_range_m, "deskew": False},
        "mapping": {"voxel_size": settings.voxel_m},
        "registration": {"max_num_threads": 1},
        "out_dir": str(out),
    }
    environment = {f"kiss_icp_{name}": one if isinstance(one, str) else json.dumps(one) for name, one in given.items()}
    subprocess.run([program, clouds], env=os.environ | environment, check=True, capture_output=True)
    found = re.search(r"Average Frequency.*?([\d.]+)", (out / "latest" / "result_metrics.log").read_text("utf-8"))
    if found is None:
        raise SystemExit("the command line of kiss-icp wrote no rate")
    return float(found[1])


def rate_of_ours(source: PoseSource, scans: Sequence[Scan], settings: MatchingSettings) -> float:
    """Scans per second of matching with poses of `source`: kiss-icp (from the scans alone) or refined."""
    begun = time.perf_counter()
    matched_trajectory(scans, source, settings)
    return len(scans) / (time.perf_counter() - begun)


def measured(recordings: Sequence[Path], most: int | None) -> ResultSection:
    """A row for each recording, of its first `most` scans, and way to match."""
    settings, rows, least = MatchingSettings(), [], float("inf")
    for path in recordings:
        scans = list(islice(open_recording(path).scans(), most))
        found = rates_hz(scans, settings)
        beams = max(len(scan.ranges) for scan in scans)
        for name, rate in found.items():
            times = f"{found[PEER] / rate:.1f}"
            rows.append((f"{path.stem}, {name}", str(len(scans)), str(beams), f"{rate:.0f}", times))
        least = min(least, *(rate for name, rate in found.items() if name != PEER))
    columns = ("recording, poses", "scans", "beams", "scans/s", "x time of its command line")
    values = {"least, scans/s": f"{least:.0f}", "aim": "met" if least >= AIM_HZ else "not met"}
    return ResultSection(
        command="python -m benchmarks.ego_motion", tables={"rates": measured_table(columns, rows)}, values=values
    )


def main(arguments: Sequence[str] | None = None) -> None:
    parser = study_parser(__doc__, "docs/results/moving/cost.json")
    parser.add_argument("recordings", nargs="*", type=Path, default=RECORDINGS, help="default: three that ship")
    parser.add_argument("--scans", type=int, help="number of first scans of each recording; default: all")
    given = parser.parse_args(arguments)
    section = measured(given.recordings, given.scans)
    print(section.text())
    write_section(given.out, "ego-motion", section)


if __name__ == "__main__":
    main()
