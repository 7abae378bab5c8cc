"""Trials that `--resume` keeps, without those of a tracker whose code was edited since they ran."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory

from gridtrack.evaluation.hosting.outcome import TrialEnded
from gridtrack.evaluation.results.trial_record import TrialRecord, code_differs
from gridtrack.evaluation.runs.plan import ComparisonPlan, Trial
from gridtrack.trackers import registry

Note = Callable[[str], None]


def without_edited(plan: ComparisonPlan, kept: Mapping[str, TrialRecord], note: Note) -> dict[str, TrialRecord]:
    """`kept` by the names of trials, without those of other code than their tracker has now; `note` tells of them.

    Each tracker of the user is started once. Those of gridtrack itself are not: `versions` of a run says which they
    were. What a tracker that no longer starts has scored is kept.
    """
    trials = [trial for trial in plan.trials if trial.name in kept and _of_user(trial)]
    edited: set[str] = set()
    for label in dict.fromkeys(trial.label for trial in trials):
        own = [trial for trial in trials if trial.label == label]
        now = _code_now(own[0], note)
        other = [trial.name for trial in own if code_differs(kept[trial.name].code_sha256, now)]
        if other:
            note(f"{label}: its code was edited since it ran: {len(other)} of its trials run again")
        edited |= set(other)
    return {name: record for name, record in kept.items() if name not in edited}


def _of_user(trial: Trial) -> bool:
    return trial.launch.external or not registry.find(trial.launch.name).value.startswith("gridtrack.")


def _code_now(trial: Trial, note: Note) -> str:
    """The hash of the code that starts; "" where none does."""
    with TemporaryDirectory(prefix="gridtrack-code-") as folder:
        try:
            with trial.tracker_process(Path(folder, "stderr.log")) as process:
                return process.description.code_sha256
        except TrialEnded as ended:
            note(f"{trial.label}: what it has scored is kept, but it does not start now: {ended}")
            return ""
