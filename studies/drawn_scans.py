"""How many drawn scans of the true scene come close to the oracle's forecast, which draws none?

`python -m studies.drawn_scans [RECORDING...] [--draws 1 4 16 64 256]` (two minutes). Every fourth frame of two
recordings of the junction. A forecast from N scans with the simulator's range noise is (occupied + 1/2) / (visible + 1)
of each cell (Jeffreys); the noise-free scan is 0 or 1. Log loss of visible and of dynamic cells, F1 of dynamic cells at
0.5, and the time for a frame.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.grid import GridSpec, Mask
from gridtrack.common.raycast import cast_scan
from gridtrack.evaluation.runs.oracle import expected_grid, range_errors
from gridtrack.evaluation.scoring.counting import CLIP
from gridtrack.evaluation.scoring.strata import CELL_KINDS, cell_kinds_around
from gridtrack.recordings.observation import Observation
from gridtrack.recordings.stream import GridStream, open_stream
from gridtrack.recordings.truth import static_cells
from gridtrack.simulation.laser import with_noise
from gridtrack.simulation.range_errors import true_ranges

from studies.support.results_file import measured_table
from studies.support.shipped import JUNCTION

RECORDINGS = (JUNCTION / "test-101.tracks", JUNCTION / "test-104.tracks")
EVERY = 4
"""Consecutive frames differ little."""
Forecaster = Callable[[Observation], NDArray[np.float64]]


@dataclass
class Score:
    """Sums over cells, in visible and in dynamic ones: log loss, cells; of dynamic cells true and false positives and
    negatives; seconds and frames."""

    loss: NDArray[np.float64] = field(default_factory=lambda: np.zeros(2))
    cells: NDArray[np.float64] = field(default_factory=lambda: np.zeros(2))
    hits: NDArray[np.int64] = field(default_factory=lambda: np.zeros(3, np.int64))
    seconds: float = 0.0
    frames: int = 0

    def add(self, forecast: NDArray[np.float64], observation: Observation, dynamic: Mask) -> None:
        """Score one frame."""
        seen, occupied = observation.frame.visible, observation.frame.occupied
        likelihood = np.clip(np.where(occupied, forecast, 1.0 - forecast), CLIP, 1.0 - CLIP)
        for i, cells in enumerate((seen, seen & dynamic)):
            self.loss[i] -= np.log(likelihood[cells]).sum()
            self.cells[i] += cells.sum()
        called, there = forecast[seen & dynamic] >= 0.5, occupied[seen & dynamic]
        self.hits += (called & there).sum(), (called & ~there).sum(), (~called & there).sum()
        self.frames += 1

    def row(self, name: str) -> list[str]:
        """The row of the table."""
        losses = self.loss / self.cells
        f1 = 2 * self.hits[0] / (2 * self.hits[0] + self.hits[1] + self.hits[2])
        return [name, *(f"{loss:.4f}" for loss in losses), f"{f1:.3f}", f"{1e3 * self.seconds / self.frames:.1f}"]


def cast(observation: Observation, grid: GridSpec, ranges: Sequence[NDArray[np.float32]]) -> tuple[Mask, Mask]:
    """Visible and occupied cells (M, M) of the scans of a frame with other ranges."""
    visible, occupied = np.zeros((2, *grid.shape), np.bool_)
    for scan, pose, one in zip(observation.scans, observation.grid_T_sensor, ranges, strict=True):
        cast_scan(replace(scan, ranges=one), grid, pose, visible, occupied)
    return visible, occupied


def noise_free(observation: Observation, grid: GridSpec) -> NDArray[np.float64]:
    """The noise-free scan of the true scene."""
    return cast(observation, grid, _true(observation))[1].astype(np.float64)


def drawn(observation: Observation, grid: GridSpec, draws: int) -> NDArray[np.float64]:
    """P(occupied | visible) from `draws` scans."""
    random = np.random.default_rng(observation.frame.stamp_ns)
    true, (seen, hit) = _true(observation), np.zeros((2, *grid.shape))
    for _ in range(draws):
        ranges = [with_noise(one, scan.range_max, random) for one, scan in zip(true, observation.scans, strict=True)]
        visible, occupied = cast(observation, grid, ranges)
        seen += visible
        hit += occupied
    found: NDArray[np.float64] = (hit + 0.5) / (seen + 1.0)
    return found


def _true(observation: Observation) -> list[NDArray[np.float32]]:
    assert observation.scene is not None
    return [true_ranges(scan, scan.scene or observation.scene) for scan in observation.scans]


def forecasters(stream: GridStream, draws: Sequence[int]) -> Iterator[tuple[str, Forecaster]]:
    """Each forecaster with its name."""
    grid, errors = stream.grid, range_errors(stream)
    yield "noise-free scan", lambda one: noise_free(one, grid)
    for number in draws:
        yield f"{number} drawn", lambda one, number=number: drawn(one, grid, number)
    yield "oracle", lambda one: expected_grid(one, grid, errors).astype(np.float64)


def main() -> None:
    """Print the table."""
    assert __doc__ is not None
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("recordings", nargs="*", type=Path, default=RECORDINGS)
    parser.add_argument("--draws", nargs="*", type=int, default=(1, 4, 16, 64, 256))
    arguments = parser.parse_args()
    scores: dict[str, Score] = {}
    for path in arguments.recordings:
        stream = open_stream(path)
        observations = list(stream.observations())[::EVERY]
        first = observations[0]
        assert first.scene is not None
        kinds = cell_kinds_around(static_cells(first.scene, stream.grid, first.frame.world_T_grid))
        for name, forecast in forecasters(stream, arguments.draws):
            forecast(first)  # compiles
            score = scores.setdefault(name, Score())
            for observation in observations:
                began = time.perf_counter()
                p = forecast(observation)
                score.seconds += time.perf_counter() - began
                score.add(p, observation, kinds == CELL_KINDS.index("dynamic"))
    columns = ["forecast", "log loss, visible", "log loss, dynamic", "F1, dynamic", "ms a frame"]
    print(measured_table(columns, [score.row(name) for name, score in scores.items()]).markdown())


if __name__ == "__main__":
    main()
