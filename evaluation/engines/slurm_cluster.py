"""A Slurm cluster: each attempt is a task of a job array, which its own job carries out or one that is still young.

submitit submits the arrays: it pickles the names of two functions, the path of a list of folders and a number, which
the job reads. What a job pickles is never read here: the reply is the JSON of an attempt, and the state of an attempt
is what Slurm tells of the job that has taken it.
"""

from __future__ import annotations

import contextlib
import io
import math
import os
import shlex
import subprocess
import sys
import time
import uuid
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import repeat
from pathlib import Path
from typing import Any, NamedTuple

from gridtrack.common.errors import ConfigurationError, one_line
from gridtrack.evaluation.engines.attempt import Attempt, EngineError
from gridtrack.evaluation.engines.cluster import TaskEnd
from gridtrack.evaluation.engines.slurm_job import Taken, in_a_job, taken, write_array
from gridtrack.evaluation.engines.slurm_settings import SlurmSettings

ARRAY_TASKS = 1000
"""Most tasks of one array: what Slurm takes where its MaxArraySize is not changed."""
ASK_S = 5.0
"""Time between two questions for the states of the jobs: Slurm answers all its users with one process."""
SILENCE_S = 600.0
"""Time without an answer of Slurm after which it counts as lost: it restarts while its jobs run on."""
ANSWER_S = 60.0
SCANCEL_IDS = 1000
MAX_SLURM_REASON = 200
MAX_TAIL_BYTES = 4096
TAKEN_AWAY = {"BOOT_FAIL", "CANCELLED", "DEADLINE", "NODE_FAIL", "PREEMPTED", "TIMEOUT"}
FAILED = {"FAILED", "OUT_OF_MEMORY"}
UNUSABLE = ("down", "drain", "fail")
"""How the states of nodes begin that run nothing new."""


class SlurmTask(NamedTuple):
    """A task of an array: its id in Slurm, the folder of its attempt, and the file with its job's error output."""

    job_id: str
    folder: Path
    log: Path


class JobState(NamedTuple):
    """What Slurm tells of a job; `status` is the wait status of its batch process."""

    state: str
    status: int
    reason: str


class SlurmCluster:
    """A TaskCluster of the nodes of a partition of the Slurm cluster that this machine submits to.

    `carry_out` is a function of an importable module, as `in_a_job` takes it. Each job has `cores` cores, and what
    `settings` asks for. Slurm itself starts no job again: the engine counts attempts.
    """

    name = "slurm"

    def __init__(self, settings: SlurmSettings, cores: int, carry_out: Callable[[str], bool]) -> None:
        """Raises ConfigurationError where submitit or Slurm is not installed, and where Slurm has no such partition."""
        try:
            import submitit
        except ImportError:
            raise ConfigurationError(
                "--engine slurm: submitit is not installed: pip install 'gridtrack[slurm]'"
            ) from None
        self._submitit: Any = submitit
        self._carry_out = carry_out
        self._job_name = f"gridtrack-{uuid.uuid4().hex[:8]}"
        self._parameters = {
            "job_name": self._job_name,
            "partition": settings.partition,
            "account": settings.account,
            "time": settings.timeout_min,  # None too: submitit's own default is five minutes
            "mem": settings.mem_gb and f"{math.ceil(settings.mem_gb * 1024)}M",
            "cpus_per_task": cores,
            "array_parallelism": ARRAY_TASKS,
            "use_srun": False,  # the process that carries out an attempt receives the signals of the job
            "wckey": None,
            "additional_parameters": {"no_requeue": True},
        }
        self._asked_s = float("-inf")
        self._answered_s = time.monotonic()
        self.capacity = sum(cpus // cores for cpus in _cpus_of_nodes(settings.partition))

    def start(self, folders: Sequence[Path]) -> list[SlurmTask]:
        """Submit arrays of the attempts in `folders`. Raises EngineError where Slurm refuses one."""
        parts = (folders[first : first + ARRAY_TASKS] for first in range(0, len(folders), ARRAY_TASKS))
        return [task for part in parts for task in self._submit(part)]

    def _submit(self, folders: Sequence[Path]) -> list[SlurmTask]:
        from submitit.core.utils import FailedJobError, FailedSubmissionError

        program = f"exec {shlex.quote(sys.executable)}"  # without a shell in between, which would get the signals
        executor = self._submitit.SlurmExecutor(folders[0].parent / "slurm", python=program)
        executor.update_parameters(**self._parameters)
        array = folders[0].with_suffix(".array.json")
        write_array(array, folders)
        try:
            # submitit prints the errors of sbatch, which are told once, below
            with contextlib.redirect_stderr(io.StringIO()):
                jobs = executor.map_array(in_a_job, repeat(self._carry_out), repeat(str(array)), range(len(folders)))
        except (FailedJobError, FailedSubmissionError) as error:
            raise EngineError(f"--engine slurm: sbatch: {_last_line(str(error))}") from None
        return [SlurmTask(job.job_id, folder, job.paths.stderr) for job, folder in zip(jobs, folders, strict=True)]

    def ended(self, tasks: Sequence[SlurmTask]) -> Mapping[SlurmTask, TaskEnd]:
        """Those of `tasks` that have ended, by the states that Slurm tells every ASK_S."""
        now = time.monotonic()
        if now < self._asked_s + ASK_S:
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
        by = {task: _taken(task) for task in tasks}
        elsewhere = [task.job_id for task in tasks if by[task].job_id != task.job_id]
        self._withdraw([job_id for job_id in elsewhere if states.get(job_id, FORGOTTEN).state == "PENDING"])
        latest: dict[str, int] = {}
        for job_id, before in by.values():
            latest[job_id] = max(before, latest.get(job_id, 0))
        ends = {
            # a job takes one attempt when it has replied to the one before
            task: OVER if before < latest[job_id] else _end_of(task, job_id, states.get(job_id, FORGOTTEN))
            for task, (job_id, before) in by.items()
        }
        return {task: end for task, end in ends.items() if end is not None}

    def cancel(self, tasks: Iterable[SlurmTask], *, force: bool) -> None:
        """End `tasks`: those that wait at once, those that run by an interrupt, or with `force` as Slurm ends jobs.

        An interrupt reaches the one process that carries out the attempt, and not its tracker. Raises EngineError.
        """
        tasks = list(tasks)
        carriers = sorted({_taken(task).job_id for task in tasks})
        if force:
            self._scancel(carriers)
        else:
            self._scancel([task.job_id for task in tasks], "--state=PENDING")
            self._scancel(carriers, "--batch", "--signal=INT")

    def close(self) -> None:
        """End what is left: also jobs of an array whose submission was interrupted. Raises EngineError."""
        self._scancel([f"--name={self._job_name}"])

    def _withdraw(self, job_ids: Sequence[str]) -> None:
        """Take jobs from the queue whose attempts other jobs have; where Slurm is silent, at the next look.

        One that has started meanwhile does nothing. With `--state` scancel ends all of an array that waits.
        """
        with contextlib.suppress(EngineError):
            self._scancel(job_ids)

    def _scancel(self, jobs: Sequence[str], *options: str) -> None:
        """Cancel jobs; those that have ended meanwhile are no error. Raises EngineError where Slurm is silent."""
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
"""Of a job that Slurm no longer knows: it forgets jobs some minutes after their end."""
OVER = TaskEnd(lost=False, reason="")


def _taken(task: SlurmTask) -> Taken:
    """Which job has the attempt of a task: its own where it waits."""
    return taken(task.folder) or Taken(task.job_id, 0)


def _end_of(task: SlurmTask, job_id: str, job: JobState) -> TaskEnd | None:
    """How a task ended that the job `job_id` has; None where it has not ended."""
    state, status, reason = job
    told = f"{state}: {reason}" if reason not in {"", "None"} else state
    killed = os.WIFSIGNALED(status)
    if state == "COMPLETED":
        return OVER
    if state == "FORGOTTEN":
        return TaskEnd(lost=not Attempt(task.folder).has_reply(), reason="Slurm no longer knows its job")
    if state in TAKEN_AWAY:
        return TaskEnd(lost=True, reason=told)
    if state in FAILED:
        ending = f"signal {os.WTERMSIG(status)}" if killed else _last_line_of(_log_of(task, job_id))
        return TaskEnd(lost=killed and state == "FAILED", reason=f"{state}: {ending or told}")
    return None


def _cpus_of_nodes(partition: str | None) -> list[int]:
    """The processor cores of each node of a partition that runs jobs; None: of the default one.

    Raises ConfigurationError.
    """
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
    """The options with which a command of Slurm prints these columns, of any width, each with a bar behind it."""
    return "--noheader", f"--Format={','.join(f'{name}:|' for name in names)}"


def _rows(*command: str) -> list[list[str]]:
    """What a command of Slurm prints, by `_columns`. Raises EngineError, FileNotFoundError, TimeoutExpired."""
    done = subprocess.run(command, capture_output=True, text=True, timeout=ANSWER_S, check=False)
    if done.returncode != 0:
        raise EngineError(f"{command[0]}: {_last_line(done.stderr)}")
    return [line.split("|")[:-1] for line in done.stdout.splitlines()]


def _last_line(text: str) -> str:
    """The last line of what a command of Slurm wrote, without the command's name and `error:` in front."""
    lines = [line for line in text.splitlines() if line.strip()] or ["no reason given"]
    return one_line(lines[-1].rpartition("error: ")[2], MAX_SLURM_REASON)


def _log_of(task: SlurmTask, job_id: str) -> Path:
    """The file with the error output of the job that has a task."""
    return task.log.with_name(task.log.name.replace(task.job_id, job_id, 1))


def _last_line_of(log: Path) -> str:
    """The last line of a task's error output; empty where there is none."""
    try:
        with log.open("rb") as file:
            file.seek(max(0, log.stat().st_size - MAX_TAIL_BYTES))
            lines = file.read(MAX_TAIL_BYTES).decode(errors="replace").splitlines()
    except OSError:
        return ""
    return one_line(lines[-1], MAX_SLURM_REASON) if lines else ""
