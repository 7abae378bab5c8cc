"""Scans of an outdoor laser that are kept as arrays: t (s), r (m) over 180 degrees, and pose (x, y, heading)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from gridtrack.common.geometry import SE2
from gridtrack.common.scan import Scan

RANGE_MAX_M = 81.0


def npz_scans(path: Path) -> Iterator[Scan]:
    """The scans of an .npz file."""
    with np.load(path) as arrays:
        for t, r, pose in zip(*(arrays[name] for name in ("t", "r", "pose")), strict=True):
            ranges, step = np.asarray(r, np.float32), math.pi / (len(r) - 1)
            yield Scan(round(t * 1e9), ranges, -math.pi / 2, step, 0.1, RANGE_MAX_M, world_T_sensor=SE2(*pose.tolist()))
