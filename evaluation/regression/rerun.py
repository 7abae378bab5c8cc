"""A second run of chosen trials, as a run's record describes them: same inputs, settings and seed, new processes.

The record may come from somebody else, so it starts no program: programs come from the `trackers.toml` that the user
names now, and each tracker is printed before it starts.
"""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from gridtrack.common.config import validated
from gridtrack.evaluation.regression.measurement import Measurement, Unmeasured
from gridtrack.evaluation.regression.measuring import measure_run
from gridtrack.evaluation.runs.plan import ComparisonPlan, Trial, resolve
from gridtrack.evaluation.runs.run_folder import versions
from gridtrack.evaluation.runs.run_record import RunRecord, read_run_record
from gridtrack.evaluation.runs.runner import RunObserver, run
from gridtrack.evaluation.runs.settings import CompareSettings
from gridtrack.evaluation.runs.trial_record import code_differs, read_trial_record

Trials = Mapping[str, frozenset[str]]
"""The names of recordings by label."""


def run_again(
    folder: Path,
    trials: Trials,
    like: Measurement,
    latency: bool,
    progress: RunObserver,
    foreign: Sequence[str],
    trackers_toml: Path | None,
) -> list[Measurement]:
    """Run `trials` of the run in `folder` again; a measurement for each set of recordings, in the units of `like`.

    `latency`: measure times too. `foreign`: names of scores of other packages. Programs come from `trackers_toml`. The
    files of the second run are removed. Raises Unmeasured if a trial cannot be repeated, or fails.
    """
    record = read_run_record(folder)
    with TemporaryDirectory(prefix="gridtrack-again-") as scratch:
        plan = _plan(folder, record, Path(scratch), latency, foreign, trackers_toml)
        measured = []
        for number, recordings in enumerate(dict.fromkeys(trials.values())):
            labels = [label for label, own in trials.items() if own == recordings]
            part = _part(plan, labels, recordings, Path(scratch) / str(number))
            _require_unchanged(record, part)
            for line in dict.fromkeys(map(_start_line, part.trials)):
                progress.note(line)
            if run(part, record.command, progress).interrupted:
                raise Unmeasured(["the second run was interrupted"])
            measured.append(measure_run(part.settings.out, like, foreign))
            if reasons := list(_edited(folder, part)):
                raise Unmeasured(reasons)
    return measured


def plan_again(folder: Path, scratch: Path, trackers_toml: Path | None) -> ComparisonPlan:
    """The plan of the run in `folder`, with the programs of `trackers_toml`. It writes into `scratch`.

    Raises Unmeasured if something changed.
    """
    record = read_run_record(folder)
    plan = _plan(folder, record, scratch, latency=False, foreign=(), trackers_toml=trackers_toml)
    _require_unchanged(record, plan)
    return plan


def why_edited(label: str, *sha256s: str) -> str:
    """The reason not to compare a tracker if its hashes of code differ; else empty."""
    return f"{label}: the tracker's code was edited since the run: compare again" if code_differs(*sha256s) else ""


def _start_line(trial: Trial) -> str:
    options = "".join(f" {name}={value}" for name, value in sorted(trial.selection.options.items()))
    return f"{trial.label}: starts again: {trial.selection.name}{options} ({shlex.join(trial.launch.argv)})"


def _plan(
    folder: Path,
    record: RunRecord,
    scratch: Path,
    latency: bool,
    foreign: Sequence[str],
    trackers_toml: Path | None,
) -> ComparisonPlan:
    """The plan of the whole run: it measures scores and, with `latency`, times.

    Foreign scores and programs come from the user's options, because the record may come from somebody else.
    """
    given = record.settings.model_dump(mode="json")
    if "recordings" not in given:
        raise Unmeasured([f"{folder}: its record has no settings, so it cannot be run again: compare again"])
    if given["trackers_toml"] and trackers_toml is None:
        raise Unmeasured(
            [
                f"{folder}: it ran programs of {given['trackers_toml']}, and a run's record starts none: name your own"
                " file with --trackers-toml"
            ]
        )
    only_scores = {
        "deadline": False,
        "degrade": None,
        "follow": False,
        "resume": False,
        "engine": "local",
        "address": None,
        "scores": tuple(foreign),
        "trackers_toml": trackers_toml if given["trackers_toml"] else None,
    }
    settings = {**given, **only_scores, "out": scratch, "latency": latency}
    return resolve(validated(CompareSettings, settings, f"{folder}: its settings"))


def _part(plan: ComparisonPlan, labels: Sequence[str], recordings: frozenset[str], out: Path) -> ComparisonPlan:
    return replace(
        plan,
        settings=plan.settings.model_copy(update={"out": out}),
        splits=tuple(split for split in plan.splits if split.name in recordings),
        trials=tuple(t for t in plan.trials if t.label in labels and t.split.name in recordings),
    )


def _require_unchanged(record: RunRecord, plan: ComparisonPlan) -> None:
    if reasons := list(_differences(record, plan)):
        raise Unmeasured(reasons)


def _differences(record: RunRecord, plan: ComparisonPlan) -> Iterator[str]:
    """A reason for each difference between the plan and the run."""
    now = plan.identity()
    if record.configuration.scoring_rules != now.scoring_rules:
        yield "forecasts are scored by other rules now than in the run: compare again"
    for name, recording in now.recordings.items():
        if record.configuration.recordings.get(name) != recording:
            yield f"{name}: the recording changed since the run, so it cannot be run again: compare again"
    for trial in plan.trials:
        then = record.weights.get(trial.name)
        same_weights = (then.sha256 if then else "") == (trial.weights.sha256 if trial.weights else "")
        if record.configuration.trials.get(trial.name) != now.trials[trial.name] or not same_weights:
            yield f"{trial.name}: the tracker or its weights changed since the run: compare again"
    installed = versions()
    for name in sorted(installed.keys() | record.versions.keys()):
        old, new = (side.get(name, "none") for side in (record.versions, installed))
        if old != new:
            yield f"{name} was {old} in the run and is {new} now: compare again"


def _edited(folder: Path, part: ComparisonPlan) -> Iterator[str]:
    """A reason for each tracker that was edited since the run in `folder`, as far as its hash is known."""
    reasons: list[str] = []
    for trial in part.trials:
        records = [read_trial_record(run / trial.name) for run in (folder, part.settings.out)]
        reasons.append(why_edited(trial.label, *(record.code_sha256 if record else "" for record in records)))
    yield from dict.fromkeys(filter(None, reasons))
