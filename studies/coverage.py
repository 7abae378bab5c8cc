"""Coverage of intervals and tests on drawn recordings: blocks of time, recordings of unlike size, several trainings.

`python -m studies.coverage` (eight minutes; `--out docs/results/statistics.json` keeps the tables).

Blocks: one recording is cut into blocks as long as its own autocorrelation requires. Its traffic and difficulty drift
with one or two time constants. Aim: 93 to 97 % of the intervals contain the truth.

Unlike sizes: how often do two trackers of equal F1 over all possible recordings differ significantly, if one of them is
better on large recordings? With a long tail of sizes a sample lacks the largest recordings, which decide. Nominal: 5 %.

Trainings: differences between two equal trackers with several trainings, on 20 recordings. Each recording has its
difficulty, each tracker recordings that it finds hard, each training its level and its own error on each recording. The
rows of a tracker, its strata and horizons, share a part of each deviation or all of it; in the latter case nine rows
contain no more information on the spread between trainings than one. Aim: 93 to 97 %. Where trainings differ on single
recordings alone, their disagreement is counted twice: how much longer are the intervals?

Contact foresight: a rate at a fixed rate of false alarms is not smooth in the sums. Two trackers give risks to the same
paths in recordings of unlike size, level of risk and difficulty. Beside the jackknife stands the bootstrap over
recordings (2.5 and 97.5 % of resamples). Aim: 93 to 97 %.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.signal import lfilter
from scipy.special import expit

from gridtrack.evaluation.scores.cells import PROBABILITY_BINS, PROBABILITY_EDGES
from gridtrack.evaluation.scores.contact_foresight import CONTACT_FORESIGHT
from gridtrack.evaluation.scores.definition import Ratio, Sums, TrialFacts, value_of
from gridtrack.evaluation.scores.thresholds import half
from gridtrack.evaluation.statistics.jackknife import (
    degrees_of_freedom,
    difference,
    interval,
    ratio_replicates,
    replicates,
)
from gridtrack.evaluation.statistics.trainings import Trainings, training_differences
from gridtrack.evaluation.statistics.units import (
    UnitRule,
    autocorrelation_time,
    residuals,
    shortest_block_s,
)

from studies.support.results_file import ResultTable, measured_table, study_parser, write_table

COMMAND = "python -m studies.coverage"
Floats = NDArray[np.float64]
Counts = NDArray[np.int64]

MEMORIES = {
    "2 s": {2.0: 1.0},
    "5 s": {5.0: 1.0},
    "40 s": {40.0: 1.0},
    "2 s, and 40 s with a tenth of the variance": {2.0: 0.9, 40.0: 0.1},
    "2 s, and 40 s with a third of the variance": {2.0: 2 / 3, 40.0: 1 / 3},
}
"""Time constants of the drift in one recording, seconds, and their shares of its variance."""
LENGTHS_S = (600, 1200, 2400, 4800)

SPREADS = (0.0, 0.5, 1.0, 1.5)
"""Standard deviations of the log number of occupied cells in a recording."""
SIZED_UNITS = (20, 60)
SLOPE = 0.3
"""Growth of the log odds of the recall of one tracker with the log size."""
CELLS, DIFFICULTY, OF_TRACKER, FALSE_ALARMS = 300.0, 0.5, 0.3, 0.4

UNITS, ROWS, OCCUPIED, RECALL = 20, 9, 1000.0, 0.6
OF_RECORDING, TRACKER_ON_RECORDING, TRAINING_ON_RECORDING = 0.04, 0.01, 0.005
"""Standard deviations of recall."""
LEVELS = (0.0, 0.002, 0.005, 0.01)
"""Standard deviations of the level of a training; the standard error over 20 recordings alone is about 0.004."""
TRAININGS = (3, 5)
IN_COMMON = (0.64, 1.0)
"""The share of the variance of each deviation that the rows of a tracker have in common."""

CONTACT_UNITS, CONTACTS, CLEARS = (20, 40, 100), (5.0, 20.0), 400.0
"""Recordings, and mean numbers of contacts and of clear paths in one."""
CONTACT_SIZE, CONTACT_LEVEL, CONTACT_DIFFICULTY, CONTACT_OF_TRACKER = 0.5, 0.5, 0.7, 0.3
"""Standard deviations between recordings: of the log size, and of log odds of risks (of all, of contacts, of the
contacts of one tracker)."""
CONTACT_MERITS = (2.5, 2.2)
"""Log odds by which each tracker's risks of contacts exceed those of clear paths."""
RESAMPLES = 200
BATCHES = 50
"""Of a thousand recordings, for the true value."""
CONTACT_PARTS = CONTACT_FORESIGHT.parts(TrialFacts(0.2, 1, ("dynamic",), half(1, ("dynamic",))))


def f1_of(tp: Counts, fp: Counts, occupied: Counts) -> Ratio:
    """F1 of counts of cells (...)."""
    return Ratio((2 * tp).astype(np.float64), (tp + fp + occupied).astype(np.float64), counted=True)


def pooled(f1: Ratio) -> Floats:
    """F1 (...) of all units (U, ...) together."""
    value: Floats = f1.part.sum(axis=0) / f1.whole.sum(axis=0)
    return value


def drift(frames: int, memory_s: Mapping[float, float], rng: np.random.Generator) -> Floats:
    """A series of unit variance, a frame per second: a sum of autoregressive series with these time constants."""
    total = np.zeros(frames)
    for seconds, share in memory_s.items():
        memory, run_in = np.exp(-1 / seconds), int(10 * seconds)
        noise = np.sqrt(1 - memory**2) * rng.standard_normal(frames + run_in)
        total += np.sqrt(share) * lfilter([1.0], [1.0, -memory], noise)[run_in:]
    return total


def one_recording(frames: int, memory_s: Mapping[float, float], rng: np.random.Generator) -> Ratio:
    """F1 (F,) of one recording, a frame per second."""
    rate = 20.0 * np.exp(0.5 * drift(frames, memory_s, rng))
    occupied = rng.poisson(rate)
    tp, fp = rng.binomial(occupied, expit(0.7 * drift(frames, memory_s, rng))), rng.poisson(0.3 * (rate + 0.5))
    return f1_of(tp, fp, occupied)


def blocks_hold(frames: int, memory_s: Mapping[float, float], draws: int, rng: np.random.Generator) -> list[bool]:
    """Whether the interval contains the truth, of each drawn recording that is long enough for an interval."""
    truth = np.mean([pooled(one_recording(20_000, memory_s, rng)) for _ in range(60)])
    found = []
    for _ in range(draws):
        f1 = one_recording(frames, memory_s, rng)
        block_s = shortest_block_s(autocorrelation_time(residuals(f1.part[:, None], f1.whole[:, None])), None)
        (units,) = UnitRule(("one",), block_s).units_of([np.arange(frames) * 1_000_000_000])
        part, whole = (np.bincount(units, side).astype(np.float64) for side in (f1.part, f1.whole))
        by_unit = Ratio(part, whole, counted=True)
        drawn = interval(ratio_replicates(by_unit), "odds")
        if not np.isnan(drawn.low):
            found.append(bool(drawn.low <= truth <= drawn.high))
    return found


def block_table(draws: int) -> ResultTable:
    """Coverage by memory and length of the recording."""
    rng, rows = np.random.default_rng(1), []
    for (name, memory_s), frames in product(MEMORIES.items(), LENGTHS_S):
        held = blocks_hold(frames, memory_s, draws, rng)
        shares = f"{100 * len(held) / draws:.0f}", f"{100 * np.mean(held):.0f}" if len(held) >= 10 else ""
        rows.append((name, str(frames), *shares))
    return measured_table(("memory", "recording, s", "intervals drawn, %", "of them with the truth, %"), rows)


def of_unlike_size(rng: np.random.Generator, shape: tuple[int, ...], spread: float, level: float) -> list[Ratio]:
    """F1 (U, R) of two trackers on the same recordings; `level` shifts the recall of the first everywhere."""
    log_size = spread * rng.standard_normal(shape)
    occupied = rng.poisson(CELLS * np.exp(log_size))
    difficulty = DIFFICULTY * rng.standard_normal(shape)
    found = []
    for merit in (level + SLOPE * log_size, np.zeros(shape)):
        recall = expit(difficulty + merit + OF_TRACKER * rng.standard_normal(shape))
        tp = rng.binomial(occupied, recall)
        found.append(f1_of(tp, rng.poisson(FALSE_ALARMS * CELLS * np.exp(log_size)), occupied))
    return found


def equal_level(spread: float) -> float:
    """The level at which both trackers have the same F1 over very many recordings."""

    def gap(level: float) -> float:
        one, other = of_unlike_size(np.random.default_rng(1), (200_000,), spread, level)
        return float(pooled(one) - pooled(other))

    return float(brentq(gap, -3.0, 3.0, xtol=1e-3))


def size_table(draws: int) -> ResultTable:
    """Effective number of recordings and share of significant differences, by spread of size."""
    rows = []
    for spread in SPREADS:
        level, cells = equal_level(spread), []
        for units in SIZED_UNITS:
            one, other = of_unlike_size(np.random.default_rng(2), (units, draws), spread, level)
            freedom = degrees_of_freedom(one.whole, other.whole)
            significant = difference(ratio_replicates(one), ratio_replicates(other)).p < 0.05
            cells += [f"{np.median(freedom) + 1:.0f}", f"{100 * np.mean(significant):.1f}"]
        rows.append([f"{spread:g}", *cells])
    columns = [f"{units} recordings: {one}" for units in SIZED_UNITS for one in ("effective", "significant, %")]
    return measured_table(("spread of log size", *columns), rows)


def trainings_of(
    rng: np.random.Generator,
    trainings: int,
    level: float,
    difficulty: Floats,
    in_common: float,
    *,
    learned: bool,
    on_recording: float = TRACKER_ON_RECORDING,
) -> Trainings:
    """One tracker: F1 (K, U, R) from recall, without false alarms."""
    recall = RECALL + difficulty
    for scale, shape in (
        (level, (trainings, 1)),
        (on_recording, (1, UNITS)),
        (TRAINING_ON_RECORDING, (trainings, UNITS)),
    ):
        shared, own = rng.standard_normal((*shape, 1)), rng.standard_normal((*shape, ROWS))
        recall = recall + scale * (np.sqrt(in_common) * shared + np.sqrt(1 - in_common) * own)
    tp = OCCUPIED * recall
    each = (ratio_replicates(Ratio(2 * own, own + OCCUPIED)) for own in np.broadcast_to(tp, (trainings, UNITS, ROWS)))
    return Trainings(tuple(each), learned)


def trainings_hold(trainings: int, level: float, draws: int, in_common: float, *, learned_reference: bool) -> float:
    """Share of intervals that contain 0; one training is judged by the variance over recordings alone."""
    rng, held = np.random.default_rng(trainings), 0
    for _ in range(draws):
        difficulty = OF_RECORDING * rng.standard_normal((1, UNITS, 1))
        own = trainings_of(rng, trainings, level, difficulty, in_common, learned=trainings > 1)
        of_reference = (trainings, level) if learned_reference else (1, 0.0)
        learned = learned_reference and trainings > 1
        reference = trainings_of(rng, *of_reference, difficulty, in_common, learned=learned)
        found = training_differences(own, reference)
        held += int(((found.low <= 0) & (found.high >= 0)).sum())
    return held / (draws * ROWS)


def training_table(draws: int) -> ResultTable:
    """Coverage by the spread between trainings."""
    rows = []
    for learned, in_common, level in product((True, False), IN_COMMON, LEVELS):
        held = [trainings_hold(k, level, draws, in_common, learned_reference=learned) for k in (1, *TRAININGS)]
        reference = "with trainings" if learned else "without weights"
        rows.append([reference, f"{in_common:.0%}", f"{level:g}", *(f"{share:.1%}" for share in held)])
    columns = ["reference", "rows in common", "spread of the level", "over recordings alone"]
    return measured_table([*columns, *(f"{count} trainings" for count in TRAININGS)], rows)


def counted_twice_table(draws: int) -> ResultTable:
    """Coverage, and length relative to intervals over recordings alone, if only trainings on recordings differ."""
    rows = []
    for trainings in TRAININGS:
        rng, held, longer = np.random.default_rng(trainings), 0, []
        for _ in range(draws):
            difficulty = OF_RECORDING * rng.standard_normal((1, UNITS, 1))
            own, reference = (
                trainings_of(rng, trainings, 0.0, difficulty, 1.0, learned=True, on_recording=0.0) for _ in range(2)
            )
            found, alone = training_differences(own, reference), difference(own.mean, reference.mean)
            held += int(((found.low <= 0) & (found.high >= 0)).sum())
            longer.append((found.high - found.low) / (alone.high - alone.low))
        rows.append([str(trainings), f"{held / (draws * ROWS):.1%}", f"{np.median(longer):.2f}"])
    return measured_table(("trainings", "coverage", "length, relative"), rows)


def contact_sums(rng: np.random.Generator, units: int, contacts: float) -> tuple[Sums, Sums]:
    """Sums (U, P) of contact foresight of two trackers on the same paths."""
    size = np.exp(CONTACT_SIZE * rng.standard_normal(units))
    level, difficulty = CONTACT_LEVEL * rng.standard_normal(units), CONTACT_DIFFICULTY * rng.standard_normal(units)
    one, other = (Sums(np.zeros((units, len(CONTACT_PARTS))), CONTACT_PARTS) for _ in CONTACT_MERITS)
    for name, mean, met in (("contacts", contacts, 1.0), ("clears", CLEARS, 0.0)):
        unit = np.repeat(np.arange(units), rng.poisson(mean * size))
        in_common = rng.standard_normal(unit.size)
        for sums, merit in zip((one, other), CONTACT_MERITS, strict=True):
            of_unit = level + met * (merit + difficulty + CONTACT_OF_TRACKER * rng.standard_normal(units))
            risks = expit(of_unit[unit] - 3.0 + 0.8 * in_common + 0.6 * rng.standard_normal(unit.size))
            bins = np.searchsorted(PROBABILITY_EDGES[1:-1], risks, side="right")
            counts = np.bincount(unit * PROBABILITY_BINS + bins, minlength=units * PROBABILITY_BINS)
            sums.block(name)[:] = counts.reshape(units, PROBABILITY_BINS)
    return one, other


def foreseen(sums: Sums) -> Floats:
    """Contacts foreseen (...) of sums (..., P)."""
    return value_of(CONTACT_FORESIGHT.value(sums)["foreseen"])


def contact_intervals(both: tuple[Sums, Sums], rng: np.random.Generator) -> list[tuple[float, float]]:
    """Intervals of the first tracker and of the difference of both, by the jackknife and then by the bootstrap."""
    own, other = (
        replicates(CONTACT_FORESIGHT.value, lambda one=one: [one], Sums(one.values.sum(axis=0), one.parts))["foreseen"]
        for one in both
    )
    units = len(both[0].values)
    drawn = rng.multinomial(units, np.full(units, 1 / units), RESAMPLES).astype(np.float64)
    resampled = [foreseen(Sums(drawn @ one.values, one.parts)) for one in both]
    ends = [(float(found.low), float(found.high)) for found in (interval(own, "odds"), difference(own, other))]
    for values in (resampled[0], resampled[0] - resampled[1]):
        low, high = np.quantile(values, (0.025, 0.975))
        ends.append((float(low), float(high)))
    return ends


def contact_table(draws: int) -> ResultTable:
    """Coverage and mean length of the intervals of contact foresight, by numbers of contacts and recordings."""
    rng, rows = np.random.default_rng(1), []
    for contacts, units in product(CONTACTS, CONTACT_UNITS):
        many = [[sums.values.sum(axis=0) for sums in contact_sums(rng, 1000, contacts)] for _ in range(BATCHES)]
        one, other = (float(foreseen(Sums(sums, CONTACT_PARTS))) for sums in np.sum(many, axis=0))
        ends = np.array([contact_intervals(contact_sums(rng, units, contacts), rng) for _ in range(draws)])
        truth = np.array([one, one - other, one, one - other])
        held = ((ends[..., 0] <= truth) & (truth <= ends[..., 1])).mean(axis=0)
        length = (ends[..., 1] - ends[..., 0]).mean(axis=0)
        texts = (f"{100 * share:.1f} ({own:.3f})" for share, own in zip(held, length, strict=True))
        rows.append([f"{contacts:g}", str(units), f"{one:.3f}", f"{one - other:.3f}", *texts])
    columns = ("contacts in a recording", "recordings", "foreseen", "difference")
    methods = ("jackknife, % (length)", "difference", "bootstrap, % (length)", "difference")
    return measured_table((*columns, *methods), rows)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = study_parser(__doc__, "docs/results/statistics.json")
    parser.add_argument(
        "--draws", type=int, default=4000, help="of the sizes; a tenth for blocks and contacts, a quarter for trainings"
    )
    given = parser.parse_args(arguments)
    tables = {
        "blocks of one recording": block_table(given.draws // 10),
        "unlike sizes": size_table(given.draws),
        "trainings": training_table(given.draws // 4),
        "counted twice": counted_twice_table(given.draws // 4),
        "contact foresight": contact_table(given.draws // 10),
    }
    for name, table in tables.items():
        print(f"{name}\n{table.markdown()}\n")
        write_table(given.out, name, table, COMMAND)


if __name__ == "__main__":
    main()
