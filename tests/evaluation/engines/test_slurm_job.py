"""What a job of Slurm carries out, and which jobs an array still needs: without Slurm."""

from __future__ import annotations

import pytest

from gridtrack.evaluation.engines import slurm_cluster, slurm_job
from gridtrack.evaluation.engines.cluster import TaskEnd
from gridtrack.evaluation.engines.slurm_cluster import SlurmCluster, SlurmTask
from gridtrack.evaluation.engines.slurm_job import Taken, in_a_job, taken, write_array
from gridtrack.evaluation.engines.slurm_settings import SlurmSettings
from gridtrack.evaluation.runs.worker import carry_out

pytest.importorskip("submitit", reason="submitit is not installed: pip install 'gridtrack[slurm]'")
DONE = TaskEnd(lost=False, reason="")


@pytest.fixture
def folders(tmp_path):
    """Those of an array of five attempts."""
    folders = [tmp_path / f"{number}.1" for number in range(5)]
    for folder in folders:
        folder.mkdir()
    write_array(tmp_path / "array.json", folders)
    return folders


@pytest.fixture
def job(folders, monkeypatch):
    """Run a job of the array; the numbers of the attempts that it carries out. `during` is called with each."""

    def run(number, during=lambda done: True):
        monkeypatch.setenv("SLURM_ARRAY_JOB_ID", "7")
        monkeypatch.setenv("SLURM_ARRAY_TASK_ID", str(number))
        done = []

        def carried_out(folder):
            done.append([str(one) for one in folders].index(folder))
            return during(done[-1])

        in_a_job(carried_out, str(folders[0].parent / "array.json"), number)
        return done

    monkeypatch.setattr(slurm_job.signal, "signal", lambda *_: None)
    return run


@pytest.fixture
def cluster(tmp_path, monkeypatch):
    """A cluster whose jobs are in the states of `told`; `withdrawn` are those that were taken from its queue."""
    for name, does in (
        ("sinfo", "echo 'low*|4|idle|'"),
        ("squeue", f"cat {tmp_path}/told"),
        ("scancel", f'echo "$@" >> {tmp_path}/withdrawn'),
    ):
        (tmp_path / name).write_text(f"#!/bin/sh\n{does}\n", "utf-8")
        (tmp_path / name).chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    monkeypatch.setattr(slurm_cluster, "ASK_S", 0.0)
    return SlurmCluster(SlurmSettings(), 1, carry_out)


def told(folders, *states):
    lines = (f"7_{number}|{state}|0|None|" for number, state in enumerate(states))
    (folders[0].parent / "told").write_text("\n".join(lines), "utf-8")
    return [SlurmTask(f"7_{number}", folder, folder / "log") for number, folder in enumerate(folders)]


def test_a_young_job_takes_further_attempts_from_the_end_of_its_array(job, folders):
    assert job(1) == [1, 4, 3, 2, 0]
    assert [taken(folder) for folder in folders] == [Taken("7_1", count) for count in (4, 0, 3, 2, 1)]


def test_an_attempt_is_carried_out_by_one_job(job, folders):
    others = []

    def beside(number):
        if number == 4:
            others.extend(job(0))
        return True

    assert job(1, beside) == [1, 4]
    assert others == [0, 3, 2]


def test_a_job_does_nothing_where_another_has_its_attempt_or_the_host_has_given_it_up(job, folders):
    assert job(3, lambda number: number != 4) == [3, 4]
    assert job(4) == []
    folders[2].rename(folders[2].with_name("gone"))
    assert job(2) == []
    assert taken(folders[0]) is None


def test_a_job_takes_nothing_further_after_an_interrupt_or_a_minute(job, monkeypatch):
    assert job(0, lambda number: False) == [0]
    monkeypatch.setattr(slurm_job, "YOUNG_S", -1.0)
    assert job(1) == [1]


def test_an_attempt_is_over_when_its_job_takes_another_and_is_lost_with_the_job_that_has_it(job, folders, cluster):
    """Also one that failed: its job lives on, so it was the tracker's own failure, which is never retried."""
    job(0, lambda number: number != 3)
    tasks = told(folders, "NODE_FAIL", "RUNNING", "PENDING", "PENDING", "COMPLETED")
    ends = cluster.ended(tasks)
    assert ends == {tasks[0]: DONE, tasks[4]: DONE, tasks[3]: TaskEnd(lost=True, reason="NODE_FAIL")}
    assert (folders[0].parent / "withdrawn").read_text().split() == ["--quiet", "7_3"]


def test_an_interrupt_reaches_the_job_that_has_an_attempt(job, folders, cluster):
    job(0, lambda number: number != 4)
    tasks = told(folders, "RUNNING", "RUNNING", "PENDING", "PENDING", "PENDING")
    cluster.cancel(tasks[3:], force=False)
    waiting, interrupted = (folders[0].parent / "withdrawn").read_text().splitlines()
    assert waiting == "--quiet --state=PENDING 7_3 7_4"
    assert interrupted == "--quiet --batch --signal=INT 7_0 7_3"
    cluster.cancel(tasks[4:], force=True)
    assert (folders[0].parent / "withdrawn").read_text().splitlines()[2:] == ["--quiet 7_0"]
