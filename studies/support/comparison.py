"""Comparisons and trainings as the studies run them: by the commands of gridtrack; and the finished trials of a run."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

from gridtrack.evaluation.runs.finished import FinishedTrial
from gridtrack.evaluation.runs.summary import RunSummary
from gridtrack.evaluation.runs.trial_record import read_trial_record
from gridtrack.trackers.training.weights import read_card

RECORDINGS = Path("data/junction")
VALIDATION = RECORDINGS / "validation.tracks"


def compare_at_junction(trackers: Iterable[str], reference: str, out: Path, *options: str) -> None:
    """Compare `trackers` on the test recordings of the junction, in a new folder `out`; otherwise as `compare`."""
    shutil.rmtree(out, ignore_errors=True)
    compare(sorted(RECORDINGS.glob("test-*.tracks")), VALIDATION, trackers, out, "--reference", reference, *options)


def compare(
    recordings: Iterable[Path | str], validation: Path | None, trackers: Iterable[str], out: Path, *options: str | Path
) -> None:
    """Compare `trackers`, each [LABEL=]NAME[:key=value,...], on RECORDING[@range]s. Ends the program on failure.

    Without `validation`, thresholds come from the validation stretches of the recordings, or else from the cards.
    """
    rows = [word for tracker in trackers for word in ("--tracker", tracker)]
    chosen_on: list[str | Path] = ["--validation", validation] if validation else []
    gridtrack("compare", *recordings, "--no-floors", *chosen_on, *rows, "--out", out, *options)


def train(card: Path, *words: str | Path) -> bool:
    """Train with these words of the command line, if the `card` is missing or interrupted. Ends the program on failure.

    Returns whether it was trained.
    """
    if card.exists() and not read_card(card).interrupted:
        return False
    gridtrack("train", *words, "--out", card.parents[1])
    return True


def gridtrack(*words: str | Path) -> None:
    """Run a command of gridtrack in a process of its own. Ends the program on failure."""
    done = subprocess.run([sys.executable, "-m", "gridtrack.cli", *map(str, words)], check=False)
    if done.returncode:
        raise SystemExit(done.returncode)


def finished_trials(folder: Path, summary: RunSummary) -> list[FinishedTrial]:
    """The trials of a comparison in `folder`."""
    found = []
    for label, row in summary.trackers.items():
        for name in row.recordings:
            trial = folder / f"{label}@{name}"
            record = read_trial_record(trial)
            assert record is not None, trial
            found.append(FinishedTrial(record, trial, row.tracker, row.options, row.points))
    return found
