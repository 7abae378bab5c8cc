"""The runner: a plan carried out by an engine, stage by stage, from its folder to its summary."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path

from gridtrack.evaluation.engines.engine import Engine, RunObserver
from gridtrack.evaluation.results.summary import RunSummary
from gridtrack.evaluation.results.trial_record import OUTCOME_FILE
from gridtrack.evaluation.runs.edited_code import without_edited
from gridtrack.evaluation.runs.engine_choice import engine_of
from gridtrack.evaluation.runs.plan import ComparisonPlan, with_copied_weights
from gridtrack.evaluation.runs.run_folder import RunFolder, refuse_other_files
from gridtrack.evaluation.runs.run_lock import run_lock
from gridtrack.evaluation.runs.stages import Stages


def run(plan: ComparisonPlan, command: Sequence[str], progress: RunObserver) -> RunSummary:
    """Run `plan` and return the summary; `command` is the command line, stored with the results.

    An interrupt (Ctrl-C) ends the trackers, keeps the scores so far, and returns the summary with `interrupted` true;
    one while the summary is made is raised, after a note.
    Raises RunError where the run's folder has another run or files of something else, or another run has locked it.
    """
    with run_lock(plan.settings.out):
        refuse_other_files(plan.settings.out)
        with engine_of(plan.settings, progress) as engine:
            return _run(with_copied_weights(plan, engine.scratch), command, progress, engine)


def _run(plan: ComparisonPlan, command: Sequence[str], progress: RunObserver, engine: Engine) -> RunSummary:
    folder = RunFolder.prepare(plan, command)
    for notice in plan.notices:
        progress.note(notice)
    stages = Stages(plan, folder.path, progress, engine)
    for name, record in without_edited(plan, folder.kept_records(), progress.note).items():
        stages.keep(name, record)
    planned = stages.planned_frames()
    _remove_records(folder.path, planned)
    progress.planned(planned, stages.planned_passes())
    interrupted = False
    try:
        stages.score_missing()
        stages.measure_priors()
        stages.measure_robustness()
        stages.measure_alone()
    except KeyboardInterrupt:
        interrupted = True
    try:
        return folder.finish(stages.all_records(), stages.notices, interrupted)
    except KeyboardInterrupt:
        progress.note("interrupted while the summary was made: the scores are kept, and --resume goes on with them")
        raise


def _remove_records(folder: Path, names: Iterable[str]) -> None:
    """Remove the records of an earlier run of the trials and oracles `names`: one that cannot start replaces nothing.

    Raises OSError.
    """
    for name in names:
        with suppress(FileNotFoundError, NotADirectoryError):
            (folder / name / OUTCOME_FILE).unlink()
