"""Would you know which recording is simulated and which is real? A sheet of frames side by side.

`python -m studies.worlds_look RECORDING... [--frames 2] [--blind] [--out runs/worlds-look.svg]` (seconds). Each panel
is a scan in its sensor's frame, x upwards: its returns dark, those of the second before it in orange, at the places of
the world where they were measured. With `--blind` the panels are mixed, and the key is in the file's last lines.
"""

from __future__ import annotations

import argparse
import math
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.errors import GridtrackError
from gridtrack.common.geometry import SE2
from gridtrack.common.scan import Scan
from gridtrack.recordings import open_recording
from gridtrack.reports.figures import document

from studies.support.npz_scans import npz_scans
from studies.support.svg import svg_path

BEFORE_NS = 1_000_000_000
PANEL_PX, COLUMNS = 230, 6
MAX_REACH_M = 9.0
LOOKED_AT_S = 60.0
"""Panels are taken from the first minute of a recording."""


@dataclass(frozen=True)
class Panel:
    """Returns (N, 2), metres, sensor frame, now and in the second before."""

    source: str
    now: NDArray[np.float64]
    before: NDArray[np.float64]


def returns_of(scan: Scan) -> NDArray[np.float64]:
    """The returns (N, 2) of a scan, metres, sensor frame."""
    angles = scan.angle_min + scan.angle_increment * np.arange(scan.ranges.size)
    seen = np.isfinite(scan.ranges) & (scan.ranges > scan.range_min) & (scan.ranges < scan.range_max)
    ranges = scan.ranges[seen].astype(np.float64)
    return np.column_stack([ranges * np.cos(angles[seen]), ranges * np.sin(angles[seen])])


def panels(path: Path, frames: int) -> Iterator[Panel]:
    """`frames` panels of a recording, evenly spread over its first minute."""
    scans = npz_scans(path) if path.suffix == ".npz" else open_recording(path).scans()
    recent: deque[Scan] = deque()
    wanted = [(k + 0.5) * LOOKED_AT_S / frames for k in range(frames)]
    first = sensor = None
    for scan in scans:
        first, sensor = (scan.stamp_ns, scan.sensor) if first is None else (first, sensor)
        if scan.sensor != sensor:
            continue
        recent.append(scan)
        while recent[0].stamp_ns < scan.stamp_ns - BEFORE_NS:
            recent.popleft()
        if wanted and scan.stamp_ns - first >= wanted[0] * 1e9:
            wanted.pop(0)
            yield _panel(path.stem, list(recent))
        if not wanted:
            return


def _panel(source: str, scans: Sequence[Scan]) -> Panel:
    now = scans[-1]
    here = _pose(now).inverse()
    before = [(here @ _pose(scan)).apply(returns_of(scan)) for scan in scans[:-1]]
    return Panel(source, returns_of(now), np.concatenate(before) if before else np.empty((0, 2)))


def _pose(scan: Scan) -> SE2:
    return scan.reference_T_sensor or scan.world_T_sensor


def drawing(shown: Sequence[Panel], named: bool) -> str:
    """The sheet, with the names of the recordings or with numbers."""
    parts = []
    for k, panel in enumerate(shown):
        left, top = (k % COLUMNS) * PANEL_PX, (k // COLUMNS) * (PANEL_PX + 16)
        distance = np.hypot(*panel.now.T)
        reach_m = float(min(np.quantile(distance, 0.95) * 1.1, MAX_REACH_M)) if distance.size else MAX_REACH_M
        parts.append(
            f'<rect x="{left + 2}" y="{top + 14}" width="{PANEL_PX - 4}" height="{PANEL_PX - 4}" fill="#f4f4f2"/>'
        )
        parts.append(
            f'<text x="{left + 4}" y="{top + 11}">{panel.source if named else k + 1}, {2.0 * reach_m:.1f} m</text>'
        )
        for points, colour, radius in ((panel.before, "#e69f00", 0.7), (panel.now, "#10243c", 1.1)):
            inside = points[np.abs(points).max(axis=1, initial=0.0) < reach_m]
            scale = (PANEL_PX - 4) / (2.0 * reach_m)
            middle_x, middle_y = left + PANEL_PX / 2.0, top + 12 + PANEL_PX / 2.0
            drawn = ((middle_x - y * scale, middle_y - x * scale) for x, y in inside.tolist())
            parts += [f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius}" fill="{colour}"/>' for x, y in drawn]
        parts.append(f'<circle cx="{left + PANEL_PX / 2.0}" cy="{top + 12 + PANEL_PX / 2.0}" r="2.5" fill="#d00"/>')
    height = math.ceil(len(shown) / COLUMNS) * (PANEL_PX + 16)
    return document(COLUMNS * PANEL_PX, height, parts, 10)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("recordings", type=Path, nargs="+")
    parser.add_argument("--frames", type=int, default=2, help="panels of each recording")
    parser.add_argument("--blind", action="store_true", help="mix the panels and number them")
    parser.add_argument("--out", type=svg_path, default=Path("runs/worlds-look.svg"))
    options = parser.parse_args()
    try:
        shown = [panel for path in options.recordings for panel in panels(path, options.frames)]
    except GridtrackError as error:
        raise SystemExit(str(error)) from None
    if options.blind:
        np.random.default_rng().shuffle(shown)
    key = "".join(f"<!-- {k + 1}: {panel.source} -->\n" for k, panel in enumerate(shown))
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(drawing(shown, not options.blind) + key)


if __name__ == "__main__":
    main()
