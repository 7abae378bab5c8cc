"""Malformed answers and programs that do not read the wire end their own trial only."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import psutil
import pytest

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec
from gridtrack.evaluation.hosting.limits import Limits
from gridtrack.evaluation.hosting.outcome import TrialEnded
from gridtrack.evaluation.hosting.tracker_process import TrackerDescription, TrackerProcess
from gridtrack.trackers.contract import StreamSpec
from gridtrack.trackers.selection import Launch

PROGRAM = Path(__file__).parents[2] / "plugins" / "rogue_program.py"
LIMITS = Limits(update_s=0.5, predict_s=0.5)


def frame(grid: GridSpec) -> GridFrame:
    seen = np.ones(grid.shape, bool)
    return GridFrame(
        0, seen, seen, SE2(), np.zeros((1, 2), np.float32), np.zeros((0, 2), np.float32), np.zeros(0, np.uint8)
    )


@pytest.fixture(autouse=True)
def _leaves_no_process() -> Iterator[None]:
    before = set(psutil.Process().children(recursive=True))
    yield
    assert set(psutil.Process().children(recursive=True)) <= before


def update_three_times(tracker: TrackerProcess, shown: GridFrame) -> None:
    for _ in range(3):
        tracker.update(shown)


def end(how: str, tmp_path: Path, limits: Limits = LIMITS, size: int = 20) -> tuple[str, str]:
    """How the trial of a rogue program ends: outcome and reason."""
    grid = GridSpec(size, 0.2)
    program = Launch("rogue", (sys.executable, str(PROGRAM), how))
    process = TrackerProcess(program, StreamSpec(grid, 0.125), {}, limits, tmp_path / "stderr.log")
    with process as tracker, pytest.raises(TrialEnded) as ended:
        update_three_times(tracker, frame(grid))
    return ended.value.outcome, ended.value.reason


def test_a_tracker_with_too_many_classes_is_refused_when_it_starts(tmp_path):
    program = Launch("rogue", (sys.executable, str(PROGRAM), "many-classes"))
    process = TrackerProcess(program, StreamSpec(GridSpec(20, 0.2), 0.125), {}, LIMITS, tmp_path / "stderr.log")
    with pytest.raises(TrialEnded, match="invalid-output: start: 10000 classes; at most 255"), process:
        pass


def described(fields: dict[str, object], tmp_path: Path) -> TrackerDescription:
    """How a tracker that starts with these fields describes itself."""
    program = Launch("rogue", (sys.executable, str(PROGRAM), "garbage", json.dumps(fields)))
    process = TrackerProcess(program, StreamSpec(GridSpec(20, 0.2), 0.125), {}, LIMITS, tmp_path / "stderr.log")
    with process:
        return process.description


def test_a_program_may_name_its_role_and_the_comparisons_that_it_is_the_reference_of(tmp_path: Path) -> None:
    floor = described({"role": "floor", "reference_for": ["classes", "occupancy"]}, tmp_path)
    assert (floor.role, floor.reference_for) == ("floor", {"occupancy", "classes"})
    plain = described({}, tmp_path)
    assert (plain.role, plain.reference_for) == ("tracker", frozenset())


@pytest.mark.parametrize(
    ("fields", "reason"),
    [
        ({"role": "ceiling"}, "'started': role is 'ceiling'; expected one of tracker, floor"),
        ({"role": None}, "'started': role is None; expected one of tracker, floor"),
        ({"reference_for": "occupancy"}, "'started': reference_for is 'occupancy'; expected a list of occupancy"),
        ({"reference_for": [["classes"]]}, r"'started': reference_for is \[\['classes'\]\]; expected a list of"),
    ],
)
def test_an_unknown_role_or_comparison_is_refused(fields: dict[str, object], reason: str, tmp_path: Path) -> None:
    with pytest.raises(TrialEnded, match=f"invalid-output: start: {reason}"):
        described(fields, tmp_path)


@pytest.mark.parametrize(
    ("how", "reason"),
    [
        ("garbage", r"update with frame 1: not a message: it starts with b'Hello, I' instead of b'GTW'"),
        ("huge-body", "declares a header of 2 and a body of 4611686018427387904 bytes; at most 1048576 and 0"),
        ("huge-header", "declares a header of 4294967295 and a body of 0 bytes"),
        ("other-version", "a message of wire version 9; this gridtrack speaks version 1"),
        ("not-json", "the header is not JSON"),
        ("nested-json", "the header is not JSON"),
        ("a-list", "the header is not a JSON object"),
        ("another-number", "answers request 9; expected 2"),
        ("another-kind", "answered 'forecast'; expected 'done'"),
        ("endless-time", "the header is not JSON that can be read (an integer of 401 digits; at most 64 bits"),
        ("negative-time", "update with frame 1: 'cpu_ns' is no duration"),
        ("no-times", "'done' needs a field 'elapsed_ns' of type int; found None"),
        ("made-up-outcome", "an error with outcome 'ok'; expected one of crashed, timeout"),
    ],
)
def test_a_malformed_answer_is_invalid_output(tmp_path: Path, how: str, reason: str) -> None:
    outcome, found = end(how, tmp_path)
    assert outcome == "invalid-output"
    assert reason in found


def test_a_second_answer_is_detected_at_the_next_request(tmp_path: Path) -> None:
    # the second answer may come in a little later than the first: then it is taken for the next one's, by number
    assert end("twice", tmp_path) in [
        ("invalid-output", "update with frame 2: unrequested bytes before the answer"),
        ("invalid-output", "update with frame 2: answers request 2; expected 3"),
    ]


def test_a_message_cut_short_is_a_crash(tmp_path: Path) -> None:
    assert end("half-a-message", tmp_path) == ("crashed", "update with frame 1: exited with code 0")


def test_a_slow_answer_must_meet_its_deadline(tmp_path: Path) -> None:
    assert end("drips", tmp_path) == ("timeout", "update with frame 1: no answer within 0.5 s")


def test_a_program_that_stops_reading_cannot_block_the_referee(tmp_path: Path) -> None:
    """An update of 1500 x 1500 cells is larger than the pipe: without a deadline the write would block forever."""
    assert end("stops-reading", tmp_path, size=1500) == ("timeout", "update with frame 1: no answer within 0.5 s")


def test_a_program_that_closes_its_stdin_has_closed_the_wire(tmp_path: Path) -> None:
    assert end("closes-stdin", tmp_path) == ("crashed", "update with frame 2: closed its end of the wire")


def test_a_reason_has_no_control_characters(tmp_path: Path) -> None:
    assert end("terminal-codes", tmp_path) == ("crashed", "update with frame 1: [31mred alert")


def large_forecasts(tmp_path: Path, *, classes_used: bool) -> TrackerProcess:
    """A program that names 255 classes and forecasts 100 MB, with a limit of 250 MB."""
    described = json.dumps({"classes": [f"class {i}" for i in range(255)]})
    program = Launch("rogue", (sys.executable, str(PROGRAM), "large-forecasts", described))
    stream, limits = StreamSpec(GridSpec(100, 0.2), 0.125), Limits(predict_s=60.0, memory_mb=250)
    return TrackerProcess(program, stream, {}, limits, tmp_path / "stderr.log", classes_used=classes_used)


def test_the_forecasts_that_the_host_holds_have_a_budget(tmp_path: Path) -> None:
    held = []
    with large_forecasts(tmp_path, classes_used=True) as process:
        process.update(frame(process.stream.grid))
        for _ in range(3):
            process.predict(9)  # is not held: costs nothing
        held += [process.predict(9), process.predict(9)]
        with pytest.raises(TrialEnded, match="out-of-memory: predict after frame 1: with those that wait") as ended:
            held.append(process.predict(9))
    assert ended.value.outcome == "out-of-memory"
    assert len(held) == 2


def test_class_probabilities_that_are_not_scored_are_not_kept(tmp_path: Path) -> None:
    with large_forecasts(tmp_path, classes_used=False) as process:
        process.update(frame(process.stream.grid))
        held = [process.predict(9) for _ in range(6)]
    assert all(forecast.semantics is None and forecast.occupancy.base is None for forecast in held)
