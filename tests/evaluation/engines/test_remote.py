"""The engine of a cluster: results as on one machine, lost machines, interrupts, and machines that differ."""

from __future__ import annotations

import os
import signal
import threading

import numpy as np
import pytest

from gridtrack.common.errors import ConfigurationError
from gridtrack.evaluation.engines.engine import EngineError
from gridtrack.evaluation.engines.remote import RETRIES, RemoteEngine, TaskEnd
from gridtrack.evaluation.referee.strata import STRATA
from gridtrack.evaluation.runs import jobs, runner
from gridtrack.evaluation.runs.jobs import SharedInputs, TrialJob
from gridtrack.evaluation.runs.plan import resolve
from gridtrack.evaluation.runs.recipe import Recipe
from gridtrack.evaluation.runs.run_record import read_run_record
from gridtrack.evaluation.runs.runner import engine_of, run
from gridtrack.evaluation.runs.shared_thresholds import SharedThresholds
from gridtrack.evaluation.runs.train import train_tracker
from gridtrack.evaluation.runs.trial_record import read_trial_record
from gridtrack.evaluation.scores.cells import PROBABILITY_BINS
from gridtrack.evaluation.scores.thresholds import Thresholds
from gridtrack.recordings.degradation import Degradation

from scenes.agreement import assert_agree, counted, wait_until
from scenes.process_cluster import ProcessCluster

pytestmark = pytest.mark.usefixtures("staged")


@pytest.fixture
def cluster(monkeypatch):
    """A cluster of processes, on which the runs of a test are carried out."""
    cluster = ProcessCluster()
    monkeypatch.setattr(runner, "engine_of", lambda settings, progress: RemoteEngine(cluster, settings.out, progress))
    return cluster


def compare(settings, progress):
    return run(resolve(settings), ("gridtrack", "compare"), progress)


def in_thread(settings, progress):
    """A run in a thread, and what it will return."""
    done = []
    thread = threading.Thread(target=lambda: done.append(compare(settings, progress)))
    thread.start()
    return thread, done


def test_two_engines_agree_to_the_last_count(settings, progress, tmp_path, record, cluster, monkeypatch):
    """With weights, a tracker that fails, a prior and degraded input."""
    weights = tmp_path / "weights"
    train_tracker(Recipe(tracker="static-map", recordings=(str(record()),), out=weights), progress.note)
    requested = settings("static-map", "staged:crash_at=60", weights=weights, degrade=Degradation(frame_drop=0.2))
    compare(requested, progress)
    monkeypatch.setattr(runner, "engine_of", engine_of)
    compare(requested.model_copy(update={"out": tmp_path / "local"}), progress)
    assert_agree(counted(tmp_path / "run"), counted(tmp_path / "local"))
    records = {name: read_trial_record(tmp_path / "run" / f"{name}@room") for name in ("static-map", "staged")}
    assert records["static-map"].robustness is not None
    assert "prior.parquet" in records["static-map"].files
    assert records["staged"].outcome == "crashed"
    assert not [note for note in progress.notes if "lost by the engine" in note]
    assert not (tmp_path / "run" / ".engine").exists()
    one, other = (read_run_record(tmp_path / name).configuration for name in ("run", "local"))
    assert one == other


def test_thresholds_that_a_process_has_chosen_are_found_by_the_next(tmp_path):
    bins = np.random.default_rng(0).integers(1, PROBABILITY_BINS, (11, len(STRATA)))
    chosen = Thresholds(bins, "room.mcap@validation", STRATA)
    SharedThresholds(tmp_path).learn("a key", chosen.used())
    other = SharedThresholds(tmp_path)
    assert (other.known("a key"), other.known("another")) == (True, False)
    found = other.of("a key", lambda: pytest.fail("chosen again"))
    np.testing.assert_array_equal(found.bins, bins)
    assert (found.chosen_on, found.strata) == (chosen.chosen_on, chosen.strata)


def test_the_progress_of_a_trial_is_told_frame_by_frame(settings, progress, cluster):
    compare(settings("persistence"), progress)
    assert progress.frames == progress.delivered == {"persistence@room": 110 + 50}


def test_a_work_whose_process_is_killed_starts_again_and_is_told(settings, progress, cluster):
    thread, done = in_thread(settings("staged:sleep_s=0.02"), progress)
    wait_until(lambda: progress.delivered.get("staged@room", 0) > 20)
    cluster.started[0].kill()
    thread.join()
    assert done[0].trackers["staged"].recordings["room"].outcome == "ok"
    assert [note for note in progress.notes if "lost" in note] == [
        "staged@room: lost by the engine (signal 9); starts again, 1 of 2"
    ]
    assert progress.frames == {"staged@room": 160}
    assert len(cluster.started) == 2


def test_a_work_that_is_lost_again_and_again_ends_as_failed(settings, progress, cluster, monkeypatch):
    start = cluster.start
    monkeypatch.setattr(cluster, "start", lambda folders: [(task, task.kill())[0] for task in start(folders)])
    outcome = compare(settings("persistence"), progress).trackers["persistence"].recordings["room"]
    assert len(cluster.started) == 1 + RETRIES
    assert outcome.outcome == "failed"
    assert outcome.reason == ("lost by the engine 3 times, the last time because signal 9: compare with --resume")


def test_a_process_of_a_lost_machine_that_still_writes_changes_no_result(settings, progress, tmp_path, cluster):
    """The machine is only cut off: its process goes on, and notices that its attempt was given up."""
    ended, cut_off = cluster.ended, []

    def without_the_first(tasks):
        ends = dict(ended(tasks))
        if not cut_off and progress.delivered.get("staged@room", 0) > 20:
            cut_off.append(tasks[0])
            ends[tasks[0]] = TaskEnd(lost=True, reason="no answer")
        return ends

    cluster.ended = without_the_first
    compare(settings("staged:sleep_s=0.02"), progress)
    assert cut_off[0].wait(60) == 0
    assert read_trial_record(tmp_path / "run" / "staged@room").outcome == "ok"
    assert not (tmp_path / "run" / ".engine").exists()


def test_an_interrupt_keeps_the_scores_and_leaves_no_process(settings, progress, tmp_path, cluster):
    trackers = ("persistence", "staged:sleep_s=0.05")
    scored = threading.Event()
    told = progress.advanced

    def advanced(trial):
        told(trial)
        done = (tmp_path / "run" / "persistence@room" / "outcome.json").exists()
        if done and progress.delivered.get("staged@room", 0) > 50 + 60 and not scored.is_set():
            scored.set()
            os.kill(os.getpid(), signal.SIGINT)

    progress.advanced = advanced
    summary = compare(settings(*trackers), progress)
    assert summary.interrupted is True
    assert summary.trackers["persistence"].recordings["room"].outcome == "ok"
    partial = summary.trackers["staged"].recordings["room"]
    assert (partial.outcome, 0 < partial.frames_scored < 16) == ("interrupted", True)
    assert not cluster.trackers()
    assert {task.poll() for task in cluster.started} == {0}
    resumed = compare(settings(*trackers, resume=True), progress)
    assert resumed.trackers["staged"].recordings["room"].outcome == "ok"
    assert len(cluster.started) == 3


def test_an_interrupt_ends_a_run_whose_works_have_nothing_to_reply(settings, progress, cluster, monkeypatch):
    """As those that still wait for a machine."""
    cancel, told = cluster.cancel, progress.advanced
    monkeypatch.setattr(cluster, "cancel", lambda tasks, *, force: cancel(tasks, force=True))

    def advanced(trial):
        told(trial)
        if progress.delivered[trial] == 60:
            os.kill(os.getpid(), signal.SIGINT)

    progress.advanced = advanced
    summary = compare(settings("staged:sleep_s=0.05"), progress)
    trial = summary.trackers["staged"].recordings["room"]
    assert (summary.interrupted, trial.outcome, trial.frames_scored) == (True, "interrupted", 0)


def test_a_cluster_that_does_not_cancel_is_a_note_and_the_scores_are_kept(
    settings, progress, tmp_path, cluster, monkeypatch
):
    cancel, told = cluster.cancel, progress.advanced

    def silent(tasks, *, force):
        cancel(tasks, force=force)
        raise EngineError("no answer: some may still run")

    def advanced(trial):
        told(trial)
        if progress.delivered[trial] == 120:
            os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(cluster, "cancel", silent)
    monkeypatch.setattr(cluster, "close", lambda: silent([], force=True))
    progress.advanced = advanced
    trial = compare(settings("staged:sleep_s=0.05"), progress).trackers["staged"].recordings["room"]
    assert (trial.outcome, trial.frames_scored > 0) == ("interrupted", True)
    assert [note for note in progress.notes if "no answer" in note] == ["no answer: some may still run"]
    assert not (tmp_path / "run" / ".engine").exists()


def test_an_error_of_the_cluster_leaves_no_scratch_behind(progress, tmp_path, cluster, monkeypatch):
    monkeypatch.setattr(cluster, "close", (tmp_path / "none").read_text)
    with pytest.raises(FileNotFoundError), RemoteEngine(cluster, tmp_path, progress):
        assert (tmp_path / ".engine").exists()
    assert not (tmp_path / ".engine").exists()


def test_a_machine_that_ended_a_work_by_itself_is_as_good_as_lost(settings, progress, cluster):
    """As where a scheduler needs the machine for somebody else."""
    told, preempted = progress.advanced, []

    def advanced(trial):
        told(trial)
        if not preempted and progress.delivered[trial] > 20:
            preempted.append(cluster.started[0].send_signal(signal.SIGINT))

    progress.advanced = advanced
    summary = compare(settings("staged:sleep_s=0.02"), progress)
    assert summary.trackers["staged"].recordings["room"].outcome == "ok"
    assert "staged@room: lost by the engine (it was interrupted); starts again, 1 of 2" in progress.notes


def test_a_machine_with_another_recording_or_version_refuses_the_work(settings, progress, cluster, monkeypatch, record):
    plan = resolve(settings("persistence"))
    record(wall_m=2.0)
    reason = run(plan, (), progress).trackers["persistence"].recordings["room"].reason
    assert "room.mcap: another one on this machine" in reason
    monkeypatch.setattr(jobs, "versions", lambda: {"numpy": "0.1"})
    outcome = compare(settings("persistence", resume=True, out=plan.settings.out / "2"), progress)
    reason = outcome.trackers["persistence"].recordings["room"].reason
    assert reason.endswith(
        "0.1 where the run was started: every machine of an engine has the same recordings, weights and versions"
    )


def test_only_the_path_of_a_folder_travels_and_an_order_does_not_grow_with_the_run(settings, tmp_path, record):
    def order(count):
        several = tuple(str(record(f"r{n}", 8, {}, wall_m=3 + n / 10)) for n in range(count))
        plan = resolve(settings("persistence", "blank", recordings=several))
        shared = SharedInputs(plan.settings, lambda text: None, tmp_path)
        return TrialJob(plan.trials[0], tmp_path, shared).order()

    assert len(order(1)) == len(order(12)) < 10_000


def test_a_reply_that_is_none_ends_the_work_with_one_line(settings, progress, cluster, monkeypatch):
    monkeypatch.setattr(
        "scenes.process_cluster.EXECUTE",
        "import sys, pathlib; pathlib.Path(sys.argv[1], 'reply.json').write_text('{\"record\": 3}')",
    )
    reason = compare(settings("persistence"), progress).trackers["persistence"].recordings["room"].reason
    assert "reply.json: not as an engine writes it" in reason


def test_a_cluster_without_room_for_a_trial_is_refused(settings, progress, cluster):
    cluster.capacity = 0
    with pytest.raises(EngineError, match="no machine of the cluster has the cores for one trial"):
        compare(settings("persistence"), progress)


@pytest.mark.parametrize("engine", ["ray", "slurm"])
@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"latency": True}, "--latency times each tracker alone on a machine, which --engine .* does not give"),
        ({"deadline": True}, "then measure on one machine with --engine local --resume --deadline"),
        ({"jobs": 2}, "--jobs is of --engine local"),
        ({"follow": True}, "--follow runs on this machine"),
    ],
)
def test_what_a_cluster_cannot_do_is_refused_in_one_line(settings, engine, given, message):
    with pytest.raises(ConfigurationError, match=message):
        resolve(settings("persistence", engine=engine, **given))


def test_an_address_without_a_cluster_is_refused(settings):
    with pytest.raises(ConfigurationError, match="--address is of a Ray cluster"):
        resolve(settings("persistence", address="10.0.0.1:6379"))
