"""Comparisons as the studies run them: `gridtrack compare` in a folder, and its finished trials."""

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
    """Compare `trackers` on the test recordings of the junction; `out` is made anew. As `compare`."""
    shutil.rmtree(out, ignore_errors=True)
    compare(sorted(RECORDINGS.glob("test-*.tracks")), VALIDATION, trackers, out, "--reference", reference, *options)


def compare(
    recordings: Iterable[Path | str], validation: Path | None, trackers: Iterable[str], out: Path, *options: str | Path
) -> None:
    """Compare `trackers`, each [LABEL=]NAME[:key=value,...], on RECORDING[@range]s. Ends the program where it fails.

    Without `validation` thresholds are those of the recordings' own validation stretches, else of the cards.
    """
    rows = [word for tracker in trackers for word in ("--tracker", tracker)]
    chosen_on: list[str | Path] = ["--validation", validation] if validation else []
    gridtrack("compare", *recordings, *chosen_on, *rows, "--out", out, *options)


def train(card: Path, *words: str | Path) -> bool:
    """Train as `words` say, into the folder of weights that `card` is for, unless a complete training has written it.

    Whether it was trained. Ends the program where it fails.
    """
    if card.exists() and not read_card(card).interrupted:
        return False
    gridtrack("train", *words, "--out", card.parents[1])
    return True


def gridtrack(*words: str | Path) -> None:
    """Run a command of gridtrack. Ends the program where it fails."""
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
