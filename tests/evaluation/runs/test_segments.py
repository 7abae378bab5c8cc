"""Segments of a long recording: trials of their own that together have the scores of the whole."""

from __future__ import annotations

import numpy as np
import polars as pl
import pytest

from gridtrack.common.errors import ConfigurationError
from gridtrack.evaluation.runs.jobs import JobOrder, SharedInputs
from gridtrack.evaluation.runs.plan import resolve
from gridtrack.evaluation.runs.run_record import description_of, identity_of
from gridtrack.evaluation.runs.sums import SUMS_FILE

pytestmark = pytest.mark.usefixtures("trackers_here")


def counts(folder, label):
    """The sums of F1 of every scored frame of a row, by stamp, step and stratum."""
    files = sorted(folder.glob(f"{label}@*/{SUMS_FILE}"))
    columns = ["stamp_ns", "step", "stratum", "part", "value"]
    rows = pl.concat(
        [pl.read_parquet(file, glob=False).filter(pl.col("score") == "f1").select(columns) for file in files]
    )
    return rows.cast({"stratum": pl.String}).sort("stamp_ns", "step", "stratum")


@pytest.fixture
def long(record):
    """Forty seconds without named stretches, and another recording to choose thresholds on."""
    validation = str(record("other", 8, {}, wall_m=3.4))
    return {"recordings": (str(record("hall", 40, {})),), "validation": validation}


def test_segments_together_have_the_counts_of_the_whole(compare, progress, long, tmp_path):
    whole = compare("persistence", **long, out=tmp_path / "whole")
    progress.notes.clear()
    progress.delivered.clear()
    cut = compare("persistence", "blank", **long, out=tmp_path / "cut", segment_s=10.0, warm_up_s=4.0)
    assert list(cut.recordings) == ["hall@2s-11s", "hall@11s-20.5s", "hall@20.5s-29.5s", "hall@29.5s-39s"]
    one, other = (counts(tmp_path / name, "persistence") for name in ("whole", "cut"))
    assert one.height == whole.trackers["persistence"].recordings["hall"].frames_scored * 11 * 5
    # how long a cell is hidden before a segment is not known: the warm-up is longer than the bands of hidden time
    assert one.equals(other)
    assert progress.notes.count("hall: finding its static cells") == 1, "segments share them"
    delivered = [progress.delivered[f"persistence@{name}"] for name in ("hall@2s-11s", "hall@11s-20.5s")]
    assert delivered == [80 + 116, 141], "the first chooses the thresholds, on 80 frames"
    difference = next(one for one in cut.differences if one.tracker == "blank")
    assert (difference.units, difference.recordings) == (1, "all recordings"), "segments are no independent units"


def test_the_warm_up_of_a_segment_is_delivered_and_not_scored(settings, long):
    plan = resolve(settings("persistence", **long, segment_s=10.0, warm_up_s=4.0))
    first, second, *_ = plan.splits
    assert first.test.stretch_s[0] == 0.0
    assert second.test.stretch_s == (7.0, 21.1)
    assert (first.warm_up, second.warm_up) == (20, 40)
    assert [description_of(split).warm_up_frames for split in plan.splits] == [20, 40, 40, 40]
    due = [index for index in range(len(second.test)) if second.schedule.due(index)]
    assert due == list(range(40, 131, 5))


def test_a_recording_that_is_not_longer_is_one_trial(settings, long):
    assert [split.name for split in resolve(settings("persistence", **long, segment_s=40.0)).splits] == ["hall"]


def test_another_machine_finds_the_same_segment(settings, long, tmp_path):
    plan = resolve(settings("persistence", **long, segment_s=10.0))
    shared = SharedInputs(plan.settings, lambda text: None, tmp_path)
    for split in plan.splits:
        order = JobOrder.read(JobOrder.of(split, shared).model_dump_json(by_alias=True))
        assert identity_of(order.split()) == identity_of(split)


def test_frames_at_periods_that_are_no_decimals_are_cut_without_a_gap(settings, long):
    plan = resolve(settings("persistence", **long, segment_s=10.0, rate_hz=7.0))
    whole = resolve(settings("persistence", **long, rate_hz=7.0)).splits[0]
    stamps = [[frame.stamp_ns for frame in split.test] for split in plan.splits]
    scored = [np.array(own)[list(split.schedule.scored)] for own, split in zip(stamps, plan.splits, strict=True)]
    expected = np.array([frame.stamp_ns for frame in whole.test])[list(whole.schedule.scored)]
    assert np.array_equal(np.concatenate(scored), expected)


def test_a_recording_that_is_still_written_has_no_segments(settings):
    with pytest.raises(ConfigurationError, match="--segment cuts a finished recording: leave it out with --follow"):
        resolve(settings("persistence", follow=True, segment_s=10.0))
