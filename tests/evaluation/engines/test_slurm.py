"""Runs on a real Slurm of two nodes on this machine: results, trials that Slurm takes away, Ctrl-C, refusals."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest

from gridtrack.common.errors import ConfigurationError
from gridtrack.evaluation.engines import slurm_cluster
from gridtrack.evaluation.engines.engine import EngineError
from gridtrack.evaluation.engines.remote import RemoteEngine
from gridtrack.evaluation.engines.slurm_cluster import SlurmCluster, SlurmSettings, SlurmTask, parse_slurm
from gridtrack.evaluation.engines.task import TaskFolder
from gridtrack.evaluation.runs.jobs import execute
from gridtrack.evaluation.runs.plan import resolve
from gridtrack.evaluation.runs.runner import run
from gridtrack.evaluation.runs.summary import read_summary
from gridtrack.evaluation.runs.trial_record import read_trial_record

from scenes.agreement import assert_agree, counted, wait_until
from scenes.programs_here import programs_here
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
def test_a_trial_that_is_taken_away_in_mid_run_changes_no_count(settings, progress, tmp_path, take_away, reason):
    """Only this trial starts again; a tracker that fails by itself does not. Other states: test_slurm_job.py."""
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
    with programs_here():
        run(resolve(settings("staged", "dies=staged:crash_at=60", out=tmp_path / "local")), (), progress)
    assert_agree(counted(tmp_path / "run"), counted(tmp_path / "local"))
    outcomes = {label: read_trial_record(tmp_path / "run" / f"{label}@room").outcome for label in ("staged", "dies")}
    assert outcomes == {"staged": "ok", "dies": "crashed"}


@needs_slurm
@pytest.mark.usefixtures("staged", "slurm")
def test_short_trials_share_jobs_and_change_no_count(settings, progress, tmp_path):
    """With more trials than nodes the two running jobs claim the waiting tasks, also after a tracker that fails."""
    rows = ("dies=staged:crash_at=60", *(f"staged{number}=staged" for number in range(4)))
    before = completed()
    run(resolve(settings(*rows, engine="slurm")), (), progress)
    assert 0 < len(completed() - before) < len(rows)
    assert not [note for note in progress.notes if "lost by the engine" in note]
    with programs_here():
        run(resolve(settings(*rows, out=tmp_path / "local")), (), progress)
    assert_agree(counted(tmp_path / "run"), counted(tmp_path / "local"))
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


def test_a_slow_scancel_is_a_note_that_says_what_to_do(progress, tmp_path, monkeypatch):
    for name, does in (("sinfo", "echo 'low*|4|idle|'"), ("scancel", "exec sleep 60")):
        (tmp_path / name).write_text(f"#!/bin/sh\n{does}\n", "utf-8")
        (tmp_path / name).chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
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
        ("mem_gb=much", "--slurm: 'mem_gb' = 'much': Input should be a valid number"),
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
    with pytest.raises(ConfigurationError, match="--address is for a Ray cluster"):
        resolve(settings("persistence", engine="slurm", address="10.0.0.1:6379"))
