"""Text of recordings, trackers and results reaches a terminal bounded, and without characters that act on it."""

import io
import json

import numpy as np
import pytest
from rich.console import Console

from gridtrack.common.errors import MAX_LINE_CHARS
from gridtrack.common.scan import Scan
from gridtrack.evaluation.runs.trial_record import OUTCOME_FILE, read_trial_record
from gridtrack.recordings import RecordingInfo, open_recording, write_native
from gridtrack.recordings.recording import MAX_LISTED_TOPICS, MAX_WARNINGS, NO_MORE_WARNINGS, Topics
from gridtrack.reports.run_progress import LiveTable, RunProgress
from gridtrack.reports.terminal import print_rows

HOSTILE = "\x1b]0;owned\x07\x1b[31m\u202eevil\u2066\ud800"


@pytest.fixture
def hostile_recording(tmp_path):
    path = tmp_path / "a.mcap"
    info = RecordingInfo(site="here", licence=HOSTILE[:-1], credit=HOSTILE[:-1] * 100_000)
    with path.open("wb") as file:
        write_native(file, info, [Scan(0, np.ones(3, np.float32), -1.0, 0.1, 0.05, 5.0)])
    return path


def test_the_metadata_of_a_recording_are_printable(hostile_recording):
    lines = str(open_recording(hostile_recording).overview()).split("\n")
    assert any("evil" in line for line in lines)
    assert all(line.isprintable() and len(line) <= MAX_LINE_CHARS for line in lines)


def test_the_warnings_of_a_recording_are_printable_and_bounded(hostile_recording):
    recording = open_recording(hostile_recording)
    for number in range(3 * MAX_WARNINGS):
        recording.notify(f"{number} {HOSTILE * 1000}")
    assert len(recording.warnings) == MAX_WARNINGS + 1
    assert recording.warnings[-1].endswith(NO_MORE_WARNINGS)
    assert all(line.isprintable() and len(line) <= MAX_LINE_CHARS for line in recording.warnings)


def test_topics_without_scans_are_counted_up_to_a_limit():
    topics = Topics()
    for number in range(2 * MAX_LISTED_TOPICS):
        topics.add(f"/{number}", "other", False)
    topics.add("/scan", "scan", True)
    assert len(topics.types) == MAX_LISTED_TOPICS + 1
    assert topics.scans == {"/scan"}


def test_a_reason_in_a_file_of_results_is_bounded_when_it_is_read(tmp_path):
    fields = {"schema": 3, "label": "a", "recording": "b", "outcome": "crashed", "steps": 1}
    content = json.dumps({**fields, "reason": HOSTILE[:-1] * 100_000})
    (tmp_path / OUTCOME_FILE).write_text(content)
    record = read_trial_record(tmp_path)
    assert record is not None
    assert len(record.reason) == MAX_LINE_CHARS
    assert record.reason.isprintable()


@pytest.mark.parametrize("on_terminal", [True, False])
def test_progress_and_rows_have_no_control_characters(on_terminal, capsys, monkeypatch):
    shown = [_noted(lambda console: RunProgress(console=console), on_terminal)]
    shown.append(_noted(LiveTable, on_terminal))
    print_rows([{"name": "kalman", "about": HOSTILE}])
    shown.append(capsys.readouterr().out)
    for text in shown:
        assert "evil" in text
        assert not set(text) & {"\x07", "\u202e", "\u2066", "\ud800"}
        assert "\x1b]0;" not in text


def _noted(made, on_terminal):
    out = io.StringIO()
    made(Console(file=out, force_terminal=on_terminal, width=200)).note(HOSTILE)
    return out.getvalue()
