"""Speed of scoring one forecast: 21 steps of 100 x 100 cells, every stratum, histogram and losses, and its rows.

`python -m benchmarks.scoring` (half a minute). Aims, on one core: 2 ms to count a forecast; 5 ms for the sums over
neighbourhoods without truth, 5 ms along 720 beams, and 3 ms for the paths of contact foresight without sampled futures.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec
from gridtrack.common.scan import Scan
from gridtrack.evaluation.referee.motion import parts_of
from gridtrack.evaluation.referee.referee import ScoredForecast
from gridtrack.evaluation.referee.strata import (
    CELL_KINDS,
    REGIONS,
    STRATA,
    STRATA_WITH_TRUTH,
    RegionMaps,
    region_maps_of,
)
from gridtrack.evaluation.referee.targets import (
    HIDDEN_FREE,
    NOT_SCORED,
    SEEN_FREE,
    SEEN_OCCUPIED,
    Target,
    crossing_beams,
)
from gridtrack.evaluation.runs.scorekeeper import Counter
from gridtrack.evaluation.runs.sums import SumsWriter
from gridtrack.evaluation.scores.cells import count_cells
from gridtrack.evaluation.scores.contact_foresight import CONTACT_FORESIGHT
from gridtrack.evaluation.scores.definition import TrialFacts
from gridtrack.evaluation.scores.neighbourhoods import sum_neighbourhoods
from gridtrack.evaluation.scores.registry import built_in
from gridtrack.evaluation.scores.thresholds import half
from gridtrack.recordings.observation import Observation
from gridtrack.trackers.contract import MAX_FUTURES, Forecast

from benchmarks.timing import median_ms
from studies.support.results_file import study_parser

STEPS, SIZE, CLASSES = 20, 100, 5
GRID = GridSpec(SIZE, 0.2, (-10.0, 0.0))


def street(strata: tuple[str, ...]) -> RegionMaps:
    """Two walls along a street, seen from its near end."""
    cell_kinds = np.full(GRID.shape, CELL_KINDS.index("dynamic"), np.uint8)
    for column in (15, 85):
        cell_kinds[:, column - 1 : column + 2] = CELL_KINDS.index("ring")
        cell_kinds[:, column] = CELL_KINDS.index("static")
    return region_maps_of(cell_kinds, GRID, np.array([[0.0, 1.0]], np.float32), strata)


def targets(rng: np.random.Generator, truth: bool) -> list[Target]:
    """Frames with half of the cells visible, in rotating shadows; a tenth of the others is not scored."""
    x, y = GRID.cell_centres(np.ones(GRID.shape, bool)).T.reshape(2, *GRID.shape)
    bearing, nothing = np.arctan2(y - 1.0, x), np.zeros((0, 2), np.float32)
    found, dynamic = [], street(STRATA).dynamic
    for n in range(STEPS + 1):
        visible = np.sin(9 * bearing + 0.1 * n) > 0
        state = np.where(visible, SEEN_FREE, HIDDEN_FREE if truth else NOT_SCORED).astype(np.uint8)
        state[(rng.random(GRID.shape) < 0.02) & (state != NOT_SCORED)] += 1
        state[(rng.random(GRID.shape) < 0.1) & ~visible] = NOT_SCORED
        motion = parts_of(rng.random(GRID.shape) < 0.3, state == SEEN_OCCUPIED, dynamic, GRID)
        cells = np.flatnonzero((state % 2 == 1) & (state != NOT_SCORED))
        frame = GridFrame(n, visible, state == SEEN_OCCUPIED, SE2(), nothing, nothing, np.zeros(0, np.uint8))
        found.append(Target(frame, state, motion, cells, rng.integers(0, CLASSES, cells.size).astype(np.uint8)))
    return found


def main(arguments: Sequence[str] | None = None) -> None:
    parser = study_parser(__doc__)
    parser.add_argument("--runs", type=int, default=200, help="of each call, fewer of slow ones")
    runs = parser.parse_args(arguments).runs
    fewer, few = (math.ceil(runs / share) for share in (2, 40))
    rng = np.random.default_rng(0)
    ages = rng.integers(0, 5, (10, 10)).repeat(10, axis=0).repeat(10, axis=1).astype(np.uint8)
    forecasts = {
        "spread thin": rng.beta(0.3, 3.0, (STEPS + 1, SIZE, SIZE)).astype(np.float32),
        "zeros and ones": (rng.random((STEPS + 1, SIZE, SIZE)) < 0.03).astype(np.float32),
    }
    scan = Scan(0, rng.uniform(3.0, 9.0, 720).astype(np.float32), 0.0, np.pi / 720, 0.1, 30.0)
    pose = SE2(0.0, 1.0)
    beams = crossing_beams(Observation(targets(rng, False)[0].frame, (scan,), (pose,)), GRID)
    for strata, truth in ((STRATA, False), (STRATA_WITH_TRUTH, True)):
        region_maps, observed = street(strata), targets(rng, truth)
        names = tuple(str(k) for k in range(CLASSES))
        facts = TrialFacts(GRID.cell_m, STEPS, strata, half(STEPS, strata), names, names)
        seen = tuple(replace(target, beams=beams) for target in observed)
        for name, occupancy in forecasts.items():
            ms = median_ms(lambda o=occupancy, c=observed, a=region_maps: count_cells(o, c, a, ages), runs)
            print(f"count a forecast, {len(strata):2} strata of {REGIONS} regions, {name:14}: {ms:7.2f} ms")
            ms = median_ms(lambda o=occupancy, c=observed, a=region_maps: sum_neighbourhoods(o, c, a, ages), fewer)
            print(f"  its sums over neighbourhoods: {ms:.2f} ms")
            semantics = np.full((STEPS + 1, CLASSES, SIZE, SIZE), 1 / CLASSES, np.float32)
            futures = rng.random((MAX_FUTURES, *occupancy.shape)) < occupancy
            forecast = Forecast(occupancy, semantics=semantics, futures=futures)
            for score in built_in():
                # a new counter each time: memories would grow without end, because every frame has the same stamp
                ms = median_ms(
                    lambda f=forecast, k=score, x=facts, s=seen, a=region_maps: Counter([k], x).count(
                        ScoredForecast(f, s, a, ages)
                    ),
                    few,
                )
                print(f"  {score.name} alone: {ms:.2f} ms")
            plain = ScoredForecast(Forecast(occupancy), seen, region_maps, ages)
            ms = median_ms(lambda p=plain, x=facts: Counter([CONTACT_FORESIGHT], x).count(p), few)
            print(f"  contact_foresight without sampled futures: {ms:.2f} ms")
    returns, chosen = observed[0].frame.occupied, rng.random(GRID.shape) < 0.3
    ms = median_ms(lambda: parts_of(chosen, returns, region_maps.dynamic, GRID), runs)
    print(f"find the parts of a frame with {returns.sum()} returns: {ms:.2f} ms")
    counter = Counter(built_in(), facts)
    sums = counter.count(ScoredForecast(forecast, seen, region_maps, ages))
    with tempfile.TemporaryDirectory() as folder, SumsWriter(Path(folder), counter.layouts, STEPS) as writer:
        stamps = iter(range(0, 10**15, 500_000_000))

        def write() -> None:
            stamp_ns = next(stamps)
            for name, own in sums.items():
                writer.add(stamp_ns, "", name, own)

        print(f"write its rows: {median_ms(write, runs):.2f} ms")


if __name__ == "__main__":
    main()
