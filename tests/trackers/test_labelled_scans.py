"""The scans with the labels for learning classes: spread over the recordings, or in a row, drawn by the seed."""

from __future__ import annotations

import numpy as np
import pytest

from gridtrack.common.errors import ConfigurationError
from gridtrack.common.grid import GridSpec, LabelledFrame
from gridtrack.trackers.training.labelled_scans import ENOUGH_SCANS, LEAD_IN, LabelSettings, draw_labelled, run_bounds

from scenes.frames import frame_of


class Source:
    """Frames that are all visible, with one label each from frame `unlabelled` on; the stamp is the frame's number."""

    sha256, site, grid, period_s = "0" * 64, "toy", GridSpec(4, 0.5), 0.25

    def __init__(self, name, frames, unlabelled=0, classes=("stander", "walker", "horse"), label_at=lambda t: 0):
        self.name, self.frames, self.unlabelled, self.classes = name, frames, unlabelled, classes
        self.label_at = label_at

    def __len__(self):
        return self.frames

    def __iter__(self):
        return (item.frame for item in self.labelled())

    def labelled(self):
        shown = np.ones((4, 4), bool)
        for t in range(self.frames):
            labels = np.full(int(t >= self.unlabelled), self.label_at(t), np.uint8)
            yield LabelledFrame(frame_of(shown, second=t / 1e9), np.full(labels.size, 3), labels)


def drawn(sources, scans, seed=0, drawing="spread"):
    return draw_labelled(sources, LabelSettings(labelled_scans=scans, label_drawing=drawing), seed)


def numbers_of(frames, labelled_only=False):
    return [item.frame.stamp_ns for item in frames if item.labels.size or not labelled_only]


def test_labelled_scans_lie_apart_all_over_the_recording():
    labelled = drawn([Source("toy", 1000)], 50)
    (numbers,) = labelled.numbers
    assert (numbers // 20).tolist() == list(range(50)), "one in every twentieth part"
    assert numbers.tolist() == drawn([Source("toy", 1000)], 50).numbers[0].tolist()
    assert numbers.tolist() != drawn([Source("toy", 1000)], 50, seed=1).numbers[0].tolist()


def test_a_tracker_follows_the_recording_and_receives_only_the_labels_of_labelled_scans():
    labelled = drawn([Source("toy", 1000, unlabelled=500)], 15)
    (numbers,) = labelled.numbers
    assert numbers.min() >= 500
    runs = [(source.classes, list(frames)) for source, frames in labelled.runs()]
    assert {names for names, _ in runs} == {("stander", "walker", "horse")}
    followed = [numbers_of(frames) for _, frames in runs]
    assert all(run == list(range(run[0], run[-1] + 1)) for run in followed), "no frame is left out of a run"
    assert {t for run in followed for t in run} == {int(n) - lead for n in numbers for lead in range(LEAD_IN + 1)}
    assert 1 < len(runs) < 15, "scans close to each other share a run"
    assert [t for _, frames in runs for t in numbers_of(frames, labelled_only=True)] == numbers.tolist()
    assert all(item.cells.size == item.labels.size for _, frames in runs for item in frames)
    assert [t for _, frames in labelled.scans() for t in numbers_of(frames)] == numbers.tolist()


def test_a_run_that_is_not_read_to_its_end_does_not_shift_the_next_ones():
    labelled = drawn([Source("toy", 1000)], 10)
    starts = [next(iter(frames)).frame.stamp_ns for _, frames in labelled.runs()]
    assert starts == [first for first, _ in run_bounds(labelled.numbers[0])]


def test_scans_are_spread_over_several_recordings_by_their_numbers_of_labelled_scans():
    sources = [Source("few", 40), Source("none", 30, unlabelled=30), Source("many", 160, unlabelled=40)]
    labelled = drawn(sources, 40)
    assert [len(own) for own in labelled.numbers] == [10, 0, 30]
    assert sum(1 for _, frames in labelled.scans() for _ in frames) == 40
    few, _, many = labelled.numbers
    assert labelled.name == (
        f"few, 10 scans from {few[0] / 4:g} s to {few[-1] / 4:g} s;"
        f" many, 30 scans from {many[0] / 4:g} s to {many[-1] / 4:g} s"
    )


def test_scans_in_a_row_are_of_one_recording_and_every_start_is_possible():
    sources = [Source("few", 51), Source("many", 240, unlabelled=100)]
    all_drawn = [drawn(sources, 50, seed, "consecutive") for seed in range(60)]
    for labelled in all_drawn:
        few, many = labelled.numbers
        own = few if few.size else many
        assert own.tolist() == list(range(own[0], own[0] + 50))
        assert not few.size or not many.size
    starts = {int(labelled.numbers[1][0]) for labelled in all_drawn if labelled.numbers[1].size}
    assert len(starts) > 20
    assert min(starts) >= 100
    assert max(starts) <= 190
    assert any(labelled.numbers[0].size for labelled in all_drawn)


def test_a_recording_with_too_few_labels_is_refused_in_one_line():
    source = Source("toy-0", 240, unlabelled=100)
    assert len(drawn([source], 140).numbers[0]) == 140
    with pytest.raises(ConfigurationError, match=r"toy-0: 140 labelled scans, not 141: set .* to at most 140"):
        drawn([source], 141)
    with pytest.raises(ConfigurationError, match="toy-0: 140 consecutive labelled scans, not 141"):
        drawn([source], 141, drawing="consecutive")


@pytest.mark.parametrize("drawing", ["spread", "consecutive"])
def test_without_a_number_a_short_recording_gives_all_its_labelled_scans_and_a_long_one_enough(drawing):
    short, long = Source("short", 90, unlabelled=30), Source("long", ENOUGH_SCANS + 100)
    assert drawn([short], None, drawing=drawing).count == 60
    assert drawn([short, long], None, drawing=drawing).count == ENOUGH_SCANS
    with pytest.raises(ConfigurationError, match="none: no labelled scans: train on a recording with labels"):
        drawn([Source("none", 20, unlabelled=20)], None, drawing=drawing)


def test_only_classes_with_a_label_in_a_drawn_scan_are_learned():
    walkers = Source("a", 20, label_at=lambda t: 1)
    others = Source("b", 20, classes=("cow", "walker", "bus"), label_at=lambda t: 2 if t < 10 else 1)
    assert drawn([walkers, others], 20).classes == ("walker", "bus")
    assert drawn([walkers], 20).classes == ("walker",)


def test_many_recordings_are_counted_on_a_card_and_in_errors_not_listed():
    sources = [Source(f"toy {number}", 20) for number in range(5)]
    assert drawn(sources, 10).name == "10 scans of 5 recordings"
    assert drawn(sources[:2], 2).name.startswith("toy 0, 1 scans from ")
    with pytest.raises(ConfigurationError, match=r"^5 recordings: 100 labelled scans, not 101"):
        drawn(sources, 101)
