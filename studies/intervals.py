"""Coverage of the interval methods on correlated series of counts, the chosen method and the rejected ones.

`python -m studies.intervals` (two minutes). Aim: the chosen method covers 93 to 97 % at 20 units in every setting. Its
speed: `benchmarks/statistics.py`.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.special import expit, logit, ndtr, ndtri, stdtrit

from gridtrack.evaluation.statistics.jackknife import COUNTS, differences, interval
from gridtrack.evaluation.statistics.units import BLOCK_TIMES, autocorrelation_time, residuals, sum_by_unit, units_of

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


def print_blocks(rng: np.random.Generator, repetitions: int) -> None:
    """One long recording, cut into blocks as long as its own autocorrelation requires."""
    print(f"\none recording cut into blocks of {BLOCK_TIMES:g} autocorrelation times, as measured on it:")
    for frames in (4000, 8000):
        series = two_trackers(rng, 1, repetitions, frames, unlike=0.0, traffic=0.0)[0][0]
        truth, covered, units = f1(series), [], []
        stamps = np.arange(frames) * 1_000_000_000
        for counts in series:
            block = BLOCK_TIMES * autocorrelation_time(residuals(*(c[:, None] for c in parts(counts))))
            summed = sum_by_unit(counts, units_of([stamps], block)[0])
            low, high = interval(summed)
            units.append(len(summed))
            if not np.isnan(low):
                covered.append(bool(low <= truth <= high))
        print(
            f"{frames:6} frames: {np.median(units):.0f} units, long enough in {100 * len(covered) / repetitions:.0f} %,"
            f" of which {100 * np.mean(covered):.1f} % contain the truth"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--repetitions", type=int, default=2000, help="simulated sets of recordings for each setting")
    repetitions, rng = parser.parse_args().repetitions, np.random.default_rng(0)
    print_coverage(rng, repetitions)
    print_blocks(rng, repetitions // 5)


if __name__ == "__main__":
    main()
