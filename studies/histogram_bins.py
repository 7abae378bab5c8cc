"""Error of the PR-AUC from histograms: with the bins in use and with 50 coarse ones, on real forecasts.

`python -m studies.histogram_bins` (twenty minutes). Every tracker that ships with weights, on the leg_tracker recording
and on a test recording of the junction, a forecast every half second; visible and dynamic cells at the headline
horizons. The exact PR-AUC is scikit-learn's `average_precision_score` of the probabilities themselves. Also drawn
forecasts: probabilities from a beta distribution, calibrated, and a hundred times too small, so that many lie in the
lowest bins.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.metrics import average_precision_score

from gridtrack.common.grid import nearest_step
from gridtrack.evaluation.referee.referee import Delivery, scored_forecasts
from gridtrack.evaluation.referee.splits import Sampling, plan_split
from gridtrack.evaluation.referee.targets import SEEN_OCCUPIED
from gridtrack.evaluation.scores.cells import PROBABILITY_EDGES, Tally
from gridtrack.evaluation.scoring import metrics

from studies.support.results_file import measured_table, write_table
from studies.support.shipped import DEMO, JUNCTION, shipped_tracker

TRACKERS = ("persistence", "static-map", "kalman", "factor-graph", "dogma", "dilated-convgru", "deep-tracking-rnn")
RECORDINGS = {"leg_tracker": (DEMO, None), "test-101": (JUNCTION / "test-101.tracks", JUNCTION / "validation.tracks")}
HORIZONS_S = (0.5, 1.0, 2.5)
COARSE = np.round(4096 * np.sin(0.5 * np.pi * np.arange(51) / 50) ** 2) / 4096
"""The bins of version 1 of the histogram."""
BETA = ((0.02, 2.0), (0.05, 5.0), (0.3, 3.0), (0.4, 0.8), (1.0, 1.0), (5.0, 0.3))
DRAWN_CELLS = 300_000

Case = tuple[NDArray[np.float32], NDArray[np.bool_]]
"""Probability and whether occupied (N,) of cells."""


def forecasts(recording: str, name: str) -> Iterator[Case]:
    """The scored cells of tracker `name`: dynamic and visible ones at each horizon."""
    path, validation = RECORDINGS[recording]
    split = plan_split(str(path), str(validation) if validation else None, Sampling(max(HORIZONS_S), 0.5))
    regions = split.regions().test
    steps = [nearest_step(horizon_s, split.test.period_s) for horizon_s in HORIZONS_S]
    found: dict[int, list[tuple[NDArray[Any], ...]]] = {step: [] for step in steps}
    delivery = Delivery(split.test, lambda: None, regions)
    for scored in scored_forecasts(shipped_tracker(name, split.test), delivery, split.schedule, 0):
        dynamic = scored.region_maps.dynamic.reshape(-1)
        for step in steps:
            state = scored.targets[step].state.reshape(-1)
            seen = state <= SEEN_OCCUPIED
            p = scored.forecast.occupancy[step].reshape(-1)
            found[step].append((p[seen], state[seen] == SEEN_OCCUPIED, dynamic[seen]))
    for cells in found.values():
        p, occupied, moving = (np.concatenate(parts) for parts in zip(*cells, strict=True))
        yield p, occupied
        yield p[moving], occupied[moving]


def drawn(shrink: float) -> Iterator[Case]:
    """Cells occupied with a probability from each beta distribution, which is forecast `shrink` times as large."""
    rng = np.random.default_rng(0)
    for shape in BETA:
        p = rng.beta(*shape, DRAWN_CELLS).astype(np.float32)
        yield (p * np.float32(shrink)), rng.random(DRAWN_CELLS) < p


def error(case: Case, edges: NDArray[np.float64]) -> float:
    """PR-AUC of the bins less that of the probabilities."""
    p, occupied = case
    bins = np.searchsorted(edges[1:-1].astype(np.float32), p, side="right")
    tally = Tally.empty(0, ("visible",))
    tally.cells, tally.positives = (
        np.bincount(chosen, minlength=len(edges) - 1)[None, None] for chosen in (bins, bins[occupied])
    )
    return float(metrics.average_precision(tally)[0, 0] - average_precision_score(occupied, p))


def row(name: str, cases: Iterator[Case]) -> list[str]:
    """The errors of largest magnitude among the cases, with either bins."""
    errors = np.array([[error(case, edges) for edges in (COARSE, PROBABILITY_EDGES)] for case in cases])
    worst = errors[np.abs(errors).argmax(axis=0), [0, 1]]
    return [name, *(f"{value:+.4f}" for value in worst)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, help="results file, such as docs/results/statistics.json")
    parser.add_argument("--trackers", nargs="+", choices=TRACKERS, default=TRACKERS, help="some of them: faster")
    arguments = parser.parse_args()
    names: Sequence[str] = arguments.trackers
    rows = [row(f"{name}, {recording}", forecasts(recording, name)) for recording in RECORDINGS for name in names]
    rows += [row("drawn, calibrated", drawn(1.0)), row("drawn, a hundred times too small", drawn(0.01))]
    table = measured_table(["largest error", "50 bins", f"{len(PROBABILITY_EDGES) - 1} bins"], rows)
    print(table.markdown())
    chosen = "" if tuple(names) == TRACKERS else f" --trackers {' '.join(names)}"
    write_table(arguments.out, "histogram bins", table, f"python -m studies.histogram_bins{chosen}")


if __name__ == "__main__":
    main()
