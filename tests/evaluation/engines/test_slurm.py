"""The engine of Slurm: runs on a real Slurm of two nodes on this machine, refusals, and the tasks that a job claims."""

from __future__ import annotations

import json
import signal
import subprocess
import sys

import pytest

from gridtrack.common.errors import ConfigurationError
from gridtrack.evaluation.engines import slurm_cluster
from gridtrack.evaluation.engines.engine import EngineError
from gridtrack.evaluation.engines.remote import RemoteEngine, TaskEnd
from gridtrack.evaluation.engines.slurm_cluster import (
    Claim,
    SlurmCluster,
    SlurmSettings,
    SlurmTask,
    claim_of,
    parse_slurm,
    run_in_job,
)
from gridtrack.evaluation.engines.task import TaskFolder
from gridtrack.evaluation.runs.jobs import execute
from gridtrack.evaluation.runs.plan import resolve
from gridtrack.evaluation.runs.runner import run
from gridtrack.evaluation.runs.summary import read_summary
from gridtrack.evaluation.runs.trial_record import read_trial_record

from scenes.agreement import wait_until
from studies.support.slurm_machine import missing_programs, slurm_machine

pytest.importorskip("submitit", reason="submitit is not installed: pip install 'gridtrack[slurm]'")
needs_slurm = pytest.mark.skipif(
    bool(missing_programs()),
    reason=f"{', '.join(missing_programs())} not installed (Debian: apt install slurmctld slurmd slurm-client munge)",
)


@pytest.fixture(scope="module")
def machine():
    with slurm_machine() as configuration:
        yield configuration


@pytest.fixture
def slurm(machine, monkeypatch):
    """The commands of Slurm are about the cluster of this machine."""
    monkeypatch.setenv("SLURM_CONF", str(machine))
    monkeypatch.setattr(slurm_cluster, "SLURM_POLL_S", 0.5)
    yield
    wait_until(lambda: not jobs())


def of_slurm(*command):
    """The output lines of a command of Slurm."""
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()


def jobs():
    """Jobs that wait, run or are ending."""
    return of_slurm("squeue", "--noheader", "--array", "--format=%i")


def completed():
    """Jobs that have run to their end."""
    return set(of_slurm("squeue", "--noheader", "--array", "--states=COMPLETED", "--format=%i"))


def first_job():
    """The id and the node of the task that runs the first trial."""
    lines = of_slurm("squeue", "--noheader", "--array", "--states=RUNNING", "--format=%i %N")
    (found,) = [line.split() for line in lines if line.split()[0].endswith("_0")]
    return found


def preempted(job, node):
    """Somebody with a higher priority needs the node."""
    script = "#!/bin/sh\nsleep 1\n"
    command = ("sbatch", "--partition=high", f"--nodelist={node}", "--output=/dev/null")
    subprocess.run(command, input=script, text=True, capture_output=True, check=True)


def killed(job, node):
    of_slurm("scancel", "--batch", "--signal=KILL", job)


@needs_slurm
@pytest.mark.usefixtures("staged", "slurm")
@pytest.mark.parametrize(("take_away", "reason"), [(preempted, "PREEMPTED"), (killed, "FAILED: signal 9")])
def test_a_trial_that_is_taken_away_in_mid_run_changes_no_count(
    settings, progress, tmp_path, assert_agrees_with_local, take_away, reason
):
    """Only this trial starts again; a tracker that fails by itself does not. Other states: the last tests."""
    ended = []

    def end_its_job(trial, delivered):
        if not ended and trial == "staged@room" and delivered > 20:
            ended.append(first_job())
            take_away(*ended[0])

    progress.on_frame = end_its_job
    rows = f"staged:crash_at=60,how=hangs,starts={tmp_path / 'starts'}", "dies=staged:crash_at=60"
    run(resolve(settings(*rows, engine="slurm")), (), progress)
    assert ended
    (lost,) = [note for note in progress.notes if "lost by the engine" in note]
    assert lost.startswith(f"staged@room: lost by the engine ({reason}")
    assert lost.endswith("; starts again, 1 of 2")
    assert "engine slurm: at most 2 trials at the same time" in progress.notes
    assert_agrees_with_local("staged", "dies=staged:crash_at=60")
    outcomes = {label: read_trial_record(tmp_path / "run" / f"{label}@room").outcome for label in ("staged", "dies")}
    assert outcomes == {"staged": "ok", "dies": "crashed"}


@needs_slurm
@pytest.mark.usefixtures("staged", "slurm")
def test_short_trials_share_jobs_and_change_no_count(settings, progress, tmp_path, assert_agrees_with_local):
    """With more trials than nodes the two running jobs claim the waiting tasks, also after a tracker that fails."""
    rows = ("dies=staged:crash_at=60", *(f"staged{number}=staged" for number in range(4)))
    before = completed()
    run(resolve(settings(*rows, engine="slurm")), (), progress)
    assert 0 < len(completed() - before) < len(rows)
    assert not [note for note in progress.notes if "lost by the engine" in note]
    assert_agrees_with_local(*rows)
    assert read_trial_record(tmp_path / "run" / "dies@room").outcome == "crashed"


@needs_slurm
@pytest.mark.usefixtures("staged", "slurm")
def test_an_interrupt_leaves_no_job_and_keeps_the_scores(settings, tmp_path):
    """One trial is complete; its job has claimed the last task. Another is running, and one still waits for a node."""
    words = ["compare", *settings().recordings, "--horizon", "1s", "--every", "0.5s", "--out", str(tmp_path / "run")]
    words += ["--engine", "slurm", "--slurm", "partition=low,timeout_min=5,mem_gb=0.5", "--no-floors"]
    words += ["--tracker", "persistence", "--update-timeout", "300s", "--predict-timeout", "300s"]
    for label in ("a", "b", "c"):
        words += ["--tracker", f"{label}=staged:crash_at=60,how=hangs"]
    host = subprocess.Popen([sys.executable, "-m", "gridtrack.cli", *words])
    wait_until((tmp_path / "run" / "persistence@room" / "outcome.json").exists)
    tasks = (tmp_path / "run" / ".engine").glob
    wait_until(lambda: any(TaskFolder(path.parent).progress().delivered > 90 for path in tasks("*/*/progress.json")))
    assert jobs()
    host.send_signal(signal.SIGINT)
    assert host.wait(300) == 130
    wait_until(lambda: not jobs(), 10)
    summary = read_summary(tmp_path / "run")
    assert summary.interrupted
    assert summary.trackers["persistence"].recordings["room"].outcome == "ok"
    partial = summary.trackers["a"].recordings["room"]
    assert (partial.outcome, 0 < partial.frames_scored < 16) == ("interrupted", True)
    assert summary.trackers["b"].recordings["room"].frames_scored == 0
    assert not (tmp_path / "run" / ".engine").exists()


@needs_slurm
@pytest.mark.usefixtures("slurm")
def test_a_job_that_slurm_has_forgotten_is_lost_unless_it_has_replied(tmp_path):
    tasks = [SlurmTask(f"999999_{number}", tmp_path / str(number), tmp_path / "log") for number in range(2)]
    tasks[0].folder.mkdir()
    (tasks[0].folder / "reply.json").write_text("{}")
    ends = SlurmCluster(SlurmSettings(), 1, execute).ended(tasks)
    assert [ends[task].lost for task in tasks] == [False, True]


@needs_slurm
@pytest.mark.usefixtures("slurm")
def test_a_job_that_cannot_start_reports_the_last_line_of_its_errors(settings, progress, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", "/nowhere")
    monkeypatch.setattr(sys, "executable", "/nowhere/python")
    requested = settings("persistence", engine="slurm")
    reason = run(resolve(requested), (), progress).trackers["persistence"].recordings["room"].reason
    assert reason.startswith("FAILED: ")
    assert "/nowhere/python" in reason
    assert not [note for note in progress.notes if "lost by the engine" in note]


@needs_slurm
@pytest.mark.usefixtures("slurm")
@pytest.mark.parametrize(
    ("given", "error", "message"),
    [
        ("partition=nope", ConfigurationError, "Slurm has no partition 'nope'; known: high, low"),
        ("mem_gb=5000", EngineError, "sbatch: Batch job submission failed: "),
    ],
)
def test_requests_beyond_the_means_of_slurm_are_refused_in_one_line(settings, progress, capfd, given, error, message):
    with pytest.raises(error, match=message) as refused:
        run(resolve(settings("persistence", engine="slurm", slurm=parse_slurm(given))), (), progress)
    assert "\n" not in str(refused.value)
    assert capfd.readouterr().err == ""
    assert jobs() == []


@needs_slurm
def test_a_slurm_that_does_not_answer_is_one_line(settings, progress, tmp_path, monkeypatch):
    configuration = "ClusterName=test\nSlurmctldHost=localhost\nSlurmctldPort=9\nMessageTimeout=2\nNodeName=one\n"
    (tmp_path / "slurm.conf").write_text(f"{configuration}PartitionName=low Nodes=one\n", "utf-8")
    monkeypatch.setenv("SLURM_CONF", str(tmp_path / "slurm.conf"))
    with pytest.raises(ConfigurationError, match="--engine slurm: no Slurm cluster answers here") as refused:
        run(resolve(settings("persistence", engine="slurm")), (), progress)
    assert "\n" not in str(refused.value)


def test_a_slow_scancel_is_a_note_that_says_what_to_do(progress, tmp_path, commands, monkeypatch):
    commands(sinfo="echo 'low*|4|idle|'", scancel="exec sleep 60")
    cluster = SlurmCluster(SlurmSettings(), 1, execute)
    monkeypatch.setattr(slurm_cluster, "ANSWER_S", 0.2)
    (tmp_path / "run").mkdir()
    with RemoteEngine(cluster, tmp_path / "run", progress) as engine:
        engine.cancel()
    (note,) = [note for note in progress.notes if "scancel" in note]
    assert note.startswith("scancel: no answer for 0.2 s: jobs of this run may still wait or run")
    assert "`scancel --name=gridtrack-" in note
    assert not (tmp_path / "run" / ".engine").exists()


def test_a_machine_without_slurm_is_one_line(settings, progress, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(ConfigurationError, match="this machine has no commands of Slurm"):
        run(resolve(settings("persistence", engine="slurm")), (), progress)


def test_requests_to_slurm_have_the_names_of_submitit():
    given = parse_slurm("partition=long,account=1207,timeout_min=240,mem_gb=7.5")
    assert given == SlurmSettings(partition="long", account="1207", timeout_min=240, mem_gb=7.5)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time=3", "--slurm: there is no option 'time'; known: account, mem_gb, partition, timeout_min"),
        ("timeout_min=0", "--slurm: 'timeout_min' = 0: Input should be greater than or equal to 1"),
        ('partition="a b"', "--slurm: 'partition' = 'a b': String should match pattern"),
        ("long", "--slurm: 'long' is not of the form key=value"),
    ],
)
def test_a_wrong_request_to_slurm_is_one_line(text, message):
    with pytest.raises(ConfigurationError) as refused:
        parse_slurm(text)
    assert str(refused.value).startswith(message)


def test_requests_to_slurm_without_slurm_are_refused(settings):
    with pytest.raises(ConfigurationError, match="--slurm is for a Slurm cluster"):
        resolve(settings("persistence", engine="ray", slurm=SlurmSettings()))


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
def cluster(tmp_path, commands, monkeypatch):
    """A cluster with the states of its jobs in the file `states`; the arguments of scancel go to `cancelled`."""
    cancelled = f'echo "$@" >> {tmp_path}/cancelled'
    commands(sinfo="echo 'low*|4|idle|'", squeue=f"cat {tmp_path}/states", scancel=cancelled)
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
