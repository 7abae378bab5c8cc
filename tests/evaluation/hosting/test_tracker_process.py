"""Tracker processes: the outcome of each failure with a reason in one line, and no process left behind."""

from __future__ import annotations

import os
import re
import sys
import tempfile
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import psutil
import pytest

from gridtrack.common.errors import ConfigurationError, PluginError
from gridtrack.common.grid import GridSpec
from gridtrack.evaluation.hosting.contract_scene import scene
from gridtrack.evaluation.hosting.limits import Limits
from gridtrack.evaluation.hosting.nursery import end_nursery
from gridtrack.evaluation.hosting.outcome import TrialEnded
from gridtrack.evaluation.hosting.tracker_process import TrackerProcess, describe
from gridtrack.trackers.contract import StreamSpec
from gridtrack.trackers.selection import Launch, launch

GRID = GridSpec(20, 0.2)
STREAM = StreamSpec(GRID, 0.125, "here")
LIMITS = Limits(memory_mb=400)
SHORT = Limits(start_s=5.0, update_s=0.5, predict_s=0.5)
"""Four trackers start at the same time, on a machine that may be busy."""
STEPS = 3
STAGES = ("start", "reset", "update", "predict")
(FRAME,) = scene(GRID, 0.125, 1, seed=1)


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return tmp_path / "stderr.log"


@pytest.fixture(autouse=True)
def _leaves_no_process(bad_trackers: None) -> Iterator[None]:
    """Every test here also checks that no child of the referee is alive after the trial."""
    end_nursery()
    before = set(psutil.Process().children(recursive=True))
    descriptors = psutil.Process().num_fds()
    yield
    end_nursery()
    assert set(psutil.Process().children(recursive=True)) <= before
    assert psutil.Process().num_fds() <= descriptors  # the garbage of an earlier test may go meanwhile


def run(name: str, log: Path, limits: Limits = LIMITS, **options: object) -> TrackerProcess:
    """Two rounds of all requests of a referee."""
    with TrackerProcess(launch(name), STREAM, options, limits, log) as tracker:
        tracker.reset(0)
        for _ in range(2):
            tracker.update(FRAME)
            tracker.predict(STEPS)
    return tracker


def outcome(name: str, log: Path, limits: Limits = LIMITS, **options: object) -> tuple[str, str]:
    with pytest.raises(TrialEnded) as ended:
        run(name, log, limits, **options)
    assert "\n" not in ended.value.reason
    return ended.value.outcome, ended.value.reason


def at_every_stage(name: str, folder: Path, limits: Limits = LIMITS) -> list[tuple[str, str]]:
    """The outcomes of a tracker that fails at each stage, in trials that run at the same time."""
    with ThreadPoolExecutor(len(STAGES)) as threads:
        return list(threads.map(lambda stage: outcome(name, folder / f"{stage}.log", limits, at=stage), STAGES))


def at(stage: str) -> str:
    return {"update": "update with frame 1", "predict": "predict after frame 1"}.get(stage, stage)


def test_a_good_tracker_is_timed_and_measured(log: Path) -> None:
    tracker = run("good", log)
    assert len(tracker.timings.updates) == len(tracker.timings.forecasts) == 2
    call = tracker.last_call
    assert call is not None
    assert 0.0 < call.own_ms <= call.round_trip_ms
    assert 10 < tracker.peak_rss_mb < 400


def test_a_tracker_that_hangs_and_ignores_signals_is_a_timeout(tmp_path: Path) -> None:
    limits = {"start": 5, "reset": 5, "update": 0.5, "predict": 0.5}
    expected = [("timeout", f"{at(stage)}: no answer within {limits[stage]} s") for stage in STAGES]
    assert at_every_stage("hangs", tmp_path, SHORT) == expected


def test_a_tracker_killed_by_a_signal_is_a_crash_that_names_it(tmp_path: Path) -> None:
    assert at_every_stage("kills-itself", tmp_path) == [("crashed", f"{at(s)}: killed by SIGKILL") for s in STAGES]


def test_an_exception_is_a_crash_with_its_last_line_as_the_reason(tmp_path: Path, trackers_here: None) -> None:
    reasons = [f"{at(stage)}: " if stage != "start" else "" for stage in STAGES]
    assert at_every_stage("raises", tmp_path) == [("crashed", f"{r}ValueError: the gate is negative") for r in reasons]


def test_a_segmentation_fault_is_a_crash_with_its_stack_in_the_log(log: Path) -> None:
    result, reason = outcome("segfaults", log)
    assert result == "crashed"
    assert "killed by SIGSEGV" in reason
    assert "in misbehave" in log.read_text()


def test_the_reason_of_an_exit_has_its_code_and_the_last_line_of_the_log(log: Path) -> None:
    assert outcome("leaves", log) == ("crashed", "update with frame 1: exited with code 0")
    expected = "update with frame 1: exited with code 1 (no licence for this machine)"
    assert outcome("exits", log) == ("crashed", expected)


@pytest.mark.parametrize("name", ["hogs", "hogs-in-a-child", "hides-in-a-memfd"])
def test_resident_memory_is_bounded_over_all_processes_and_files_in_memory(log: Path, name: str) -> None:
    limits = Limits(memory_mb=400, update_s=60.0)
    expected = "update with frame 1: more than 400 MB of resident memory"
    assert outcome(name, log, limits) == ("out-of-memory", expected)


def test_pages_that_processes_share_are_counted_once(log: Path) -> None:
    assert run("shares-pages", log).peak_rss_mb < 400


def test_the_files_of_a_tracker_are_removed_with_it(log: Path) -> None:
    run("leaves-files", log)
    folder, opened, mapped = map(Path, log.read_text().splitlines()[0].split())
    assert folder != Path(tempfile.gettempdir())
    assert not any(path.exists() for path in (folder, opened, mapped))


@pytest.mark.parametrize(
    ("name", "options", "reason"),
    [
        ("wrong-shape", {}, "occupancy has shape (3, 20, 20); expected (4, 20, 20)"),
        ("huge-shape", {}, r"declares .* a body of 26214400 bytes; at most"),
        ("wrong-type", {}, "occupancy is float64; expected float32 or float16"),
        ("object-array", {}, "array 'occupancy' is object; the wire carries bool, uint8"),
        ("not-an-array", {}, "occupancy is a list; expected a numpy array"),
        ("has-value", {"value": "nan"}, "occupancy has 1 values that are not finite"),
        ("has-value", {"value": "inf"}, "occupancy has 1 values that are not finite"),
        ("has-value", {"value": "2.0"}, "occupancy goes from 0 to 2; expected probabilities in [0, 1]"),
        ("has-value", {"value": "-0.1"}, "occupancy goes from -0.1 to 0; expected probabilities in [0, 1]"),
        ("predicts-none", {}, "predict returned a NoneType; expected a Forecast"),
        ("other-objects", {}, "objects has an element of type int; expected only TrackedObject"),
        ("other-objects", {"objects": "word"}, "objects is a str; expected a tuple of TrackedObject"),
        ("lopsided-classes", {}, "semantics must sum to 1 over the classes; the largest error is 0.2"),
    ],
)
def test_an_answer_that_violates_the_contract_is_invalid_output(
    log: Path, trackers_here: None, name: str, options: dict[str, str], reason: str
) -> None:
    result, found = outcome(name, log, **options)
    assert result == "invalid-output"
    assert found.startswith("predict after frame 1: ")
    assert reason in found or re.search(reason, found)


def test_a_failure_to_start_has_its_own_outcome(log: Path, trackers_here: None) -> None:
    expected = "classes is 'car'; expected a tuple of names"
    assert outcome("classes-as-a-word", log) == ("invalid-output", expected)
    assert outcome("needs-weights", log, at="start") == ("untrained", "needs-weights: no weights")
    stream = StreamSpec(GRID, 0.125, "here", weights=Path("weights.toml"))
    process = TrackerProcess(launch("needs-weights"), stream, {"at": "start"}, LIMITS, log)
    with pytest.raises(TrialEnded, match="not-applicable: weights of another grid"), process:
        pass
    missing = "tracker 'needs-missing-module': No module named 'a_module_nobody_has'"
    assert outcome("needs-missing-module", log, at="start") == ("unavailable", missing)
    assert outcome("out-of-memory", log) == ("out-of-memory", "update with frame 1: MemoryError:")


def test_output_of_libraries_goes_to_the_log_and_never_into_the_wire(log: Path) -> None:
    run("prints-everywhere", log, at="every")
    lines = log.read_text().splitlines()
    for line in ("from python", "from C", "to descriptor 1", "from a subprocess"):
        assert lines.count(line) == 1 + 1 + 2 + 2, "at each start, reset, update and prediction"


def test_the_log_keeps_its_beginning_and_end_and_is_bounded(log: Path) -> None:
    run("spams-stderr", log)
    text = log.read_text()
    assert text.startswith("the beginning\n")
    assert text.endswith("the end\n")
    assert "bytes left out" in text
    assert len(text) < 2.2 * (1 << 20)


def test_a_tracker_that_closes_its_pipe_has_crashed(log: Path) -> None:
    assert outcome("closes-its-pipe", log) == ("crashed", "update with frame 1: closed its end of the wire")


@pytest.mark.parametrize("how", ["fork", "setsid"])
@pytest.mark.parametrize("die", [False, True])
def test_child_processes_of_the_tracker_are_ended(log: Path, tmp_path: Path, how: str, die: bool) -> None:
    pid_file = tmp_path / "pid"
    options = {"how": how, "die": die, "pid_file": str(pid_file)}
    if die:
        assert outcome("forks", log, **options) == ("crashed", "update with frame 1: exited with code 3")
    else:
        run("forks", log, **options)
    assert not psutil.pid_exists(int(pid_file.read_text()))


def test_a_missing_program_is_unavailable(log: Path) -> None:
    with (
        pytest.raises(TrialEnded, match=r"unavailable: cannot be started \(/nowhere/tracker: No such file"),
        TrackerProcess(Launch("x", ("/nowhere/tracker",)), STREAM, {}, LIMITS, log),
    ):
        pass


def test_a_tracker_outlives_the_thread_that_started_it_and_is_killed_from_another(log: Path) -> None:
    tracker = TrackerProcess(launch("hangs"), STREAM, {}, LIMITS, log)
    thread = threading.Thread(target=tracker.__enter__)
    thread.start()
    thread.join()
    tracker.reset(0)
    assert tracker.predict(STEPS).occupancy.shape == (STEPS + 1, *GRID.shape)
    threading.Timer(0.1, tracker.kill).start()
    with pytest.raises(TrialEnded, match="crashed: update with frame 1: ended by the referee"):
        tracker.update(FRAME)
    tracker.__exit__(None, None, None)


def test_kill_before_the_start_ends_the_start(log: Path) -> None:
    tracker = TrackerProcess(launch("good"), STREAM, {}, LIMITS, log)
    tracker.kill()
    with pytest.raises(TrialEnded, match="crashed: start: ended by the referee"), tracker:
        pass


def test_a_killed_referee_takes_the_tracker_and_its_children_along(log: Path, tmp_path: Path) -> None:
    pid_file = tmp_path / "pid"
    code = f"""
import time
from pathlib import Path
from gridtrack.common.grid import GridSpec
from gridtrack.evaluation.hosting.limits import Limits
from gridtrack.evaluation.hosting.tracker_process import TrackerProcess
from gridtrack.trackers.contract import StreamSpec
from gridtrack.trackers.selection import launch
options = {{"at": "reset", "how": "setsid", "pid_file": {str(pid_file)!r}}}
with TrackerProcess(launch("forks"), StreamSpec(GridSpec(20, 0.2), 0.125), options, Limits(), Path({str(log)!r})) as t:
    t.reset(0)
    print("ready", flush=True)
    time.sleep(3600)
"""
    with psutil.Popen([sys.executable, "-c", code], stdout=-1) as referee:
        assert referee.stdout.readline() == b"ready\n"
        family = [*referee.children(recursive=True), psutil.Process(int(pid_file.read_text()))]
        assert len(family) >= 3
        referee.kill()
    _, alive = psutil.wait_procs(family, timeout=10)
    assert not alive


def test_describe_gives_options_with_their_defaults_role_and_comparisons(trackers_here: None) -> None:
    found = describe(launch("forks"), {"how": "setsid"}, LIMITS)
    assert found.options == {"at": "update", "how": "setsid", "pid_file": "", "die": False}
    assert found.options_schema["additionalProperties"] is False
    assert not found.learns
    assert (found.role, found.reference_for) == ("tracker", frozenset())
    floor = describe(launch("persistence"), {}, LIMITS)
    assert (floor.role, floor.reference_for) == ("floor", {"occupancy"})
    with pytest.raises(ConfigurationError, match="there is no option 'att'"):
        describe(launch("good"), {"att": "start"}, LIMITS)


def test_describe_reports_an_environment_without_gridtrack() -> None:
    bare = Launch("x", (sys.executable, "-I", "-S", "-m", "gridtrack.trackers.serve", "x"))
    with pytest.raises(PluginError, match=r"exited with code 1 .*No module named"):
        describe(bare, {}, LIMITS)


def test_the_tracker_inherits_no_file_descriptor(log: Path, tmp_path: Path) -> None:
    """Descriptors of the referee, such as another trial's wire, are closed in the tracker."""
    read_fd, write_fd = os.pipe()
    script = tmp_path / "lists.py"
    script.write_text("import os, sys; sys.stderr.write(' '.join(sorted(os.listdir('/proc/self/fd'), key=int)))")
    with (
        pytest.raises(TrialEnded, match=r"\(0 1 2 3\)"),  # 3: the listing itself
        TrackerProcess(Launch("x", (sys.executable, "-S", str(script))), STREAM, {}, LIMITS, log),
    ):
        pass
    os.close(read_fd)
    os.close(write_fd)
