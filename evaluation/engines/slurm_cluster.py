"""A Slurm cluster: each task is a job of an array; a job that is still young also runs further tasks of its array.

To start a Slurm job and import libraries takes longer than a short trial. While a job is young it therefore claims
further tasks of its array, from the end, where they would wait longest. The claim is a symbolic link in the folder of
the task, which only one job can make.

submitit submits the arrays: it pickles the names of two functions, the path of a list of folders and a number, which
the job reads. Nothing that a job pickles is read here: its reply is JSON, and its state is asked of Slurm.

Light to import: the settings of a comparison contain SlurmSettings.
"""

from __future__ import annotations

import contextlib
import io
import json
import math
import os
import shlex
import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import repeat
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import ConfigDict, Field

from gridtrack.common.config import Settings, parse_pairs, validated
from gridtrack.common.errors import ConfigurationError, one_line
from gridtrack.common.files import last_line, write_text
from gridtrack.evaluation.engines.engine import EngineError
from gridtrack.evaluation.engines.remote import TaskEnd
from gridtrack.evaluation.engines.task import TaskFolder

SLURM_OPTION = "--slurm"
SLURM_NAME = r"^[\w.+-]+$"
ARRAY_TASKS = 1000
"""Limit of the tasks of one array: Slurm's default MaxArraySize."""
YOUNG_S = 60.0
"""Age until which a job claims further tasks: long beside its start, short beside the wait for a node."""
CLAIM = "claim"
"""The symbolic link in a task's folder; its target is `JOB_ID EARLIER`."""
SLURM_POLL_S = 5.0
"""Time between two requests for the states of the jobs: Slurm answers all its users with one process."""
SILENCE_S = 600.0
"""Time without an answer after which Slurm counts as lost: it may restart while its jobs continue."""
ANSWER_S = 60.0
SCANCEL_IDS = 1000
MAX_SLURM_REASON = 200
ENDED_BY_SLURM = {"BOOT_FAIL", "CANCELLED", "DEADLINE", "NODE_FAIL", "PREEMPTED", "TIMEOUT"}
FAILED = {"FAILED", "OUT_OF_MEMORY"}
UNUSABLE = ("down", "drain", "fail")
"""Prefixes of the states of nodes that start nothing new."""


class SlurmSettings(Settings):
    """Requests of each job to Slurm, with the names of submitit; None: the default of the cluster."""

    model_config = ConfigDict(coerce_numbers_to_str=True)

    partition: str | None = Field(None, pattern=SLURM_NAME)
    account: str | None = Field(None, pattern=SLURM_NAME)
    timeout_min: int | None = Field(None, ge=1)
    """Time limit of a job, minutes."""
    mem_gb: float | None = Field(None, gt=0.0)
    """Memory of a trial: of the tracker, and of the process that scores it."""


def parse_slurm(text: str) -> SlurmSettings:
    """Read `KEY=VALUE,...`, such as `partition=long,timeout_min=240`. Raises ConfigurationError."""
    return validated(SlurmSettings, parse_pairs(text, SLURM_OPTION), SLURM_OPTION)


class SlurmTask(NamedTuple):
    """A task: the id of its job in Slurm, its folder, and the file with the error output of the job."""

    job_id: str
    folder: Path
    log: Path


class JobState(NamedTuple):
    """The state of a job in Slurm; `status` is the wait status of its batch process."""

    state: str
    status: int
    reason: str


class SlurmCluster:
    """A TaskCluster of the nodes in a partition of the Slurm cluster that this machine submits to.

    `run_task` is a function of an importable module, as for `run_in_job`. Each job has `cores` cores, and requests
    `settings`. Slurm itself restarts no job: the engine counts the starts.
    """

    name = "slurm"

    def __init__(self, settings: SlurmSettings, cores: int, run_task: Callable[[str], bool]) -> None:
        """Raises ConfigurationError if submitit or Slurm is not installed, or Slurm has no such partition."""
        try:
            import submitit
        except ImportError:
            raise ConfigurationError(
                "--engine slurm: submitit is not installed: pip install 'gridtrack[slurm]'"
            ) from None
        self._submitit: Any = submitit
        self._run_task = run_task
        self._job_name = f"gridtrack-{uuid.uuid4().hex[:8]}"
        self._parameters = {
            "job_name": self._job_name,
            "partition": settings.partition,
            "account": settings.account,
            "time": settings.timeout_min,  # None too: submitit's own default is five minutes
            "mem": settings.mem_gb and f"{math.ceil(settings.mem_gb * 1024)}M",
            "cpus_per_task": cores,
            "array_parallelism": ARRAY_TASKS,
            "use_srun": False,  # the process that runs a task receives the signals of the job
            "wckey": None,
            "additional_parameters": {"no_requeue": True},
        }
        self._asked_s = float("-inf")
        self._answered_s = time.monotonic()
        self.capacity = sum(cpus // cores for cpus in _cpus_of_nodes(settings.partition))

    def start(self, folders: Sequence[Path]) -> list[SlurmTask]:
        """Submit arrays of the tasks in `folders`. Raises EngineError if Slurm refuses one."""
        parts = (folders[first : first + ARRAY_TASKS] for first in range(0, len(folders), ARRAY_TASKS))
        return [task for part in parts for task in self._submit(part)]

    def _submit(self, folders: Sequence[Path]) -> list[SlurmTask]:
        from submitit.core.utils import FailedJobError, FailedSubmissionError

        program = f"exec {shlex.quote(sys.executable)}"  # without a shell in between, which would get the signals
        executor = self._submitit.SlurmExecutor(folders[0].parent / "slurm", python=program)
        executor.update_parameters(**self._parameters)
        array = folders[0].with_suffix(".array.json")
        write_text(array, json.dumps([str(folder) for folder in folders]))
        try:
            # submitit prints the errors of sbatch, which are reported below
            with contextlib.redirect_stderr(io.StringIO()):
                jobs = executor.map_array(run_in_job, repeat(self._run_task), repeat(str(array)), range(len(folders)))
        except (FailedJobError, FailedSubmissionError) as error:
            raise EngineError(f"--engine slurm: sbatch: {_last_line(str(error))}") from None
        return [SlurmTask(job.job_id, folder, job.paths.stderr) for job, folder in zip(jobs, folders, strict=True)]

    def ended(self, tasks: Sequence[SlurmTask]) -> Mapping[SlurmTask, TaskEnd]:
        """The tasks that have ended, by the states of their jobs, which are requested every SLURM_POLL_S."""
        now = time.monotonic()
        if now < self._asked_s + SLURM_POLL_S:
            return {}
        self._asked_s = now
        try:
            rows = _rows("squeue", f"--name={self._job_name}", "--states=all", "--array", *_columns(STATE_COLUMNS))
        except (EngineError, subprocess.TimeoutExpired) as error:
            if now > self._answered_s + SILENCE_S:
                raise EngineError(f"Slurm has not answered for {SILENCE_S / 60:g} minutes: {error}") from None
            return {}
        self._answered_s = now
        states = {job_id: JobState(state, int(status), reason) for job_id, state, status, reason in rows}
        claims = {task: claim_of(task) for task in tasks}
        elsewhere = [task.job_id for task in tasks if claims[task].job_id != task.job_id]
        self._withdraw([job_id for job_id in elsewhere if states.get(job_id, FORGOTTEN).state == "PENDING"])
        latest: dict[str, int] = {}
        for job_id, earlier in claims.values():
            latest[job_id] = max(earlier, latest.get(job_id, 0))
        ends = {
            # a job claims its next task when it has replied to the one before
            task: OVER if earlier < latest[job_id] else _end_of(task, job_id, states.get(job_id, FORGOTTEN))
            for task, (job_id, earlier) in claims.items()
        }
        return {task: end for task, end in ends.items() if end is not None}

    def cancel(self, tasks: Iterable[SlurmTask], *, force: bool) -> None:
        """End `tasks`: waiting ones at once, running ones by an interrupt, or with `force` as Slurm ends jobs.

        An interrupt reaches the process that runs the task, and not its tracker. Raises EngineError.
        """
        tasks = list(tasks)
        running = sorted({claim_of(task).job_id for task in tasks})
        if force:
            self._scancel(running)
        else:
            self._scancel([task.job_id for task in tasks], "--state=PENDING")
            self._scancel(running, "--batch", "--signal=INT")

    def close(self) -> None:
        """End all jobs, also after an interrupted submission of an array. Raises EngineError."""
        self._scancel([f"--name={self._job_name}"])

    def _withdraw(self, job_ids: Sequence[str]) -> None:
        """Remove waiting jobs from the queue if another job has claimed their task; after an error the next poll does.

        A job that has started meanwhile does nothing. With `--state` scancel would end all waiting jobs of an array.
        """
        with contextlib.suppress(EngineError):
            self._scancel(job_ids)

    def _scancel(self, jobs: Sequence[str], *options: str) -> None:
        """Cancel jobs, unless they have ended. Raises EngineError if Slurm does not answer."""
        for first in range(0, len(jobs), SCANCEL_IDS):
            self._run_scancel(*options, *jobs[first : first + SCANCEL_IDS])

    def _run_scancel(self, *arguments: str) -> None:
        command = ["scancel", "--quiet", *arguments]
        try:
            subprocess.run(command, capture_output=True, timeout=ANSWER_S, check=False)
        except subprocess.TimeoutExpired:
            raise EngineError(
                f"scancel: no answer for {ANSWER_S:g} s: jobs of this run may still wait or run; when Slurm answers,"
                f" end them with `scancel --name={self._job_name}`"
            ) from None


STATE_COLUMNS = ("JobArrayID", "State", "exit_code", "Reason")
FORGOTTEN = JobState("FORGOTTEN", 0, "")
"""The state of a job that Slurm no longer knows: it forgets jobs some minutes after their end."""
OVER = TaskEnd(lost=False, reason="")


def _end_of(task: SlurmTask, job_id: str, job: JobState) -> TaskEnd | None:
    """The end of a task that the job `job_id` has claimed; None before its end."""
    state, status, reason = job
    text = f"{state}: {reason}" if reason not in {"", "None"} else state
    killed = os.WIFSIGNALED(status)
    if state == "COMPLETED":
        return OVER
    if state == "FORGOTTEN":
        return TaskEnd(lost=not TaskFolder(task.folder).has_reply(), reason="Slurm no longer knows its job")
    if state in ENDED_BY_SLURM:
        return TaskEnd(lost=True, reason=text)
    if state in FAILED:
        ending = f"signal {os.WTERMSIG(status)}" if killed else last_line(_log_of(task, job_id), MAX_SLURM_REASON)
        return TaskEnd(lost=killed and state == "FAILED", reason=f"{state}: {ending or text}")
    return None


def _cpus_of_nodes(partition: str | None) -> list[int]:
    """The processor cores of each usable node of a partition; None: of the default one. Raises ConfigurationError."""
    try:
        rows = _rows("sinfo", "--Node", *_columns(("Partition", "CPUs", "StateLong")))
    except FileNotFoundError:
        raise ConfigurationError("--engine slurm: this machine has no commands of Slurm (sinfo, sbatch)") from None
    except (EngineError, subprocess.TimeoutExpired) as error:
        raise ConfigurationError(f"--engine slurm: no Slurm cluster answers here ({error})") from None
    names = sorted({name.removesuffix("*") for name, _, _ in rows})
    if partition is None:
        chosen = [(cpus, state) for name, cpus, state in rows if name.endswith("*")]
        problem = "Slurm has no default partition: choose one with --slurm partition=NAME"
    else:
        chosen = [(cpus, state) for name, cpus, state in rows if name.removesuffix("*") == partition]
        problem = f"Slurm has no partition '{partition}'"
    if not chosen:
        raise ConfigurationError(f"--engine slurm: {problem}; known: {one_line(', '.join(names), MAX_SLURM_REASON)}")
    return [int(cpus) for cpus, state in chosen if not state.startswith(UNUSABLE)]


def _columns(names: Iterable[str]) -> tuple[str, str]:
    """The options of a command of Slurm that print these columns, of any width, each followed by a bar."""
    return "--noheader", f"--Format={','.join(f'{name}:|' for name in names)}"


def _rows(*command: str) -> list[list[str]]:
    """The rows that a command of Slurm prints. Raises EngineError, FileNotFoundError, TimeoutExpired."""
    done = subprocess.run(command, capture_output=True, text=True, timeout=ANSWER_S, check=False)
    if done.returncode != 0:
        raise EngineError(f"{command[0]}: {_last_line(done.stderr)}")
    return [line.split("|")[:-1] for line in done.stdout.splitlines()]


def _last_line(text: str) -> str:
    """The last line of the output of a command of Slurm, without the command's name and `error:` in front."""
    lines = [line for line in text.splitlines() if line.strip()] or ["no reason given"]
    return one_line(lines[-1].rpartition("error: ")[2], MAX_SLURM_REASON)


def _log_of(task: SlurmTask, job_id: str) -> Path:
    """The error output of the job that has claimed a task."""
    return task.log.with_name(task.log.name.replace(task.job_id, job_id, 1))


class Claim(NamedTuple):
    """The job that runs a task, by its id in Slurm, and the number of tasks that it had claimed earlier."""

    job_id: str
    earlier: int


def claim_of(task: SlurmTask) -> Claim:
    """The claim on a task; its own job's while it waits, or if its folder is gone."""
    try:
        job_id, _, earlier = str((task.folder / CLAIM).readlink()).rpartition(" ")
    except FileNotFoundError:
        return Claim(task.job_id, 0)
    return Claim(job_id, int(earlier))


def run_in_job(run_task: Callable[[str], bool], array: str, number: int) -> None:
    """In a Slurm job: run the task `number` of an `array` and then further tasks, unless other jobs have claimed them.

    `run_task` returns whether nothing interrupted the task. SIGTERM interrupts it, which submitit would ignore: Slurm
    sends it before it ends a job.
    """
    young_until = time.monotonic() + YOUNG_S
    signal.signal(signal.SIGTERM, _interrupt)
    folders = [Path(name) for name in json.loads(Path(array).read_text("utf-8"))]
    count = 0
    for folder in (folders[number], *reversed(folders)):
        if _claim(folder, count):
            count += 1
            if not run_task(str(folder)) or time.monotonic() > young_until:
                return
        elif count == 0:
            return


def _claim(folder: Path, earlier: int) -> bool:
    """Claim the task in `folder`. Returns False if it is gone, or another job has claimed it."""
    # FileNotFoundError: the host has accepted the reply already, or has abandoned the task
    with contextlib.suppress(FileExistsError, FileNotFoundError):
        (folder / CLAIM).symlink_to(f"{_job_id()} {earlier}")
        return True
    return False


def _job_id() -> str:
    """The id of this job, as squeue and submitit write it."""
    array = os.environ.get("SLURM_ARRAY_JOB_ID")
    return f"{array}_{os.environ['SLURM_ARRAY_TASK_ID']}" if array else os.environ["SLURM_JOB_ID"]


def _interrupt(*_: object) -> None:
    """Interrupt once: Slurm repeats its signal while the reply is being written."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    raise KeyboardInterrupt
