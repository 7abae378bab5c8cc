"""Whether thresholds that are smoothed over the horizon transfer better to another recording.

`python -m studies.threshold_smoothing RUN` (some seconds) reads a run on several recordings. Thresholds are chosen for
each step on some of its recordings, smoothed over the steps as log odds or not, and applied to a recording that they
were not chosen on: chosen on all others (leave one out), and on one other, as on a short validation stretch. Printed
is F1 pooled over the recordings that the thresholds were applied to, mean over steps 1 to the last.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logit

from gridtrack.evaluation.runs.trial_record import read_trial_record
from gridtrack.evaluation.scores.cells import HALF, PROBABILITY_BINS, PROBABILITY_EDGES, Tally
from gridtrack.evaluation.scores.thresholds import best_thresholds
from gridtrack.evaluation.scoring import metrics
from gridtrack.evaluation.scoring.histograms import read_tally

from studies.support.results_file import measured_table, write_table

STRATA = ("dynamic", "in-motion")
WINDOW = 5
Bins = NDArray[np.int64]
"""Thresholds (S, K) as bins of the histogram."""


def unsmoothed(bins: Bins) -> Bins:
    """Each step its own."""
    return bins


def moving_mean(bins: Bins) -> Bins:
    """The mean over WINDOW steps, of fewer at the ends."""
    odds = logit(PROBABILITY_EDGES[bins])
    rows = [odds[max(0, n - WINDOW // 2) : n + WINDOW // 2 + 1].mean(axis=0) for n in range(len(odds))]
    return nearest(np.stack(rows))


def parabola(bins: Bins) -> Bins:
    """A polynomial of degree two over the steps."""
    odds, steps = logit(PROBABILITY_EDGES[bins]), np.arange(len(bins))
    fits = [np.polyval(np.polyfit(steps, column, 2), steps) for column in odds.T]
    return nearest(np.stack(fits, axis=1))


def constant(bins: Bins) -> Bins:
    """The mean over all steps."""
    return nearest(np.broadcast_to(logit(PROBABILITY_EDGES[bins]).mean(axis=0), bins.shape))


def at_half(bins: Bins) -> Bins:
    """0.5 at every step."""
    return np.full_like(bins, HALF)


METHODS: dict[str, Callable[[Bins], Bins]] = {
    "each step": unsmoothed,
    f"mean of {WINDOW}": moving_mean,
    "parabola": parabola,
    "constant": constant,
    "0.5": at_half,
}


def nearest(odds: NDArray[np.float64]) -> Bins:
    """The bins whose lower edges are nearest to thresholds given as log odds (S, K)."""
    distance = np.abs(PROBABILITY_EDGES[1:PROBABILITY_BINS] - expit(odds)[..., None])
    bins: Bins = 1 + distance.argmin(axis=-1)
    return bins


def tallies_of(run: Path) -> dict[str, list[Tally]]:
    """The counts of the complete trials of a run, by label, of steps 1 to the last."""
    found: dict[str, list[Tally]] = {}
    for folder in sorted(path.parent for path in run.glob("*/outcome.json")):
        record = read_trial_record(folder)
        if record is not None and record.complete:
            tally = read_tally(folder, record.steps, STRATA)
            ahead = Tally.empty(record.steps - 1, STRATA)
            ahead.cells, ahead.positives = tally.cells[1:], tally.positives[1:]
            found.setdefault(record.label, []).append(ahead)
    return found


def pooled(tallies: Sequence[Tally]) -> Tally:
    total = Tally.empty(len(tallies[0].cells) - 1, STRATA)
    for tally in tallies:
        total.add(tally)
    return total


def choices(tallies: Sequence[Tally], all_others: bool) -> Iterator[tuple[Tally, Tally]]:
    """What thresholds are chosen on, and what they are applied to."""
    for i, applied in enumerate(tallies):
        others = [tally for j, tally in enumerate(tallies) if j != i]
        for chosen_on in [pooled(others)] if all_others else others:
            yield chosen_on, applied


def transferred(tallies: Sequence[Tally], method: Callable[[Bins], Bins], all_others: bool) -> NDArray[np.float64]:
    """F1 (K,) of the counts of every choice together, mean over the steps."""
    counts = [
        applied.confusion(method(best_thresholds(chosen_on, "").bins))
        for chosen_on, applied in choices(tallies, all_others)
    ]
    mean: NDArray[np.float64] = metrics.f1_score(np.sum(counts, axis=0)).mean(axis=0)
    return mean


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("run", type=Path)
    parser.add_argument("--out", type=Path, help="results file, such as docs/results/statistics.json")
    arguments = parser.parse_args()
    rows = []
    for label, tallies in tallies_of(arguments.run).items():
        if len(tallies) < 2:
            continue
        for chosen, all_others in (("all others", True), ("one other", False)):
            f1 = {name: transferred(tallies, method, all_others) for name, method in METHODS.items()}
            for k, stratum in enumerate(STRATA):
                texts = [f"{values[k]:.4f}" for values in f1.values()]
                rows.append([label, stratum, chosen, str(len(tallies)), *texts])
    table = measured_table(["tracker", "cells", "chosen on", "recordings", *METHODS], rows)
    print(table.markdown())
    write_table(arguments.out, "smoothed thresholds", table, "python -m studies.threshold_smoothing RUN")


if __name__ == "__main__":
    main()
