"""Demo recording in five folds: dynamic F1 of each tracker and of persistence, with every part tested once.

`python -m studies.leg_folds [TRACKER...]` (five minutes a fold and tracker; what is in `--out` is kept). The demo
tests 36 s with thresholds from 15 s. Here every fifth of the two minutes is tested once: the thresholds are chosen on
the fifth after it, and the trackers are fitted on the three others. The referee's counts of the five folds are pooled
by the statistics of a comparison, which decide whether two minutes are enough for an interval (docs/statistics.md).
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from gridtrack.evaluation.results.recording import RecordingSummary
from gridtrack.evaluation.results.summary import SUMMARY_FILE, read_summary
from gridtrack.evaluation.results.trial_summary import StratumScores
from gridtrack.evaluation.statistics.finished_trial import FinishedTrial
from gridtrack.evaluation.statistics.run_statistics import RunStatistics

from studies.support.comparison import finished_trials

RECORDING = Path("data/leg_tracker/leg_tracker.mcap")
FOLDS = ("0s-25s", "25s-50s", "50s-75s", "75s-100s", "100s-126s")
REFERENCE = "persistence"
PERIOD_S = 0.1
SHOWN = {"f1": (0.5, 1.0, 2.0), "pr_auc": (0.5, 1.0)}
"""Scores of dynamic cells, and at which horizons, s. No threshold goes into the PR-AUC."""


def gridtrack(*arguments: object) -> None:
    """Run the command line, its output sent to stderr."""
    subprocess.run([sys.executable, "-m", "gridtrack.cli", *map(str, arguments)], check=True, stdout=sys.stderr)


def compare_fold(fold: int, trackers: Sequence[str], out: Path) -> Path:
    """The folder of the comparison on this fold, with the trackers fitted on neither this fold nor the next one."""
    folder, weights = out / f"fold-{fold}", out / f"weights-{fold}"
    following = (fold + 1) % len(FOLDS)
    tested, chosen_on = (f"{RECORDING}@{FOLDS[n]}" for n in (fold, following))
    rest = [f"{RECORDING}@{stretch}" for n, stretch in enumerate(FOLDS) if n not in (fold, following)]
    for tracker in trackers:
        if not (weights / tracker / f"{RECORDING.stem}.toml").exists():
            gridtrack("train", tracker, *rest, "--validation", chosen_on, "--out", weights)
    if not (folder / SUMMARY_FILE).exists():
        rows = [word for tracker in (REFERENCE, *trackers) for word in ("--tracker", tracker)]
        chosen = "--validation", chosen_on, "--weights", weights
        gridtrack("compare", tested, *chosen, *rows, "--every", f"{PERIOD_S}s", "--out", folder)
    return folder


def dynamic_scores(strata: Mapping[str, StratumScores]) -> str:
    """The scores in SHOWN, as text."""
    curves = strata["dynamic"].model_dump()
    return "  ".join(f"{curves[score][round(h / PERIOD_S)]:.3f}" for score, at in SHOWN.items() for h in at)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("trackers", nargs="*", default=["static-map", "kalman"])
    parser.add_argument("--out", type=Path, default=Path("runs/folds"))
    arguments = parser.parse_args()
    recordings: dict[str, RecordingSummary] = {}
    trials: list[FinishedTrial] = []
    print("dynamic cells:", "; ".join(f"{score} at {', '.join(f'{h:g} s' for h in at)}" for score, at in SHOWN.items()))
    for fold, stretch in enumerate(FOLDS):
        folder = compare_fold(fold, arguments.trackers, arguments.out)
        summary = read_summary(folder)
        recordings |= summary.recordings
        trials += finished_trials(folder, summary)
        for label, row in summary.trackers.items():
            for scores in row.recordings.values():
                print(f"{stretch:>10}  {label:14} {dynamic_scores(scores.strata)}")
    print_pooled(RunStatistics(recordings, trials, REFERENCE))


def print_pooled(statistics: RunStatistics) -> None:
    """Print the scores over all folds, and the paired differences of dynamic F1."""
    for label in statistics.labels if statistics.pools else []:
        print(f"{'all':>10}  {label:14} {dynamic_scores(statistics.pooled(label).strata)}")
    for difference in statistics.differences():
        for test in difference.headline:
            if test.stratum == "dynamic":
                span = difference.interval or f"[{test.f1_low:.3f}, {test.f1_high:.3f}]"
                print(f"{difference.tracker} less {REFERENCE} at {test.horizon_s:g} s: {test.f1:+.3f} {span}")


if __name__ == "__main__":
    main()
