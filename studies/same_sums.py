"""Equality of the sums of two runs: every trial, score by score.

`python -m studies.same_sums RUN OTHER` (some seconds). For a change of the code that is meant to leave every score as
it was. Trials are matched by their folder's name. Sums must be equal to the last bit. The exit code is 1 where a trial
is missing or differs.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.runs.sums import SUMS_FILE, TrialSums

from studies.support.results_file import study_parser


def main(arguments: Sequence[str] | None = None) -> None:
    """Print one line for each trial; exit with 1 if any differs."""
    parser = study_parser(__doc__)
    parser.add_argument("run", type=Path)
    parser.add_argument("other", type=Path)
    given = parser.parse_args(arguments)
    trials = sorted(_trials(given.run) | _trials(given.other))
    differing = 0
    for trial in trials:
        found = list(differences(given.run / trial, given.other / trial))
        print(f"{trial}: {'; '.join(found) or 'equal'}")
        differing += bool(found)
    print(f"{len(trials)} trials: {f'{differing} differ' if differing or not trials else 'all sums are equal'}")
    sys.exit(bool(differing) or not trials)


def _trials(run: Path) -> set[str]:
    return {path.parent.name for path in run.glob(f"*/{SUMS_FILE}")}


def differences(one: Path, other: Path) -> Iterator[str]:
    """The scores that differ between two trials, a text for each."""
    if not all((trial / SUMS_FILE).exists() for trial in (one, other)):
        yield "missing in one of the runs"
        return
    own, others = TrialSums(one), TrialSums(other)
    if not all(np.array_equal(getattr(own.frames, n), getattr(others.frames, n)) for n in ("stamps_ns", "delivered")):
        yield "other frames"
        return
    mine, theirs = _sums_of(own), _sums_of(others)
    if missing := mine.keys() ^ theirs.keys():
        yield f"only in one: {', '.join(sorted(missing))}"
    for score in mine.keys() & theirs.keys():
        unlike = ~np.isclose(mine[score], theirs[score], rtol=0, atol=0, equal_nan=True)
        if unlike.any():
            parts = [part for p, part in enumerate(own.layouts[score].parts) if unlike[..., p].any()]
            yield f"{score}: {', '.join(parts[:5])}"


def _sums_of(trial: TrialSums) -> dict[str, NDArray[np.float64]]:
    """By score the sums (F, S, K, P) of every frame."""
    frames, steps = np.arange(len(trial.frames.stamps_ns)), range(trial.steps + 1)
    return {score: trial.by_unit(score, frames, steps, trial.layouts[score].strata).values for score in trial.scores}


if __name__ == "__main__":
    main()
