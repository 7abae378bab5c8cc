"""False alarms and power of the regression gate, all criteria together, on simulated runs of twenty recordings.

`python -m studies.gate_power [--out docs/results/regression.json]` (ten minutes). The gate's own code judges each
comparison, with 18 rows: F1 and log loss of visible, dynamic and rare cells in three step bands. Aims: without a true
change at most 5 % are called worse, if the baseline has runs with the variance in question; a tracker that answers
nothing on one recording is found; a fall in F1 of 0.02 in all recordings is found in at least 95 %.

Recordings differ in difficulty and traffic, alike for both runs. The runs of a tracker differ further in each recording
(another seed) and as a whole (another training). Hits are drawn as if one in CORRELATED cells were independent.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache

import numpy as np
from scipy.special import expit

from gridtrack.evaluation.regression.confirmation import judged_again
from gridtrack.evaluation.regression.judging import VerdictRow, judged_recordings, judged_row
from gridtrack.evaluation.regression.rows import PairedRow, row_tests
from gridtrack.evaluation.regression.settings import GateSettings
from gridtrack.evaluation.scores.definition import Floats, TrialFacts
from gridtrack.evaluation.scores.f1 import F1
from gridtrack.evaluation.scores.log_loss import LOG_LOSS
from gridtrack.evaluation.scores.thresholds import half

from studies.support.results_file import measured_table, study_parser, write_table

RECORDINGS = 20
REGIONS = {"visible": (20_000.0, 1.0), "dynamic": (4_000.0, 0.5), "rare": (300.0, 0.0)}
"""Occupied cells of a recording in a step band, and the log odds of the recall in the first band."""
BANDS = {"short": 0.3, "middle": 0.0, "long": -0.5}
"""Step bands, and their addition to the log odds."""
CORRELATED = 20.0
MARKED = ("f1.f1", "dynamic", "middle")
"""The row with a fall in F1 of a given size."""
SETTINGS = GateSettings()
COMMAND = "python -m studies.gate_power"
CRITERIA = ("significant", "collapse")
F1_PARTS = F1.parts(TrialFacts(0.2, 1, ("visible",), half(1, ("visible",))))


@dataclass(frozen=True)
class Runs:
    """The variation between runs of one tracker: standard deviations of the log odds of the recall.

    `of_recording`: in each recording separately; `of_run`: of a run as a whole; `trainings`: runs in the baseline.
    """

    name: str
    of_recording: float = 0.0
    of_run: float = 0.0
    trainings: int = 1


@dataclass(frozen=True)
class Fall:
    """The judged run loses this share of its hits in the first `recordings`; None: in all of them."""

    share: float = 0.0
    recordings: int | None = None

    def in_each(self) -> Floats:
        """The lost share of each recording."""
        affected = RECORDINGS if self.recordings is None else self.recordings
        return np.where(np.arange(RECORDINGS) < affected, self.share, 0.0)


SEEDS = Runs("another seed", of_recording=0.05)
TRAININGS = Runs("another training", of_recording=0.05, of_run=0.03)
NOISY = Runs("another seed, very noisy", of_recording=0.3)


@dataclass
class Tally:
    """The number of simulated comparisons that each criterion calls worse."""

    comparisons: int = 0
    worse: int = 0
    by: dict[str, int] = field(default_factory=lambda: dict.fromkeys(CRITERIA, 0))

    def cells(self) -> list[str]:
        """Shares in per cent: each criterion, and any of them."""
        return [f"{100 * count / self.comparisons:.1f}" for count in (*self.by.values(), self.worse)]


def simulated(runs: Runs, fall: Fall, rng: np.random.Generator) -> Iterator[PairedRow]:
    """The rows of one comparison, the judged run last."""
    return (row for row, _ in simulated_twice(runs, fall, rng, seconds=0))


def simulated_twice(
    runs: Runs, fall: Fall, rng: np.random.Generator, seconds: int = 1
) -> Iterator[tuple[PairedRow, PairedRow]]:
    """The rows of one comparison, and of a second run of the judged training."""
    sides = runs.trainings + 1 + seconds
    traffic = np.exp(0.5 * rng.standard_normal(RECORDINGS))
    difficulty = 0.5 * rng.standard_normal(RECORDINGS)
    of_run = runs.of_run * rng.standard_normal((runs.trainings + 1, 1))
    of_run = np.concatenate([of_run, of_run[-1:].repeat(seconds, axis=0)])
    of_recording = runs.of_recording * rng.standard_normal((sides, RECORDINGS))
    for region, (cells, log_odds) in REGIONS.items():
        for band, harder in BANDS.items():
            own = 0.5 * runs.of_recording * rng.standard_normal((sides, RECORDINGS))
            recall = expit(log_odds + harder + difficulty + of_run + of_recording + own)
            occupied = np.maximum(np.round(cells * traffic), 1.0)
            independent = np.maximum(occupied / CORRELATED, 1.0).astype(np.int64)
            same = rng.random((1, RECORDINGS, int(independent.max())))
            drawn = np.arange(same.shape[-1]) < independent[:, None]
            found = ((same < recall[..., None]) & drawn).sum(axis=-1) / independent * occupied
            found[runs.trainings :] *= 1 - fall.in_each()
            first, second = found[: runs.trainings + 1], np.concatenate([found[: runs.trainings], found[-1:]])
            yield from zip(_rows(region, band, first, occupied), _rows(region, band, second, occupied), strict=True)


def _rows(region: str, band: str, hits: Floats, occupied: Floats) -> Iterator[PairedRow]:
    """F1 and log loss of hits (K + 1, U) among occupied cells (U,), with false alarms in a fifth of that number."""
    units, names = np.arange(RECORDINGS), tuple(f"{n:02}" for n in range(RECORDINGS))
    missed = occupied - hits
    f1 = np.zeros((*hits.shape, len(F1_PARTS)))
    for part, counts in (("tp chosen", hits), ("fp chosen", 0.2 * occupied), ("fn chosen", missed)):
        f1[..., F1_PARTS.index(part)] = counts
    losses = 0.3 * hits + 2.5 * missed + 0.02 * 20 * occupied
    loss = np.stack([losses, np.broadcast_to(21 * occupied, losses.shape)], axis=-1)
    for score, parts, sums in ((F1, F1_PARTS, f1), (LOG_LOSS, ("loss", "cells"), loss)):
        yield PairedRow("net", score, score.lead, region, band, parts, sums[:-1], sums[-1], units, names)


def judged(runs: Runs, fall: Fall, comparisons: int) -> Tally:
    """Simulated comparisons that the gate calls worse."""
    rng = np.random.default_rng(1)
    tally = Tally()
    for _ in range(comparisons):
        rows = list(simulated(runs, fall, rng))
        tests = row_tests(rows)
        over_all = [judged_row(row, test, SETTINGS) for row, test in zip(rows, tests, strict=True)]
        found = {row.criterion for row in (*over_all, *judged_recordings(rows, tests, SETTINGS))}
        tally.comparisons += 1
        tally.worse += bool(found & set(CRITERIA))
        for criterion in found & set(CRITERIA):
            tally.by[criterion] += 1
    return tally


def confirmations(comparisons: int) -> Iterator[list[str]]:
    """Shares of comparisons that are worse at first, and in a second run too."""
    for name, runs, fall in confirmed_cases():
        rng = np.random.default_rng(3)
        first = both = 0
        for _ in range(comparisons):
            rows, again = zip(*simulated_twice(runs, fall, rng), strict=True)
            tests = row_tests(rows)
            over_all = [judged_row(row, test, SETTINGS) for row, test in zip(rows, tests, strict=True)]
            collapses = judged_recordings(rows, tests, SETTINGS)
            suspects = [row for row in (*over_all, *collapses) if row.verdict == "worse"]
            first += bool(suspects)
            both += any(row.verdict == "worse" for row in judged_again(suspects, again, SETTINGS, enough_units=True))
        yield [name, *(f"{100 * count / comparisons:.1f}" for count in (first, both))]


def confirmed_cases() -> Iterator[tuple[str, Runs, Fall]]:
    """Description, runs and fall of each case with a second run."""
    for runs in (SEEDS, NOISY, TRAININGS):
        yield f"no change, {runs.name}", runs, Fall()
    for f1 in (0.005, 0.01, 0.02):
        yield f"{f1:g} F1 in all recordings", SEEDS, Fall(share_for(f1))
    for share, name in ((1.0, "no answer"), (0.5, "half of the hits")):
        yield f"{name} on 1 recording", SEEDS, Fall(share, 1)


def cases() -> Iterator[tuple[str, str, Runs, Fall]]:
    """Table, description, runs and fall of every case."""
    for runs in (SEEDS, NOISY, TRAININGS):
        for trainings in (1, 3):
            name = f"{runs.name}, baseline of {trainings}"
            yield "no change", name, Runs(name, runs.of_recording, runs.of_run, trainings), Fall()
    for f1 in (0.005, 0.01, 0.02, 0.04):
        yield "all recordings", f"{f1:g} F1", SEEDS, Fall(share_for(f1))
    for share, name in ((1.0, "no answer"), (0.5, "half of the hits")):
        for recordings in range(1, 6):
            yield "few recordings", f"{name} on {recordings}", SEEDS, Fall(share, recordings)


def stated_falls(runs: Runs, comparisons: int) -> Iterator[list[str]]:
    """Shares of falls found, of a multiple of the smallest fall that the previous comparison stated."""
    for multiple in (0.5, 1.0, 1.5, 2.0):
        rng = np.random.default_rng(2)
        found, stated = 0, []
        for _ in range(comparisons):
            stated.append(_marked(simulated(runs, Fall(), rng)).smallest)
            found += _marked(simulated(runs, Fall(share_for(multiple * stated[-1])), rng)).verdict == "worse"
        name = f"{multiple:g} times {np.mean(stated):.4f} F1 (mean)"
        yield [name, f"{100 * found / comparisons:.1f}"]


def _marked(rows: Iterator[PairedRow]) -> VerdictRow:
    """The verdict on the row MARKED."""
    every = list(rows)
    (index,) = (i for i, row in enumerate(every) if row.key[1:] == MARKED)
    return judged_row(every[index], row_tests(every)[index], SETTINGS)


@cache
def _sums() -> Floats:
    """Numerator and denominator of the F1 of MARKED, of many recordings."""
    rng = np.random.default_rng(0)
    rows = [row for _ in range(50) for row in simulated(Runs("exact"), Fall(), rng)]
    marked = [row.run.sum(axis=0) for row in rows if row.key[1:] == MARKED]
    tp, fp, fn = (np.sum(marked, axis=0)[F1_PARTS.index(f"{count} chosen")] for count in ("tp", "fp", "fn"))
    return np.array([2 * tp, 2 * tp + fp + fn])


def share_for(f1: float) -> float:
    """The share of hits to lose in all recordings so that the F1 of MARKED falls by `f1`."""
    part, whole = _sums()
    # 2 TP (1 - s) / (denominator - s TP) = F1 - f1, solved for s
    target = part / whole - f1
    return float((part - target * whole) / (part - target * part / 2))


def main(arguments: Sequence[str] | None = None) -> None:
    parser = study_parser(__doc__, "docs/results/regression.json")
    parser.add_argument("--comparisons", type=int, default=200, help="simulated comparisons of each case")
    parser.add_argument("--only-confirmed", action="store_true", help="only the effect of a second run")
    given = parser.parse_args(arguments)
    columns = ("case", "worse at first, %", "worse again, %")
    table = measured_table(columns, list(confirmations(given.comparisons)))
    print(table.markdown(), flush=True)
    write_table(given.out, "second run", table, COMMAND)
    if given.only_confirmed:
        return
    table = measured_table(("fall", "found, %"), list(stated_falls(SEEDS, given.comparisons)))
    print(table.markdown(), flush=True)
    write_table(given.out, "stated fall", table, COMMAND)
    tables: dict[str, list[list[str]]] = {}
    for title, name, runs, fall in cases():
        row = [name, *judged(runs, fall, given.comparisons).cells()]
        print(title, *row, sep="  ", flush=True)
        tables.setdefault(title, []).append(row)
    for title, rows in tables.items():
        table = measured_table(("case", "significant, %", "collapse, %", "worse, %"), rows)
        write_table(given.out, title, table, COMMAND)


if __name__ == "__main__":
    main()
