"""Speed of scoring one forecast: 21 steps of 100 x 100 cells, every stratum, histogram and losses, and its rows.

Run it by itself: `python benchmarks/scoring.py`. Aim: 2 ms to count a forecast, on one core. Beside it, as peers,
scikit-learn's figures for the same cells: F1, average precision, Brier score and log loss.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from sklearn.metrics import average_precision_score, brier_score_loss, f1_score, log_loss

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame
from gridtrack.evaluation.counting import count_forecast
from gridtrack.evaluation.scores import ScoreWriter
from gridtrack.evaluation.strata import REGIONS
from gridtrack.evaluation.thresholds import half

STEPS, SIZE = 20, 100


def median_ms(call: Callable[[], object], times: int) -> float:
    call()
    spent = []
    for _ in range(times):
        began = time.perf_counter()
        call()
        spent.append(time.perf_counter() - began)
    return 1e3 * float(np.median(spent))


def frames(rng: np.random.Generator, visible: float) -> list[GridFrame]:
    nothing = np.zeros((0, 2), np.float32)
    seen = rng.random((STEPS + 1, SIZE, SIZE)) < visible
    hit = seen & (rng.random(seen.shape) < 0.05)
    return [GridFrame(0, v, o, SE2(), nothing, nothing, np.zeros(0, np.uint8)) for v, o in zip(seen, hit, strict=True)]


def with_scikit_learn(occupancy: np.ndarray, came: list[GridFrame], regions: np.ndarray) -> None:
    for step, frame in enumerate(came):
        for members in (regions >= 0, regions == 1, regions == 2):
            scored = frame.visible & members
            truth, p = frame.occupied[scored], occupancy[step][scored]
            f1_score(truth, p >= 0.5)
            average_precision_score(truth, p)
            brier_score_loss(truth, p)
            log_loss(truth, p)


def main() -> None:
    rng = np.random.default_rng(0)
    regions = rng.integers(0, len(REGIONS), (SIZE, SIZE)).astype(np.uint8)
    occupancy = rng.beta(0.3, 3.0, (STEPS + 1, SIZE, SIZE)).astype(np.float32)
    for visible in (0.5, 1.0):
        came = frames(rng, visible)
        ms = median_ms(lambda came=came: count_forecast(occupancy, came, regions), 200)
        print(f"count a forecast, {visible:4.0%} of the cells visible: {ms:6.2f} ms")
    tally = count_forecast(occupancy, came, regions)
    with tempfile.TemporaryDirectory() as folder, ScoreWriter(Path(folder), STEPS, half(STEPS)) as writer:
        stamps = iter(range(0, 10**15, 500_000_000))
        ms = median_ms(lambda: writer.add(next(stamps), "", tally), 200)
    print(f"write its rows:                               {ms:6.2f} ms")
    ms = median_ms(lambda: with_scikit_learn(occupancy, came, regions), 3)
    print(f"the same figures by scikit-learn:             {ms:6.0f} ms")


if __name__ == "__main__":
    main()
