"""The engine of a cluster: results as on one machine, lost machines, interrupts, and machines that differ."""

from __future__ import annotations

import os
import signal
import threading

import numpy as np
import pytest

from gridtrack.common.errors import ConfigurationError
from gridtrack.evaluation.engines.engine import EngineError, LocalEngine
from gridtrack.evaluation.engines.remote import RETRIES, RemoteEngine, TaskEnd
from gridtrack.evaluation.referee.strata import STRATA
from gridtrack.evaluation.runs import jobs, runner
from gridtrack.evaluation.runs.jobs import SharedInputs, TrialJob
from gridtrack.evaluation.runs.plan import resolve
from gridtrack.evaluation.runs.run_record import read_run_record
from gridtrack.evaluation.runs.runner import engine_of, run
from gridtrack.evaluation.runs.shared_thresholds import SharedThresholds
from gridtrack.evaluation.runs.trial_record import ThresholdsUsed, read_trial_record
from gridtrack.evaluation.scores.cells import PROBABILITY_BINS
from gridtrack.evaluation.scores.thresholds import Thresholds
from gridtrack.recordings.degradation import Degradation

from scenes.agreement import assert_agree, counted, wait_until
from scenes.process_cluster import ProcessCluster, signal_to
from scenes.room import trial_of

pytestmark = pytest.mark.usefixtures("staged")


@pytest.fixture
def cluster(monkeypatch):
    """A cluster of processes, which execute the runs of a test."""
    cluster = ProcessCluster()
    monkeypatch.setattr(runner, "engine_of", lambda settings, progress: RemoteEngine(cluster, settings.out, progress))
    return cluster


HUNG = 50 + 60
"""Frames that a trial of `staged` has delivered when it hangs."""


@pytest.fixture
def hangs(tmp_path):
    """The tracker `staged`, whose first process hangs in the test stretch."""
    return f"staged:crash_at=60,how=hangs,starts={tmp_path / 'starts'}"


def interrupt_host(trial, delivered):
    """Interrupts this process when a trial hangs."""
    if delivered == HUNG:
        os.kill(os.getpid(), signal.SIGINT)


def test_two_engines_agree_to_the_last_count(compare, progress, tmp_path, train, cluster, monkeypatch):
    """With weights, a tracker that fails, a prior and degraded input."""
    train("weights")
    requested = {"weights": tmp_path / "weights", "degrade": Degradation(frame_drop=0.2)}
    compare("static-map", "staged:crash_at=60", **requested)
    assert progress.frames == {"static-map@room": 110 + 50, "staged@room": 110 + 50}
    assert progress.delivered == {"static-map@room": 110 + 50, "staged@room": 50 + 60}
    monkeypatch.setattr(runner, "engine_of", engine_of)
    compare("static-map", "staged:crash_at=60", **requested, out=tmp_path / "local")
    assert_agree(counted(tmp_path / "run"), counted(tmp_path / "local"))
    records = {name: read_trial_record(tmp_path / "run" / f"{name}@room") for name in ("static-map", "staged")}
    assert records["static-map"].robustness is not None
    assert "prior.parquet" in records["static-map"].files
    assert records["staged"].outcome == "crashed"
    assert not [note for note in progress.notes if "lost by the engine" in note]
    assert not (tmp_path / "run" / ".engine").exists()
    one, other = (read_run_record(tmp_path / name).configuration for name in ("run", "local"))
    assert one == other


def test_a_process_reuses_the_thresholds_of_an_earlier_one(tmp_path):
    bins = np.random.default_rng(0).integers(1, PROBABILITY_BINS, (11, len(STRATA)))
    chosen = Thresholds(bins, "room.mcap@validation", STRATA)
    SharedThresholds(tmp_path).learn("a key", ThresholdsUsed.of(chosen))
    other = SharedThresholds(tmp_path)
    assert (other.known("a key"), other.known("another")) == (True, False)
    found = other.of("a key", lambda: pytest.fail("chosen again"))
    np.testing.assert_array_equal(found.bins, bins)
    assert (found.chosen_on, found.strata) == (chosen.chosen_on, chosen.strata)


@pytest.mark.parametrize(("number", "reason"), [(signal.SIGKILL, "signal 9"), (signal.SIGINT, "it was interrupted")])
def test_a_job_starts_again_with_a_note_if_its_process_is_killed_or_interrupted(
    compare, progress, cluster, hangs, number, reason
):
    """The cause may be a lost machine, or a scheduler that needs it for another user."""
    progress.on_frame = lambda trial, delivered: delivered == HUNG and signal_to(cluster.started[0], number)
    assert trial_of(compare(hangs), "staged").outcome == "ok"
    lost = f"staged@room: lost by the engine ({reason}); starts again, 1 of 2"
    assert [note for note in progress.notes if "lost" in note] == [lost]
    assert progress.frames == {"staged@room": 160}
    assert len(cluster.started) == 2


def test_a_job_that_is_lost_too_often_ends_as_failed(compare, cluster, monkeypatch):
    start = cluster.start
    monkeypatch.setattr(cluster, "start", lambda folders: [(task, task.kill())[0] for task in start(folders)])
    outcome = trial_of(compare("persistence"), "persistence")
    assert len(cluster.started) == 1 + RETRIES
    assert outcome.outcome == "failed"
    assert outcome.reason == ("lost by the engine 3 times, the last time because signal 9: compare with --resume")


def test_a_process_on_a_machine_that_was_cut_off_changes_no_result(compare, progress, tmp_path, cluster, hangs):
    """The machine is only cut off: its process continues, and notices that its task was abandoned."""
    ended, cut_off = cluster.ended, []

    def without_the_first(tasks):
        ends = dict(ended(tasks))
        if not cut_off and progress.delivered.get("staged@room") == HUNG:
            cut_off.append(tasks[0])
            ends[tasks[0]] = TaskEnd(lost=True, reason="no answer")
        return ends

    cluster.ended = without_the_first
    compare(hangs)
    cut_off[0].join(60)
    assert cut_off[0].exitcode == 0
    assert read_trial_record(tmp_path / "run" / "staged@room").outcome == "ok"
    assert not (tmp_path / "run" / ".engine").exists()


def test_an_interrupt_keeps_the_scores_and_leaves_no_process(compare, progress, tmp_path, cluster, hangs):
    trackers = ("persistence", hangs)
    done = (tmp_path / "run" / "persistence@room" / "outcome.json").exists

    def interrupt():
        wait_until(lambda: done() and progress.delivered.get("staged@room") == HUNG)
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=interrupt).start()
    summary = compare(*trackers)
    assert summary.interrupted is True
    assert trial_of(summary, "persistence").outcome == "ok"
    partial = trial_of(summary, "staged")
    assert (partial.outcome, 0 < partial.frames_scored < 16) == ("interrupted", True)
    assert not cluster.trackers()
    assert {task.exitcode for task in cluster.started} == {0}
    assert trial_of(compare(*trackers, resume=True), "staged").outcome == "ok"
    assert len(cluster.started) == 3


def test_an_interrupt_ends_a_run_of_jobs_without_a_reply(compare, progress, cluster, hangs, monkeypatch):
    """Such as jobs that still wait for a machine."""
    cancel = cluster.cancel
    monkeypatch.setattr(cluster, "cancel", lambda tasks, *, force: cancel(tasks, force=True))
    progress.on_frame = interrupt_host
    summary = compare(hangs)
    trial = trial_of(summary, "staged")
    assert (summary.interrupted, trial.outcome, trial.frames_scored) == (True, "interrupted", 0)


def test_a_cluster_that_does_not_cancel_is_a_note_and_the_scores_are_kept(
    compare, progress, tmp_path, cluster, hangs, monkeypatch
):
    cancel = cluster.cancel

    def silent(tasks, *, force):
        cancel(tasks, force=force)
        raise EngineError("no answer: some may still run")

    monkeypatch.setattr(cluster, "cancel", silent)
    monkeypatch.setattr(cluster, "close", lambda: silent([], force=True))
    progress.on_frame = interrupt_host
    trial = trial_of(compare(hangs), "staged")
    assert (trial.outcome, trial.frames_scored > 0) == ("interrupted", True)
    assert [note for note in progress.notes if "no answer" in note] == ["no answer: some may still run"]
    assert not (tmp_path / "run" / ".engine").exists()


def test_an_error_of_the_cluster_leaves_no_scratch_behind(progress, tmp_path, cluster, monkeypatch):
    monkeypatch.setattr(cluster, "close", (tmp_path / "none").read_text)
    with pytest.raises(FileNotFoundError), RemoteEngine(cluster, tmp_path, progress):
        assert (tmp_path / ".engine").exists()
    assert not (tmp_path / ".engine").exists()


def test_a_machine_with_another_recording_or_version_refuses_the_job(
    compare, settings, progress, cluster, monkeypatch, record, tmp_path
):
    plan = resolve(settings("persistence"))
    record(wall_m=2.0)
    reason = trial_of(run(plan, (), progress), "persistence").reason
    assert "room.mcap: another one on this machine" in reason
    monkeypatch.setattr(jobs, "versions", lambda: {"numpy": "0.1"})
    reason = trial_of(compare("persistence", out=tmp_path / "second"), "persistence").reason
    assert reason.endswith(
        "0.1 where the run was started: every machine of an engine has the same recordings, weights and versions"
    )


def test_orders_do_not_grow_with_the_run(settings, tmp_path, record):
    def order(count):
        several = tuple(str(record(f"r{n}", 8, {}, wall_m=3 + n / 10)) for n in range(count))
        plan = resolve(settings("persistence", "blank", recordings=several))
        shared = SharedInputs(plan.settings, lambda text: None, tmp_path)
        return TrialJob(plan.trials[0], tmp_path, shared).order()

    assert len(order(1)) == len(order(5)) < 10_000


def test_an_invalid_reply_ends_the_job_with_one_line(compare, cluster, monkeypatch):
    start = cluster.start

    def replied(folders):
        tasks = start(folders)
        for task, folder in zip(tasks, folders, strict=True):
            task.kill()
            task.join()
            (folder / "reply.json").write_text('{"record": 3}')
        return tasks

    monkeypatch.setattr(cluster, "start", replied)
    assert "reply.json: not as an engine writes it" in trial_of(compare("persistence"), "persistence").reason


def test_a_cluster_without_room_for_a_trial_is_refused(compare, cluster):
    cluster.capacity = 0
    with pytest.raises(EngineError, match="no machine of the cluster has the cores for one trial"):
        compare("persistence")


@pytest.mark.parametrize("engine", ["ray", "slurm"])
@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"latency": True}, "--latency times each tracker alone on a machine, which --engine .* cannot guarantee"),
        ({"deadline": True}, "then measure on one machine with --engine local --resume --deadline"),
        ({"jobs": 2}, "--jobs is for --engine local"),
        ({"follow": True}, "--follow runs on this machine"),
    ],
)
def test_options_that_a_cluster_does_not_support_are_refused_in_one_line(settings, engine, given, message):
    with pytest.raises(ConfigurationError, match=message):
        resolve(settings("persistence", engine=engine, **given))


@pytest.mark.parametrize("engine", ["local", "slurm"])
def test_an_address_is_refused_without_a_ray_cluster(settings, engine):
    with pytest.raises(ConfigurationError, match="--address is for a Ray cluster"):
        resolve(settings("persistence", engine=engine, address="10.0.0.1:6379"))


def test_the_scratch_folder_of_a_killed_run_is_removed(settings, progress, tmp_path):
    left = tmp_path / "run" / ".engine" / "of-a-killed-run" / "kalman.toml"
    left.parent.mkdir(parents=True)
    left.write_text("weights")
    with LocalEngine(1, tmp_path / "run", progress) as engine:
        assert not left.exists()
        assert engine.scratch.is_relative_to(tmp_path / "run")
        assert list(engine.scratch.iterdir()) == []
    assert not (tmp_path / "run" / ".engine").exists()
