"""Malformed answers and programs that do not read the wire end their own trial only."""

from __future__ import annotations

import select
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import psutil
import pytest
from plugins import rogue_program as rogue

from gridtrack.common.grid import GridSpec
from gridtrack.evaluation.hosting import supervised, tracker_process
from gridtrack.evaluation.hosting.contract_scene import empty_stream
from gridtrack.evaluation.hosting.limits import Limits
from gridtrack.evaluation.hosting.outcome import TrialEnded
from gridtrack.evaluation.hosting.supervised import TimeLimit
from gridtrack.evaluation.hosting.tracker_process import TrackerProcess
from gridtrack.trackers.contract import StreamSpec
from gridtrack.trackers.selection import Launch
from tests.conftest import PLUGINS

from scenes.programs_here import ProgramHere

PROGRAM = PLUGINS / "rogue_program.py"
LIMITS = Limits(update_s=0.5, predict_s=0.5)


@pytest.fixture(autouse=True)
def _leaves_no_process() -> Iterator[None]:
    before = set(psutil.Process().children(recursive=True))
    yield
    assert set(psutil.Process().children(recursive=True)) <= before


@pytest.fixture
def fields(monkeypatch: pytest.MonkeyPatch) -> dict[str, object]:
    """The rogue program answers in this process; the fields by which it describes itself."""
    fields: dict[str, object] = {}

    def program(argv, env, *, log, **how):
        def answer(request):
            return [rogue.answer_to(request, argv[-1], fields)]

        return ProgramHere(SimpleNamespace(max_body=1 << 28, answer=answer), log)

    monkeypatch.setattr(tracker_process, "SupervisedProgram", program)
    return fields


def process(how: str, tmp_path: Path, size: int = 20, **more: object) -> TrackerProcess:
    program = Launch("rogue", (sys.executable, str(PROGRAM), how))
    stream = StreamSpec(GridSpec(size, 0.2), 0.125)
    return TrackerProcess(program, stream, {}, more.pop("limits", LIMITS), tmp_path / "stderr.log", **more)


def update_three_times(tracker: TrackerProcess) -> None:
    for frame in empty_stream(tracker.stream.grid, 0.125, 3):
        tracker.update(frame)


def end(how: str, tmp_path: Path, size: int = 20) -> tuple[str, str]:
    """The outcome and the reason of the trial of a rogue program."""
    with process(how, tmp_path, size) as tracker, pytest.raises(TrialEnded) as ended:
        update_three_times(tracker)
    return ended.value.outcome, ended.value.reason


@pytest.mark.parametrize(
    ("named", "role", "reference_for"),
    [({}, "tracker", set()), ({"role": "floor", "reference_for": ["classes"]}, "floor", {"classes"})],
)
def test_a_program_may_name_its_role_and_the_comparisons_with_it_as_reference(
    tmp_path: Path, fields: dict[str, object], named: dict[str, object], role: str, reference_for: set[str]
) -> None:
    fields |= named
    with process("done", tmp_path) as started:
        assert (started.description.role, started.description.reference_for) == (role, reference_for)


@pytest.mark.parametrize(
    ("named", "reason"),
    [
        ({"role": "ceiling"}, "'started': role is 'ceiling'; expected one of tracker, floor"),
        ({"role": None}, "'started': role is None; expected one of tracker, floor"),
        ({"device": "a\nb"}, "'started': device is 'a\\\\nb': expected 1 to 160 bytes of printable UTF-8"),
        ({"reference_for": "occupancy"}, "'started': reference_for is 'occupancy'; expected a list of occupancy"),
        ({"reference_for": [["classes"]]}, r"'started': reference_for is \[\['classes'\]\]; expected a list of"),
        ({"classes": [f"class {i}" for i in range(10_000)]}, "10000 classes; at most 255"),
    ],
)
def test_an_invalid_description_is_refused(
    tmp_path: Path, fields: dict[str, object], named: dict[str, object], reason: str
) -> None:
    fields |= named
    with pytest.raises(TrialEnded, match=f"invalid-output: start: {reason}"), process("done", tmp_path):
        pass


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
@pytest.mark.usefixtures("fields")
def test_a_malformed_answer_is_invalid_output(tmp_path: Path, how: str, reason: str) -> None:
    outcome, found = end(how, tmp_path)
    assert outcome == "invalid-output"
    assert reason in found


@pytest.mark.usefixtures("fields")
def test_a_reason_has_no_control_characters(tmp_path: Path) -> None:
    assert end("terminal-codes", tmp_path) == ("crashed", "update with frame 1: [31mred alert")


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


def test_time_in_which_the_host_is_stopped_does_not_count(monkeypatch) -> None:
    """A laptop that is closed, or Ctrl-Z: the tracker's answer lies in the pipe when the host continues."""
    clock_s = [0.0]
    monkeypatch.setattr(supervised.time, "monotonic", lambda: clock_s[0])
    limit = TimeLimit(5.0)
    clock_s[0] = 3600.0
    limit.spend()
    assert limit.left_s == 3.0
    for _ in range(4):
        clock_s[0] += 1.0
        limit.spend()
    assert limit.left_s == -1.0
    with pytest.raises(TimeoutError):
        limit.wait(0, select.POLLIN)


def test_a_program_that_stops_reading_cannot_block_the_referee(tmp_path: Path) -> None:
    """An update of 1500 x 1500 cells is larger than the pipe: without a deadline the write would block forever."""
    assert end("stops-reading", tmp_path, size=1500) == ("timeout", "update with frame 1: no answer within 0.5 s")


def test_a_program_that_closes_its_stdin_has_closed_the_wire(tmp_path: Path) -> None:
    assert end("closes-stdin", tmp_path) == ("crashed", "update with frame 2: closed its end of the wire")


@pytest.fixture
def large_forecasts(tmp_path: Path, fields: dict[str, object]):
    """`large_forecasts(classes_used)`: a program that names 255 classes and forecasts 100 MB, limited to 250 MB."""
    fields["classes"] = [f"class {i}" for i in range(255)]
    limits = Limits(predict_s=60.0, memory_mb=250)
    return lambda classes_used: process("done", tmp_path, 100, limits=limits, classes_used=classes_used)


def test_the_forecasts_that_the_host_holds_have_a_budget(large_forecasts) -> None:
    held = []
    with large_forecasts(True) as tracker:
        update_three_times(tracker)
        for _ in range(3):
            tracker.predict(9)  # is not held: costs nothing
        held += [tracker.predict(9), tracker.predict(9)]
        with pytest.raises(TrialEnded, match="out-of-memory: predict after frame 3: its forecasts that wait") as ended:
            held.append(tracker.predict(9))
    assert ended.value.outcome == "out-of-memory"
    assert len(held) == 2


def test_class_probabilities_that_are_not_scored_are_not_kept(large_forecasts) -> None:
    with large_forecasts(False) as tracker:
        update_three_times(tracker)
        held = [tracker.predict(9) for _ in range(6)]
    assert all(forecast.semantics is None and forecast.occupancy.base is None for forecast in held)
