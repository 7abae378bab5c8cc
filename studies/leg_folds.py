"""Demo recording in five folds: dynamic F1 of each tracker and of persistence, with every part tested once.

`python -m studies.leg_folds [TRACKER...]` (four minutes a fold and tracker; what is in `--out` is kept). The demo
tests 36 s with thresholds from 15 s. Here every fifth of the two minutes is tested once: the thresholds are chosen on
the fifth after it, and the trackers are fitted on the three others. The referee's counts of the five folds are pooled
by the statistics of a comparison, which decide whether two minutes are enough for an interval (docs/statistics.md).
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path

from gridtrack.evaluation.runs.finished import FinishedTrial
from gridtrack.evaluation.runs.run_record import RecordingSummary
from gridtrack.evaluation.runs.summary import SUMMARY_FILE, StratumScores, read_summary
from gridtrack.evaluation.statistics.run_statistics import RunStatistics

from studies.support.comparison import compare, finished_trials, train
from studies.support.results_file import measured_table, write_table

RECORDING = Path("data/leg_tracker/leg_tracker.mcap")
FOLDS = ("0s-25s", "25s-50s", "50s-75s", "75s-100s", "100s-126s")
REFERENCE = "persistence"
PERIOD_S = 0.1
NAMES = {"f1": "F1", "pr_auc": "PR-AUC"}
SHOWN = {"f1": (0.5, 1.0), "pr_auc": (0.5, 1.0)}
"""Scores of dynamic cells, and at which horizons, s. No threshold goes into the PR-AUC."""


def compare_fold(fold: int, trackers: Sequence[str], out: Path) -> Path:
    """The folder of the comparison on this fold, with the trackers fitted on neither this fold nor the next one."""
    folder, weights = out / f"fold-{fold}", out / f"weights-{fold}"
    following = (fold + 1) % len(FOLDS)
    tested, chosen_on = (f"{RECORDING}@{FOLDS[n]}" for n in (fold, following))
    rest = [f"{RECORDING}@{stretch}" for n, stretch in enumerate(FOLDS) if n not in (fold, following)]
    for tracker in trackers:
        card = weights / tracker / f"{RECORDING.stem}.toml"
        train(card, tracker, *rest, "--validation", chosen_on, "--from-scratch")
    if not (folder / SUMMARY_FILE).exists():
        options = "--weights", weights, "--every", f"{PERIOD_S}s"
        compare([Path(tested)], Path(chosen_on), (REFERENCE, *trackers), folder, *options)
    return folder


def dynamic_scores(strata: Mapping[str, StratumScores]) -> list[str]:
    """The scores in SHOWN, as text."""
    curves = strata["dynamic"].model_dump()
    return [f"{curves[score][round(h / PERIOD_S)]:.3f}" for score, at in SHOWN.items() for h in at]


def pooled_rows(statistics: RunStatistics, labels: Sequence[str]) -> Iterator[list[str]]:
    """The row of all folds together, where two minutes are enough to pool."""
    if statistics.pools:
        yield ["all", *chain(*(dynamic_scores(statistics.pooled(label).strata) for label in labels))]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("trackers", nargs="*", default=["kalman"])
    parser.add_argument("--out", type=Path, default=Path("runs/folds"))
    parser.add_argument("--results", type=Path, help="results file, such as docs/results/trackers/model-free.json")
    given = parser.parse_args()
    labels = (REFERENCE, *given.trackers)
    recordings: dict[str, RecordingSummary] = {}
    trials: list[FinishedTrial] = []
    rows, thresholds = [], {}
    for fold, stretch in enumerate(FOLDS):
        folder = compare_fold(fold, given.trackers, given.out)
        summary = read_summary(folder)
        recordings |= summary.recordings
        trials += finished_trials(folder, summary)
        scored = {label: next(iter(summary.trackers[label].recordings.values())).strata for label in labels}
        rows.append([stretch, *chain(*map(dynamic_scores, scored.values()))])
        for label, strata in scored.items():
            chosen = strata["dynamic"].threshold[round(1.0 / PERIOD_S)]
            thresholds[f"{label}, {stretch}: threshold at 1 s"] = f"{chosen:.2f}"
    rows += pooled_rows(RunStatistics(recordings, trials, REFERENCE), labels)
    columns = [f"{label}: {NAMES[score]} {h:g} s" for label in labels for score, at in SHOWN.items() for h in at]
    table = measured_table(("dynamic cells", *columns), rows)
    print(table.markdown())
    write_table(given.results, "folds", table, "python -m studies.leg_folds", thresholds)


if __name__ == "__main__":
    main()
