"""Runs on a real Ray cluster of three nodes on this machine: results, a node killed in mid-run, SIGTERM."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from contextlib import suppress

import psutil
import pytest

from gridtrack.common.errors import ConfigurationError
from gridtrack.evaluation.engines.task import TaskFolder
from gridtrack.evaluation.runs.plan import resolve
from gridtrack.evaluation.runs.runner import run
from gridtrack.evaluation.runs.summary import read_summary
from gridtrack.evaluation.runs.trial_record import read_trial_record

from scenes.agreement import wait_until
from scenes.room import STAGED, trial_of
from studies.support.plugins import write_distribution

ray = pytest.importorskip("ray", reason="Ray is not installed: pip install 'gridtrack[ray]'")
OBJECTS = 80 * 1024 * 1024
"""Memory of a node for objects, bytes: the smallest amount that Ray accepts."""


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """A head without a core and two nodes with one each; their processes see the tracker `staged`, also as `dies`."""
    from ray.cluster_utils import Cluster

    site = tmp_path_factory.mktemp("site")
    points = dict.fromkeys(("staged", "dies"), "staged_tracker:Staged")
    files = {"staged_tracker.py": STAGED}
    write_distribution(site, "staged", points, files, group="gridtrack.trackers")
    head = {"num_cpus": 0, "object_store_memory": OBJECTS, "include_dashboard": False}
    head |= {"include_log_monitor": False, "no_monitor": True}  # programs that nothing here uses
    with pytest.MonkeyPatch.context() as patched:
        patched.setenv("RAY_USAGE_STATS_ENABLED", "0")
        patched.setenv("RAY_worker_niceness", "0")  # at Ray's 15 other work on the machine would starve them
        patched.syspath_prepend(str(site))
        patched.setenv("PYTHONPATH", os.pathsep.join(filter(None, (str(site), os.environ.get("PYTHONPATH")))))
        cluster = Cluster(initialize_head=True, head_node_args=head)
        for _ in range(2):
            cluster.add_node(num_cpus=1, object_store_memory=OBJECTS)
        yield cluster
        ray.shutdown()
        cluster.shutdown()


def trackers_of(node):
    """The names of the trackers with a process that the node has started."""
    (raylet,) = node.all_processes["raylet"]
    names = []
    for process in psutil.Process(raylet.process.pid).children(recursive=True):
        with suppress(psutil.NoSuchProcess):  # it has ended in the meantime
            *_, module, name = ["", "", *filter(None, process.cmdline())]
            names += [name] * (module == "gridtrack.trackers.serve")
    return names


LISTENERS = """
import os, psutil
from gridtrack.evaluation.engines.ray_cluster import RayCluster
cluster = RayCluster("local", 1, os.path.basename)
here = psutil.Process()
sockets = [c for p in (here, *here.children(recursive=True)) for c in p.net_connections() if c.status == "LISTEN"]
print(os.environ["RAY_AUTH_MODE"], *{socket.laddr.ip.removeprefix("::ffff:") for socket in sockets})
cluster.close()
"""


def test_a_cluster_that_is_started_here_listens_on_loopback_and_asks_for_a_token(tmp_path):
    environment = {name: value for name, value in os.environ.items() if not name.startswith("RAY_")}
    done = subprocess.run(
        [sys.executable, "-c", LISTENERS], env=environment | {"HOME": str(tmp_path)}, capture_output=True, check=True
    )
    assert done.stdout.split() == [b"token", b"127.0.0.1"]


def test_a_sigterm_ends_the_tasks_and_keeps_their_scores(cluster, settings, tmp_path):
    words = ["compare", *settings().recordings, "--engine", "ray", "--address", cluster.address, "--horizon", "1s"]
    words += ["--every", "0.5s", "--no-floors", "--tracker", "persistence", "--tracker", "staged:crash_at=60,how=hangs"]
    words += ["--out", str(tmp_path / "run")]
    host = subprocess.Popen([sys.executable, "-m", "gridtrack.cli", *words])
    nodes = cluster.list_all_nodes()
    wait_until((tmp_path / "run" / "persistence@room" / "outcome.json").exists)
    tasks = (tmp_path / "run" / ".engine").glob
    wait_until(lambda: any(TaskFolder(path.parent).progress().delivered > 90 for path in tasks("*/*/progress.json")))
    host.send_signal(signal.SIGTERM)
    assert host.wait(300) == 130
    summary = read_summary(tmp_path / "run")
    assert summary.interrupted
    assert trial_of(summary, "persistence").outcome == "ok"
    partial = trial_of(summary, "staged")
    assert (partial.outcome, 0 < partial.frames_scored < 16) == ("interrupted", True)
    assert not any(trackers_of(node) for node in nodes)
    assert not (tmp_path / "run" / ".engine").exists()


def test_a_node_killed_in_mid_run_changes_no_count(cluster, settings, progress, tmp_path, assert_agrees_with_local):
    """Its trial starts again on the other node; a tracker that fails by itself is not started again."""
    # hanging before its thresholds are known, the trial has the same stretches when it starts again
    rows = f"staged:crash_at=40,crash_in=1,how=hangs,starts={tmp_path / 'starts'}", "dies:crash_at=60"
    requested = settings(*rows, engine="ray", address=cluster.address)
    killed = []

    def kill_its_node(trial, delivered):
        if not killed and trial == "staged@room" and delivered > 20:
            killed.append(next(node for node in cluster.list_all_nodes() if "staged" in trackers_of(node)))
            cluster.remove_node(killed[0], allow_graceful=False)

    progress.on_frame = kill_its_node
    run(resolve(requested), (), progress)
    assert killed
    (lost,) = [note for note in progress.notes if "lost by the engine" in note]
    assert lost.endswith("; starts again, 1 of 2")
    assert "engine ray: at most 2 trials at the same time" in progress.notes
    assert_agrees_with_local("staged", "dies:crash_at=60")
    outcomes = {label: read_trial_record(tmp_path / "run" / f"{label}@room").outcome for label in ("staged", "dies")}
    assert outcomes == {"staged": "ok", "dies": "crashed"}


@pytest.mark.parametrize("address", ["127.0.0.1:9", "nowhere", "ray://127.0.0.1:10001"])
def test_an_address_without_a_cluster_is_one_line(settings, progress, address):
    with pytest.raises(ConfigurationError, match=f"no Ray cluster at '{address}'") as refused:
        run(resolve(settings("persistence", engine="ray", address=address)), (), progress)
    assert "\n" not in str(refused.value)
