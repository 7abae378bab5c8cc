"""Time and memory of both estimators of an object's motion: an update, thirty tracks and their forecast, one hour.

`python -m benchmarks.estimators [--out FILE]` (four minutes). Aims: an update in 0.1 ms (Kalman filter) and 0.4 ms
(factor graph) a track; 30 tracks and their forecast within 25 ms at p95; an hour at 8 Hz without growth of memory or of
time. Times are processor time of one thread, so other work on the machine affects the caches only. Their errors:
`studies/estimator_errors.py`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np
import psutil

from gridtrack.trackers.model_free.estimators import MotionEstimator, warm_up
from gridtrack.trackers.model_free.factor_graph import FactorGraphEstimator
from gridtrack.trackers.model_free.kalman import KalmanEstimator
from gridtrack.trackers.model_free.motion import propagate

from benchmarks.timing import p50_p95
from studies.estimator_errors import FRAMES_PER_SECOND, MODEL, NOISE, Array, measured_poses
from studies.support.results_file import measured_table, study_parser, write_table

ESTIMATORS: dict[str, Callable[..., MotionEstimator]] = {
    "Kalman filter": KalmanEstimator,
    "factor graph": FactorGraphEstimator,
}
STEPS, TRACKS = 20, 30
"""Steps of a forecast; simultaneous tracks."""
COLUMNS = (
    "ms, median / p95",
    "predict and update, one track",
    "times Kalman",
    f"{TRACKS} tracks and their {STEPS}-step forecast",
    "times Kalman, all",
)


def times_of(kind: Callable[..., MotionEstimator], frames: int) -> tuple[list[float], list[float]]:
    """Milliseconds of each prediction and update of a track, and of all tracks of a frame with their forecast."""
    poses = circling(frames, TRACKS)
    tracks = [kind(pose, NOISE, MODEL) for pose in poses[0]]
    each, together = [], []
    for measured in poses[1:]:
        begin = time.thread_time()
        for track, pose in zip(tracks, measured, strict=True):
            start = time.thread_time()
            track.predict()
            track.update(pose, NOISE)
            each.append(1e3 * (time.thread_time() - start))
        propagate(np.stack([t.mean for t in tracks]), np.stack([t.covariance for t in tracks]), STEPS, MODEL)
        together.append(1e3 * (time.thread_time() - begin))
    return each, together


def time_rows(frames: int) -> list[list[str]]:
    """A row of COLUMNS for each estimator; ratios are to the first one."""
    rows: list[list[str]] = []
    first: list[float] = []
    for label, kind in ESTIMATORS.items():
        found = times_of(kind, frames)
        medians = [float(np.median(times)) for times in found]
        first = first or medians
        texts = [p50_p95(times, digits) for times, digits in zip(found, (3, 1), strict=True)]
        ratios = [f"{own / other:.1f}" for own, other in zip(medians, first, strict=True)]
        rows.append([label, texts[0], ratios[0], texts[1], ratios[1]])
        print(" | ".join(rows[-1]), flush=True)
    return rows


def circling(frames: int, tracks: int) -> Array:
    """Measured poses (frames, tracks, 3) of objects on a circle of 8 m at 4 m/s, 5 % of them grossly wrong."""
    angle = 0.5 * MODEL.period_s * np.arange(frames)
    truth = np.column_stack([8.0 * np.sin(angle), -8.0 * np.cos(angle), angle])
    rng = np.random.default_rng(0)
    return np.stack([measured_poses(truth, NOISE, 0.05, rng) for _ in range(tracks)], axis=1)


def hour_values(hours: float, tracks: int = 3) -> dict[str, str]:
    """Growth of memory and time per step over the hours, the last quarter against the first, for each estimator."""
    frames, quarter = round(3600 * FRAMES_PER_SECOND * hours), round(900 * FRAMES_PER_SECOND * hours)
    process = psutil.Process()
    poses = circling(frames, tracks)
    values = {}
    for label, kind in ESTIMATORS.items():
        print(f"{label}, {hours:g} h: {frames} frames, {tracks} tracks, every tenth second unseen; by the quarter")
        followed, start = [kind(pose, NOISE, MODEL) for pose in poses[0]], time.thread_time()
        memories_mib, times_ms = [], []
        for frame in range(1, frames):
            for track, pose in zip(followed, poses[frame], strict=True):
                track.predict()
                if frame // FRAMES_PER_SECOND % 10 != 9:
                    track.update(pose, NOISE)
            if (frame + 1) % quarter == 0:
                times_ms.append(1e3 * (time.thread_time() - start))
                start = time.thread_time()
                memories_mib.append(process.memory_info().rss / 2**20)
                thousand_ms = 1e3 * times_ms[-1] / (quarter * tracks)
                print(f"{thousand_ms:9.1f} ms per thousand steps {memories_mib[-1]:9.1f} MiB", flush=True)
        values[f"{label}: memory gained, MiB"] = f"{memories_mib[-1] - memories_mib[0]:.1f}"
        values[f"{label}: time, last quarter over first"] = f"{times_ms[-1] / times_ms[0]:.2f}"
        values[f"{label}: restarts"] = str(sum(track.restarts for track in followed))
    return values


def main(arguments: Sequence[str] | None = None) -> None:
    parser = study_parser(__doc__, "docs/results/trackers/estimators.json")
    parser.add_argument("--frames", type=int, default=300, help="of the times of an update")
    parser.add_argument("--hours", type=float, default=1.0, help="duration of the long run")
    given = parser.parse_args(arguments)
    for kind in ESTIMATORS.values():
        warm_up(kind, MODEL)
    print("processor time, ms: median / p95")
    table = measured_table(COLUMNS, time_rows(given.frames))
    write_table(given.out, "time and memory", table, "python -m benchmarks.estimators", hour_values(given.hours))


if __name__ == "__main__":
    main()
