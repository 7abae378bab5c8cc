"""Our trackers and scores beside other libraries that do the same work: processor times in one run, as ratios.

`python -m benchmarks.side_by_side` (ten minutes; `pip install openvino pysteps` beside the extra `dev`). Forecasts,
scores and people are the same for all: networks agree by assertion, neighbourhoods too, and Stone Soup's tracks are
compared in their own benchmark. With --out a bar chart is written beside the file.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import groupby
from pathlib import Path

import matplotlib
import numpy as np
import torch
from matplotlib.figure import Figure
from sklearn.calibration import calibration_curve
from sklearn.metrics import average_precision_score, brier_score_loss, f1_score, log_loss

from gridtrack.evaluation.referee.strata import STRATA, RegionMaps
from gridtrack.evaluation.referee.targets import Target, cell_regions, members
from gridtrack.evaluation.scores.cells import PROBABILITY_EDGES, count_cells
from gridtrack.evaluation.scores.neighbourhoods import SCALES, sum_neighbourhoods
from gridtrack.trackers.recurrent.convgru_tracker import DilatedConvGRUTracker
from gridtrack.trackers.recurrent.kernels import convgru

from benchmarks import inference, scoring, stone_soup
from studies.support.drawings import COLOURS, SETTINGS, write_svg
from studies.support.results_file import measured_table, study_parser, write_table

COMMAND = "python -m benchmarks.side_by_side"
OURS = "gridtrack"
ROUNDS, FRAMES, SEEDS, PEOPLE = 40, 120, 2, 30
EMPTY_CELLS = 2 * max(SCALES)
"""Cells along the sides of the window without content: libraries count cells outside the window in a neighbourhood."""
Times = dict[str, float]
"""Median milliseconds by implementation, ours first."""


def network_times() -> Times:
    """A forecast of 20 steps by the dilated ConvGRU, float32, one thread, without classes."""
    torch.set_num_threads(1)
    with torch.inference_mode():
        untrained = DilatedConvGRUTracker.build(inference.SIZE, DilatedConvGRUTracker.Options(), 0)
        network, ours = inference.trained_like(untrained), {"float32": convgru.INFERENCE["float32"]}
        medians_ms = inference.compared(inference.contestants(network, ours, peers=True), ROUNDS)
    own, *peers = ((name.removesuffix(", float32"), cases[inference.FORECAST]) for name, cases in medians_ms.items())
    return {OURS: own[1], **dict(peers)}


def tracking_times() -> Times:
    """An update of the multi-object tracker with thirty people, Kalman filters, segmentation included."""
    results = stone_soup.compared(PEOPLE, FRAMES, range(1, 1 + SEEDS))
    medians = [float(np.median(np.concatenate([times for _, times in each]))) for each in results.values()]
    return dict(zip((OURS, "Stone Soup, nearest neighbour", "Stone Soup, JPDA"), medians, strict=True))


def cell_times() -> Times:
    """F1, average precision, Brier score, log loss, calibration and histogram of a forecast, in each stratum."""
    rng = np.random.default_rng(0)
    region_maps, targets = scoring.street(STRATA), scoring.targets(rng, False)
    occupancy = rng.beta(0.3, 3.0, (len(targets), scoring.SIZE, scoring.SIZE)).astype(np.float32)
    ages = np.zeros((scoring.SIZE, scoring.SIZE), np.uint8)
    ours = medians_of({OURS: lambda: count_cells(occupancy, targets, region_maps, ages)}, ROUNDS)
    peers = {"scikit-learn": lambda: with_scikit_learn(occupancy, targets, region_maps, ages)}
    return ours | medians_of(peers, math.ceil(ROUNDS / 20))


def with_scikit_learn(
    occupancy: np.ndarray, observed: Sequence[Target], region_maps: RegionMaps, ages: np.ndarray
) -> None:
    member_of = members(region_maps.strata)
    for p_of_step, target in zip(occupancy, observed, strict=True):
        regions = cell_regions(target, region_maps, ages)
        for of_stratum in member_of:
            counted = of_stratum[regions]
            truth, p = target.state[counted] % 2 == 1, p_of_step[counted]
            if truth.any() and not truth.all():
                f1_score(truth, p >= 0.5)
                average_precision_score(truth, p)
                brier_score_loss(truth, p)
                log_loss(truth, p)
                calibration_curve(truth, p, n_bins=50)
                np.histogram(p, PROBABILITY_EDGES)


def neighbourhood_times() -> Times:
    """The fractions skill score of a forecast at four scales, all cells visible; the scores agree."""
    from pysteps.verification import spatialscores
    from scores.spatial import fss_2d_binary
    from xarray import DataArray

    rng = np.random.default_rng(0)
    size, steps = scoring.SIZE, scoring.STEPS + 1
    inside = np.zeros((size, size), bool)
    inside[EMPTY_CELLS:-EMPTY_CELLS, EMPTY_CELLS:-EMPTY_CELLS] = True
    forecast, observed = (inside & (rng.random((steps, size, size)) < 0.05) for _ in range(2))
    occupancy = forecast.astype(np.float32)
    seen = replace(scoring.targets(rng, False)[0].frame, visible=np.ones((size, size), bool))
    targets = [Target.of_frame(replace(seen, occupied=occupied)) for occupied in observed]
    region_maps = scoring.street(("visible",))
    ages = np.zeros((size, size), np.uint8)

    def ours() -> list[float]:
        sums = sum_neighbourhoods(occupancy, targets, region_maps, ages)
        return list(sums.agreement.sum(axis=(0, 1)) / sums.squares.sum(axis=(0, 1)))

    def pysteps() -> list[float]:
        found = []
        for scale in SCALES:
            sums = spatialscores.fss_init(0.5, scale)
            for pair in zip(forecast, observed, strict=True):
                spatialscores.fss_accum(sums, *(occupied.astype(float) for occupied in pair))
            found.append(spatialscores.fss_compute(sums))
        return found

    dims = ("step", "row", "column")
    fields = [DataArray(each, dims=dims) for each in (forecast, observed)]

    def scores() -> list[float]:
        return [
            float(fss_2d_binary(*fields, window_size=(scale, scale), spatial_dims=dims[1:], zero_padding=True))
            for scale in SCALES
        ]

    calls = {OURS: ours, "pysteps": pysteps, "scores": scores}
    for name, call in calls.items():
        np.testing.assert_allclose(call(), ours(), atol=1e-5, err_msg=name)
    return medians_of(calls, ROUNDS)


def medians_of(calls: Mapping[str, Callable[[], object]], rounds: int) -> Times:
    return {name: float(np.median(ms)) for name, ms in inference.processor_times_ms(calls, rounds).items()}


WORKS: dict[str, Callable[[], Times]] = {
    "forecast of 20 steps, dilated ConvGRU": network_times,
    "update, thirty people": tracking_times,
    "scores of the cells of a forecast": cell_times,
    "fractions skill score of a forecast": neighbourhood_times,
}


def _ratio_text(ratio: float) -> str:
    return f"{ratio:.1f}" if ratio < 100 else f"{ratio:.0f}"


def draw(times: Mapping[str, Times], path: Path) -> None:
    """A bar for each implementation: its time as a multiple of ours, on a logarithmic axis."""
    bars = [(work, name, ms / found[OURS]) for work, found in times.items() for name, ms in found.items()]
    with matplotlib.rc_context(SETTINGS):
        figure = Figure((7.2, 0.24 * len(bars) + 0.45 * len(times) + 0.5), layout="constrained")
        panels = figure.subplots(len(times), 1, sharex=True, height_ratios=[len(found) for found in times.values()])
        for axis, (work, group) in zip(np.atleast_1d(panels), groupby(bars, lambda bar: bar[0]), strict=True):
            names, ratios = zip(*((name, ratio) for _, name, ratio in group), strict=True)
            drawn = axis.barh(names, ratios, color=[COLOURS[name != OURS] for name in names], height=0.7)
            axis.bar_label(drawn, list(map(_ratio_text, ratios)), padding=3)
            axis.set(title=work, xscale="log")
            axis.xaxis.set_major_formatter("{x:g}")
            axis.margins(x=0.12)
            axis.invert_yaxis()
        axis.set_xlabel("processor time, times ours")
        write_svg(figure, path)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = study_parser(__doc__, "docs/results/side_by_side.json")
    given = parser.parse_args(arguments)
    times = {work: measure() for work, measure in WORKS.items()}
    rows = [[work, name, _ratio_text(ms / found[OURS])] for work, found in times.items() for name, ms in found.items()]
    table = measured_table(("work", "by", "processor time, times ours"), rows)
    print(table.markdown())
    write_table(given.out, "side by side", table, COMMAND)
    if given.out:
        draw(times, given.out.with_suffix(".svg"))


if __name__ == "__main__":
    main()
