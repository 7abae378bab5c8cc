"""The tasks that a Slurm job runs, and the jobs that an array still needs: with stand-ins for Slurm's commands."""

from __future__ import annotations

import json

import pytest

from gridtrack.evaluation.engines import slurm_cluster
from gridtrack.evaluation.engines.remote import TaskEnd
from gridtrack.evaluation.engines.slurm_cluster import (
    Claim,
    SlurmCluster,
    SlurmSettings,
    SlurmTask,
    claim_of,
    run_in_job,
)
from gridtrack.evaluation.runs.jobs import execute

pytest.importorskip("submitit", reason="submitit is not installed: pip install 'gridtrack[slurm]'")
DONE = TaskEnd(lost=False, reason="")


@pytest.fixture
def folders(tmp_path):
    """The folders of an array of five tasks."""
    folders = [tmp_path / f"{number}.1" for number in range(5)]
    for folder in folders:
        folder.mkdir()
    (tmp_path / "array.json").write_text(json.dumps([str(folder) for folder in folders]))
    return folders


@pytest.fixture
def job(folders, monkeypatch):
    """`job(number, during)` runs a job of the array, calling `during` with each task; it returns their numbers."""

    def run(number, during=lambda done: True):
        monkeypatch.setenv("SLURM_ARRAY_JOB_ID", "7")
        monkeypatch.setenv("SLURM_ARRAY_TASK_ID", str(number))
        done = []

        def run_task(folder):
            done.append([str(one) for one in folders].index(folder))
            return during(done[-1])

        run_in_job(run_task, str(folders[0].parent / "array.json"), number)
        return done

    monkeypatch.setattr(slurm_cluster.signal, "signal", lambda *_: None)
    return run


@pytest.fixture
def cluster(tmp_path, monkeypatch):
    """A cluster with the states of its jobs in the file `states`; the arguments of scancel go to `cancelled`."""
    for name, does in (
        ("sinfo", "echo 'low*|4|idle|'"),
        ("squeue", f"cat {tmp_path}/states"),
        ("scancel", f'echo "$@" >> {tmp_path}/cancelled'),
    ):
        (tmp_path / name).write_text(f"#!/bin/sh\n{does}\n", "utf-8")
        (tmp_path / name).chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    monkeypatch.setattr(slurm_cluster, "SLURM_POLL_S", 0.0)
    return SlurmCluster(SlurmSettings(), 1, execute)


def tasks_of(folders, *states):
    """The tasks of the array, with these states of their jobs."""
    lines = (f"7_{number}|{state}|0|None|" for number, state in enumerate(states))
    (folders[0].parent / "states").write_text("\n".join(lines), "utf-8")
    return [SlurmTask(f"7_{number}", folder, folder / "log") for number, folder in enumerate(folders)]


def test_a_young_job_claims_further_tasks_from_the_end_of_its_array(job, folders):
    assert job(1) == [1, 4, 3, 2, 0]
    claims = [claim_of(task) for task in tasks_of(folders)]
    assert claims == [Claim("7_1", count) for count in (4, 0, 3, 2, 1)]


def test_a_task_is_run_by_one_job(job, folders):
    others = []

    def beside(number):
        if number == 4:
            others.extend(job(0))
        return True

    assert job(1, beside) == [1, 4]
    assert others == [0, 3, 2]


def test_a_job_does_nothing_if_another_has_claimed_its_task_or_the_host_has_abandoned_it(job, folders):
    assert job(3, lambda number: number != 4) == [3, 4]
    assert job(4) == []
    folders[2].rename(folders[2].with_name("gone"))
    assert job(2) == []
    assert claim_of(tasks_of(folders)[0]) == Claim("7_0", 0), "it waits for its own job"


def test_a_job_claims_no_further_task_after_an_interrupt_or_a_minute(job, monkeypatch):
    assert job(0, lambda number: False) == [0]
    monkeypatch.setattr(slurm_cluster, "YOUNG_S", -1.0)
    assert job(1) == [1]


@pytest.mark.parametrize("state", sorted(slurm_cluster.ENDED_BY_SLURM))
def test_a_task_has_ended_when_its_job_claims_another_and_is_lost_with_the_job_that_runs_it(
    job, folders, cluster, state
):
    """So has a failed task: its job continues, so the tracker itself failed, which is never retried."""
    job(0, lambda number: number != 3)
    tasks = tasks_of(folders, state, "RUNNING", "PENDING", "PENDING", "COMPLETED")
    ends = cluster.ended(tasks)
    assert ends == {tasks[0]: DONE, tasks[4]: DONE, tasks[3]: TaskEnd(lost=True, reason=state)}
    assert (folders[0].parent / "cancelled").read_text().split() == ["--quiet", "7_3"]


def test_an_interrupt_reaches_the_job_that_runs_a_task(job, folders, cluster):
    job(0, lambda number: number != 4)
    tasks = tasks_of(folders, "RUNNING", "RUNNING", "PENDING", "PENDING", "PENDING")
    cluster.cancel(tasks[3:], force=False)
    waiting, interrupted = (folders[0].parent / "cancelled").read_text().splitlines()
    assert waiting == "--quiet --state=PENDING 7_3 7_4"
    assert interrupted == "--quiet --batch --signal=INT 7_0 7_3"
    cluster.cancel(tasks[4:], force=True)
    assert (folders[0].parent / "cancelled").read_text().splitlines()[2:] == ["--quiet 7_0"]
