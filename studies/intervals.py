"""Coverage of the interval methods on correlated series of counts, the chosen method and the rejected ones.

`python -m studies.intervals` (five minutes; `--out docs/results/statistics.json` keeps the table of blocks). Aim: the
chosen method covers 93 to 97 % at 20 units in every setting. Its speed: `benchmarks/statistics.py`.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import lfilter
from scipy.special import expit, logit, ndtr, ndtri, stdtrit

from gridtrack.evaluation.scores.f1 import COUNTS
from gridtrack.evaluation.statistics.jackknife import interval
from gridtrack.evaluation.statistics.units import (
    UnitRule,
    autocorrelation_time,
    residuals,
    shortest_block_s,
    sum_by_unit,
)
from gridtrack.reports import differences

from studies.support.results_file import measured_table, write_table

Counts = np.ndarray  # (U, R, C): units, repetitions, counts
Interval = tuple[np.ndarray, np.ndarray]
FRAMES, RESAMPLES = 30, 500
WEIGHTS = np.array([2.0, 0, 0, 0, 0, 0]), np.array([2.0, 1, 1, 0, 0, 0])
SETTINGS: dict[str, dict[str, Any]] = {
    "recordings alike": {"unlike": 0.1, "traffic": 0.1},
    "recordings unlike": {"unlike": 0.8, "traffic": 0.8},
    "recordings very unlike": {"unlike": 1.0, "traffic": 1.2},
    "F1 near 1": {"logit_recall": 3.0, "false": 0.02, "unlike": 0.8},
    "F1 near 0": {"logit_recall": -3.5, "false": 0.1, "unlike": 0.8},
    "positives rare": {"cells": 0.05, "traffic": 1.0, "false": 0.5},
    "two in five empty": {"empty": 0.4, "cells": 1.0, "false": 0.2},
}

MEMORIES = {
    "2 s": {2.0: 1.0},
    "5 s": {5.0: 1.0},
    "40 s": {40.0: 1.0},
    "2 s, and 40 s with a tenth of the variance": {2.0: 0.9, 40.0: 0.1},
    "2 s, and 40 s with a third of the variance": {2.0: 2 / 3, 40.0: 1 / 3},
}
"""Time constants of the drift within one recording, seconds, with their shares of its variance."""


def autoregressive(shape: tuple[int, ...], rng: np.random.Generator, memory: float = 0.9) -> np.ndarray:
    """Series of unit variance along the last axis."""
    series = rng.standard_normal(shape)
    for t in range(1, shape[-1]):
        series[..., t] = memory * series[..., t - 1] + np.sqrt(1 - memory**2) * series[..., t]
    return series


def two_trackers(
    rng: np.random.Generator, units: int, repetitions: int, frames: int = FRAMES, *,
    logit_recall: float = 0.0, cells: float = 20.0, unlike: float = 0.4, traffic: float = 0.5, false: float = 0.3,
    empty: float = 0.0, shared: float = 0.8,
) -> list[np.ndarray]:  # fmt: skip
    """Counts (U, R, F, C) of two trackers equally good, on the same recordings: each recording has its own difficulty
    and traffic, and both drift within it with an autocorrelation of 0.9 from frame to frame."""
    one, each = (units, repetitions, frames), (units, repetitions, 1)
    rate = cells * np.exp(0.5 * autoregressive(one, rng) + traffic * rng.standard_normal(each))
    rate = rate * (rng.random(each) >= empty)
    occupied = rng.poisson(rate)
    common = unlike * rng.standard_normal(each) + 0.5 * np.sqrt(shared) * autoregressive(one, rng)
    found = []
    for _ in range(2):
        own = unlike * rng.standard_normal(each) + 0.5 * autoregressive(one, rng)
        tp = rng.binomial(occupied, expit(logit_recall + common + np.sqrt(1 - shared) * own))
        fp, nothing = rng.poisson(false * (rate + 0.5)), np.zeros(one)
        found.append(np.stack([tp, fp, occupied - tp, nothing, nothing, nothing], axis=-1).astype(np.float64))
    return found


def parts(counts: Counts) -> tuple[np.ndarray, np.ndarray]:
    return counts @ WEIGHTS[0], counts @ WEIGHTS[1]


def f1(counts: np.ndarray) -> float:
    """Of everything together."""
    sums = counts.reshape(-1, len(COUNTS)).sum(axis=0)
    return float(sums @ WEIGHTS[0] / (sums @ WEIGHTS[1]))


def linearised(counts: Counts) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The ratio (R,), its standard error (R,) by the delta method, and the ratio without each unit (U, R)."""
    part, whole = parts(counts)
    ratio = part.sum(0) / whole.sum(0)
    units = len(part)
    error = np.sqrt(units / (units - 1) * ((part - ratio * whole) ** 2).sum(0)) / whole.sum(0)
    without = (part.sum(0) - part) / (whole.sum(0) - whole)
    return ratio, error, without


def delta_normal(counts: Counts) -> Interval:
    ratio, error, _ = linearised(counts)
    return ratio - 1.96 * error, ratio + 1.96 * error


def delta_t(counts: Counts) -> Interval:
    ratio, error, _ = linearised(counts)
    reach = stdtrit(len(counts) - 1, 0.975) * error
    return ratio - reach, ratio + reach


def jackknife_t(counts: Counts) -> Interval:
    ratio, _, without = linearised(counts)
    units = len(counts)
    error = np.sqrt((units - 1) / units * ((without - without.mean(0)) ** 2).sum(0))
    reach = stdtrit(units - 1, 0.975) * error
    return ratio - reach, ratio + reach


def log_odds_jackknife_t(counts: Counts) -> Interval:
    """The chosen method with one degree of freedom less than units."""
    ratio, _, without = linearised(counts)
    units, odds = len(counts), logit(without.clip(1e-9, 1 - 1e-9))
    error = np.sqrt((units - 1) / units * ((odds - odds.mean(0)) ** 2).sum(0))
    reach = stdtrit(units - 1, 0.975) * error
    return expit(logit(ratio) - reach), expit(logit(ratio) + reach)


def mean_of_units_t(counts: Counts) -> Interval:
    """Batch means: the plain mean of the units' own F1."""
    part, whole = parts(counts)
    own = np.where(whole > 0, part / np.maximum(whole, 1), np.nan)
    known = (~np.isnan(own)).sum(0)
    error = np.nanstd(own, axis=0, ddof=1) / np.sqrt(known)
    reach = stdtrit(known - 1, 0.975) * error
    return np.nanmean(own, axis=0) - reach, np.nanmean(own, axis=0) + reach


def resampled(counts: Counts) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Weights (B, U) of the resamples, and the resampled numerators, denominators and ratios (B, R)."""
    part, whole = parts(counts)
    units = len(part)
    weights = np.random.default_rng(0).multinomial(units, np.full(units, 1 / units), RESAMPLES).astype(np.float64)
    sums = weights @ part, weights @ whole
    return weights, *sums, np.divide(*sums, out=np.full_like(sums[0], np.nan), where=sums[1] > 0)


def percentile(counts: Counts) -> Interval:
    low, high = np.nanquantile(resampled(counts)[3], [0.025, 0.975], axis=0)
    return low, high


def bca(counts: Counts) -> Interval:
    """Bias-corrected and accelerated (Efron 1987)."""
    ratio, _, without = linearised(counts)
    drawn = np.sort(resampled(counts)[3], axis=0)
    bias = ndtri((drawn < ratio).mean(0).clip(1 / RESAMPLES, 1 - 1 / RESAMPLES))
    away = without.mean(0) - without
    acceleration = (away**3).sum(0) / (6 * (away**2).sum(0) ** 1.5)
    ends = []
    for z in (-1.96, 1.96):
        share = ndtr(bias + (bias + z) / (1 - acceleration * (bias + z)))
        at = (share * (RESAMPLES - 1)).round().astype(int).clip(0, RESAMPLES - 1)
        ends.append(np.take_along_axis(drawn, at[None], axis=0)[0])
    return ends[0], ends[1]


def bootstrap_t(counts: Counts) -> Interval:
    ratio, error, _ = linearised(counts)
    part, whole = parts(counts)
    weights, _, sums, drawn = resampled(counts)
    spread = weights @ part**2 - 2 * drawn * (weights @ (part * whole)) + drawn**2 * (weights @ whole**2)
    errors = np.sqrt(np.maximum(spread * len(part) / (len(part) - 1), 1e-12)) / sums
    low, high = np.nanquantile((drawn - ratio) / errors, [0.025, 0.975], axis=0)
    return ratio - high * error, ratio - low * error


METHODS: dict[str, Callable[[Counts], Interval]] = {
    "chosen": interval,
    "log odds, df = units - 1": log_odds_jackknife_t,
    "jackknife, t": jackknife_t,
    "delta, t": delta_t,
    "delta, normal": delta_normal,
    "batch means, t": mean_of_units_t,
    "percentile bootstrap": percentile,
    "BCa bootstrap": bca,
    "bootstrap-t": bootstrap_t,
}


def print_coverage(rng: np.random.Generator, repetitions: int) -> None:
    print(
        f"share of {repetitions} intervals at 95 % that contain the truth, %; units are recordings of {FRAMES} frames"
    )
    print(f"{'':24}{'':>6}" + "".join(f"{name[:13]:>14}" for name in METHODS) + f"{'difference':>14}{'p < 0.05':>10}")
    for name, setting in SETTINGS.items():
        truth = np.mean([f1(c) for c in two_trackers(rng, 200, 300, **setting)])
        for units in (20, 30, 60):
            one, other = (c.sum(axis=2) for c in two_trackers(rng, units, repetitions, **setting))
            with np.errstate(all="ignore"):
                found = [method(one) for method in METHODS.values()]
                gap = differences(one, other)
            shares = [100 * np.mean((low <= truth) & (truth <= high)) for low, high in found]
            shares.append(100 * np.mean((gap.low <= 0) & (gap.high >= 0)))
            print(
                f"{name:24}{units:6}" + "".join(f"{s:14.1f}" for s in shares) + f"{100 * np.mean(gap.p < 0.05):10.1f}"
            )


def with_memory(frames: int, seconds: float, rng: np.random.Generator) -> np.ndarray:
    """An autoregressive series of unit variance, a frame a second, whose autocorrelation falls to 1/e in `seconds`."""
    memory = np.exp(-1 / seconds)
    run_in = int(10 * seconds)
    noise = np.sqrt(1 - memory**2) * rng.standard_normal(frames + run_in)
    return lfilter([1.0], [1.0, -memory], noise)[run_in:]


def one_recording(frames: int, memory_s: dict[float, float], rng: np.random.Generator) -> np.ndarray:
    """Counts (F, C) of one recording, a frame a second: traffic and difficulty have the memories `memory_s`, seconds,
    with these shares of their variance."""

    def drift() -> np.ndarray:
        return sum(np.sqrt(share) * with_memory(frames, seconds, rng) for seconds, share in memory_s.items())

    rate = 20.0 * np.exp(0.5 * drift())
    occupied = rng.poisson(rate)
    tp, fp = rng.binomial(occupied, expit(0.7 * drift())), rng.poisson(0.3 * (rate + 0.5))
    nothing = np.zeros(frames)
    return np.stack([tp, fp, occupied - tp, nothing, nothing, nothing], axis=-1).astype(np.float64)


def blocks_drawn(frames: int, memory_s: dict[float, float], repetitions: int, rng: np.random.Generator) -> list[bool]:
    """Of the recordings that are long enough for an interval by the rule of `units`, whether it holds the truth."""
    truth = np.mean([f1(one_recording(20_000, memory_s, rng)) for _ in range(60)])
    found = []
    for _ in range(repetitions):
        counts = one_recording(frames, memory_s, rng)
        block_s = shortest_block_s(autocorrelation_time(residuals(*(c[:, None] for c in parts(counts)))), None)
        units = UnitRule(("one",), block_s).units_of([np.arange(frames) * 1_000_000_000])
        low, high = interval(sum_by_unit([counts], units))
        if not np.isnan(low):
            found.append(bool(low <= truth <= high))
    return found


def print_blocks(rng: np.random.Generator, repetitions: int, out: Path | None) -> None:
    """Recordings cut into blocks as long as their own autocorrelation requires, by memory and length."""
    rows = []
    for name, memory_s in MEMORIES.items():
        for frames in (600, 1200, 2400, 4800):
            found = blocks_drawn(frames, memory_s, repetitions, rng)
            drawn = f"{100 * len(found) / repetitions:.0f}"
            rows.append((name, f"{frames}", drawn, f"{100 * np.mean(found):.0f}" if len(found) >= 10 else ""))
    table = measured_table(("memory", "recording, s", "intervals drawn, %", "of them with the truth, %"), rows)
    print(f"\n{table.markdown()}")
    write_table(out, "blocks of one recording", table, "python -m studies.intervals")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--repetitions", type=int, default=2000, help="simulated sets of recordings for each setting")
    parser.add_argument("--blocks-only", action="store_true", help="only one recording cut into blocks")
    parser.add_argument("--out", type=Path, help="results file for the table of blocks")
    arguments = parser.parse_args()
    if not arguments.blocks_only:
        print_coverage(np.random.default_rng(0), arguments.repetitions)
    print_blocks(np.random.default_rng(1), arguments.repetitions // 5, arguments.out)


if __name__ == "__main__":
    main()
