"""A small recording of a room without ground truth, and a tracker that fails half way, for whole runs."""

from __future__ import annotations

import io
import math
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from gridtrack.common.geometry import SE2
from gridtrack.common.scan import Scan
from gridtrack.evaluation.runs.summary import RunSummary, ScopeSummary, TrialSummary
from gridtrack.recordings import RecordingInfo, write_native
from gridtrack.recordings.formats import native

from scenes.read_once import write_shared

RATE_HZ, SECONDS, BEAMS = 10, 20, 120
STRETCHES: dict[str, Any] = {"train": (0.0, 4.0), "validation": (4.0, 9.0), "test": (9.0, None)}

STAGED = '''
import os, time
from typing import Literal
import numpy as np
from gridtrack.common.config import Settings
from gridtrack.trackers.contract import Forecast, Tracker


class Options(Settings):
    crash_at: int = 0
    crash_in: int = 2
    how: Literal["raises", "dies", "hangs"] = "raises"
    sleep_s: float = 0.0
    sleeps: Literal["always", "first"] = "always"
    starts: str = ""


class Staged(Tracker):
    """Forecasts the last frame; fails at the update `crash_at` of the stretch `crash_in`.

    Stretches are counted in one process; with a file `starts`, each earlier process counts as one: at an update that
    only test stretches have, the first process fails and the next one does not. Updates last `sleep_s`; where only the
    first stretch sleeps, the others are fast.
    """

    Options = Options
    device = "NVIDIA H100"

    def __init__(self, stream, options):
        super().__init__(stream, options)
        self.stretch = 0
        if options.starts:
            with open(options.starts, "ab") as file:
                self.stretch = file.tell()
                file.write(b".")

    def reset(self, seed):
        self.stretch, self.updates = self.stretch + 1, 0

    def update(self, frame):
        self.updates, self.last = self.updates + 1, frame.occupied
        if self.stretch == self.options.crash_in and self.updates == self.options.crash_at:
            if self.options.how == "dies":
                os.abort()
            if self.options.how == "hangs":
                time.sleep(3600)
            raise RuntimeError("staged")
        if self.options.sleeps == "always" or self.stretch == 1:
            time.sleep(self.options.sleep_s)

    def predict(self, steps):
        return Forecast(np.repeat(self.last[None].astype(np.float32), steps + 1, axis=0))
'''


def write_room(
    path: Path,
    seconds: int = SECONDS,
    stretches: dict[str, Any] | None = None,
    speed: float = 0.0,
    wall_m: float = 3.0,
    site: str = "room",
    grid: str = "40x0.2@-1,-4",
    rate_hz: int = RATE_HZ,
    shift_ns: int = 0,
) -> Path:
    """Write the recording, with a sensor that moves at `speed` m/s towards the wall; returns `path`.

    `rate_hz` is its recorded rate; its scans come at RATE_HZ, from a stamp that `shift_ns` is added to.
    """
    info = RecordingInfo(site=site, grid=grid, rate_hz=rate_hz, stretches=STRETCHES if stretches is None else stretches)
    return write_shared(path, _room(info.model_dump_json(), seconds, speed, wall_m, shift_ns, native.CHUNK_BYTES))


@cache
def _room(info: str, seconds: int, speed: float, wall_m: float, shift_ns: int, chunk_bytes: int) -> bytes:
    """The content of the recording, with its metadata as JSON; tests change the `chunk_bytes` of the format."""
    content = io.BytesIO()
    scans = (scan(index, speed, wall_m, shift_ns) for index in range(seconds * RATE_HZ))
    write_native(content, RecordingInfo.model_validate_json(info), scans)
    return content.getvalue()


def scan(index: int, speed: float, wall_m: float, shift_ns: int) -> Scan:
    """A wall ahead, and something 0.3 m wide that walks to and fro before it."""
    angles = np.linspace(-math.pi / 3, math.pi / 3, BEAMS)
    ranges = wall_m / np.cos(angles)
    towards = 0.8 * math.sin(index / 12)
    ranges[np.abs(angles - towards) < 0.08] = 1.6
    return Scan(
        stamp_ns=1_000_000_000_000 + index * 1_000_000_000 // RATE_HZ + shift_ns,
        ranges=ranges.astype(np.float32),
        angle_min=float(angles[0]),
        angle_increment=float(angles[1] - angles[0]),
        range_min=0.05,
        range_max=8.0,
        world_T_sensor=SE2(speed * index / RATE_HZ, 0.0, 0.0),
    )


def trial_of(summary: RunSummary, label: str, recording: str = "room") -> TrialSummary:
    """The result of a trial."""
    return summary.trackers[label].recordings[recording]


def curve(scope: ScopeSummary, stratum: str, output: str) -> tuple[float | None, ...] | None:
    """The values of SCORE.OUTPUT in a stratum, by step; None if there are none."""
    found = scope.estimate(stratum, *output.split("."))
    return None if found is None else found.value
