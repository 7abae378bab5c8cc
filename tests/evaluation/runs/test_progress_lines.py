"""A training reports its rate and the time left, whatever its tracker reports."""

from __future__ import annotations

import re

from gridtrack.evaluation.runs.training_process import ProgressLines
from gridtrack.trackers.training.progress import Progress, duration_text

from scenes.agreement import wait_until


def wait_for(lines, pattern):
    """Wait for a line that matches."""
    wait_until(lambda: any(re.fullmatch(pattern, line) for line in tuple(lines)))


def test_a_silent_training_is_reported_with_rate_and_time_left():
    sent = []
    with ProgressLines(sent.append, every_s=0.01) as lines:
        wait_for(sent, r"training for \d+ s")
        with lines.progress.stage("update", 1000) as stage:
            stage.advance("loss 0.5")
            wait_for(sent, r"update 2 of 1000, (\d+\.\d/s|\d+\.\d s each), .* left, loss 0\.5")
        lines.report("the tracker's own line")
        wait_for(sent, "the tracker's own line")


def test_a_stage_inside_an_iteration_counts_as_its_part():
    progress = Progress()
    with progress.stage("search iteration", 2) as outer:
        outer._began_s -= 100.0
        with progress.stage("frame", 4) as inner:
            for _ in range(2):
                inner.advance()
            assert re.fullmatch(r"search iteration 1 of 2, 200\.\d s each, 5 min 0 s left", progress.text())
    assert progress.text().startswith("training for")


def test_updates_of_an_earlier_training_do_not_count_in_the_rate():
    progress = Progress()
    with progress.stage("update", 100, done=50) as stage:
        stage._began_s -= 10.0
        for _ in range(10):
            stage.advance()
        assert re.fullmatch(r"update 61 of 100, 1\.0 s each, 40 s left", progress.text())


def test_durations_are_short():
    assert [duration_text(s) for s in (0.2, 59.4, 125, 12_000)] == ["0 s", "59 s", "2 min 5 s", "3 h 20 min"]
