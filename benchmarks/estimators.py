"""Time and memory of the two estimators of an object's motion: an update, thirty tracks and their forecast, one hour.

`python -m benchmarks.estimators` (four minutes). Aims: an update in 0.1 ms (Kalman filter) and 0.4 ms (factor graph) a
track; 30 tracks and their forecast within 25 ms at p95; an hour at 8 Hz without growth of memory or of time. Times are
processor time of one thread: other work on the machine affects the caches only. Their errors:
`studies/estimator_errors.py`.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np
import psutil

from gridtrack.trackers.model_free.motion.estimator import MotionEstimator, warm_up
from gridtrack.trackers.model_free.motion.factor_graph import FactorGraphEstimator
from gridtrack.trackers.model_free.motion.kalman import KalmanEstimator
from gridtrack.trackers.model_free.motion.model import propagate

from benchmarks.timing import p50_p95
from studies.support.measured_motion import FRAMES_PER_SECOND, MODEL, NOISE, Array, measured_poses

ESTIMATORS: dict[str, Callable[..., MotionEstimator]] = {
    "Kalman filter": KalmanEstimator,
    "factor graph": FactorGraphEstimator,
}
STEPS, TRACKS = 20, 30
"""Steps of a forecast; live tracks at a time."""


def print_times(frames: int) -> None:
    print("processor time, ms: median / p95")
    print(f"{'':16}{'one track':>18}{f'{TRACKS} tracks and their {STEPS}-step forecast':>46}")
    for label, kind in ESTIMATORS.items():
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
        print(f"{label:16}{p50_p95(each, 3):>18}{p50_p95(together, 3):>46}")


def circling(frames: int, tracks: int) -> Array:
    """Measured poses (frames, tracks, 3) of objects on a circle of 8 m at 4 m/s, 5 % of them grossly wrong."""
    angle = 0.5 * MODEL.period_s * np.arange(frames)
    truth = np.column_stack([8.0 * np.sin(angle), -8.0 * np.cos(angle), angle])
    rng = np.random.default_rng(0)
    return np.stack([measured_poses(truth, NOISE, 0.05, rng) for _ in range(tracks)], axis=1)


def print_hour(hours: float, tracks: int = 3) -> None:
    frames, quarter = round(3600 * FRAMES_PER_SECOND * hours), round(900 * FRAMES_PER_SECOND * hours)
    process = psutil.Process()
    poses = circling(frames, tracks)
    for label, kind in ESTIMATORS.items():
        print(f"{label}, {hours:g} h: {frames} frames, {tracks} tracks, every tenth second unseen; by the quarter")
        followed, start = [kind(pose, NOISE, MODEL) for pose in poses[0]], time.thread_time()
        for frame in range(1, frames):
            for track, pose in zip(followed, poses[frame], strict=True):
                track.predict()
                if frame // FRAMES_PER_SECOND % 10 != 9:
                    track.update(pose, NOISE)
            if (frame + 1) % quarter == 0:
                took_ms, start = 1e3 * (time.thread_time() - start), time.thread_time()
                memory_mb, restarts = process.memory_info().rss / 2**20, sum(track.restarts for track in followed)
                thousand_ms = 1e3 * took_ms / (quarter * tracks)
                print(f"{thousand_ms:9.1f} ms a thousand steps {memory_mb:9.1f} MiB {restarts:4} restarts", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--frames", type=int, default=300, help="to take the times of an update from")
    parser.add_argument("--hours", type=float, default=1.0, help="how long the long run is")
    arguments = parser.parse_args()
    for kind in ESTIMATORS.values():
        warm_up(kind, MODEL)
    print_times(arguments.frames)
    print_hour(arguments.hours)


if __name__ == "__main__":
    main()
