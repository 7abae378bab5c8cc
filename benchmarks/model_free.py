"""Speed of the model-free pipeline: one update and one 25-step forecast, by the number of people in the room.

Run it by itself: `python benchmarks/model_free.py`. Aim: 5 ms each at six tracks, on one thread.
"""

from __future__ import annotations

import time

import numpy as np

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec
from gridtrack.trackers.model_free.dwell import table_shape
from gridtrack.trackers.model_free.pipeline import Pipeline
from gridtrack.trackers.model_free.settings import PipelineSettings

GRID = GridSpec(100, 0.1)
PERIOD_S = 0.1
STEPS = 25
FRAMES = 200


def frame_of(feet: np.ndarray) -> GridFrame:
    """All visible; the cells of the feet (N, 2), metres, and their right neighbours occupied."""
    occupied = np.zeros(GRID.shape, bool)
    cells, inside = GRID.cells_of(feet)
    occupied[tuple(cells[inside].T)] = True
    occupied[:, 1:] |= occupied[:, :-1].copy()
    points = GRID.cell_centres(occupied)
    sensor = np.zeros((1, 2), np.float32)
    return GridFrame(0, np.ones(GRID.shape, bool), occupied, SE2(), sensor, points, np.zeros(len(points), np.uint8))


def people(count: int, step: int) -> np.ndarray:
    """Two feet (2 * count, 2) of each of `count` people who walk in circles round places of their own."""
    home = np.array([(-3.0 + 3.0 * (n % 3), -2.0 + 3.5 * (n // 3)) for n in range(count)])
    phase = 0.08 * step + np.arange(count)
    body = home + np.stack([np.cos(phase), np.sin(phase)], 1)
    stride = 0.25 * np.stack([-np.sin(phase), np.cos(phase)], 1) * np.sin(0.6 * step)
    return np.concatenate([body + stride, body - stride])


def measure(count: int) -> tuple[int, list[float], list[float]]:
    """Tracks at the end, and the seconds of each update and each forecast."""
    background = np.full(GRID.shape, 1e-3, np.float32)
    dwell = np.full(table_shape(PERIOD_S), 0.3, np.float32)
    pipeline = Pipeline(GRID, PERIOD_S, background, dwell, PipelineSettings())
    updates, forecasts = [], []
    for step in range(FRAMES):
        frame = frame_of(people(count, step))
        start = time.perf_counter()
        pipeline.update(frame)
        updated = time.perf_counter()
        pipeline.forecast(STEPS)
        if step >= 20:  # compiled, and the tracks confirmed
            updates.append(updated - start)
            forecasts.append(time.perf_counter() - updated)
    return len(pipeline.tracks), updates, forecasts


def main() -> None:
    print(f"{'people':>6} {'tracks':>6}   update p50 / p95 ms   {STEPS}-step forecast p50 / p95 ms")
    for count in (1, 3, 6):
        tracks, *timings = measure(count)
        (u50, u95), (f50, f95) = (np.percentile(np.array(seconds) * 1e3, [50, 95]) for seconds in timings)
        print(f"{count:>6} {tracks:>6}   {u50:10.2f} / {u95:.2f}   {f50:22.2f} / {f95:.2f}")


if __name__ == "__main__":
    main()
