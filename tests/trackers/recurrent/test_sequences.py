"""Training windows: their frames, augmentations, places and resolutions, and the order in which they are drawn."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from gridtrack.common.errors import ConfigurationError
from gridtrack.trackers.recurrent.network import resolution_of
from gridtrack.trackers.recurrent.sequences import EpochSampler, SequenceDataset, superposed
from gridtrack.trackers.recurrent.settings import TrainingSettings
from tests.trackers.recurrent.sources import Drive, Recording, Shuttle, Walk


def items(*sources, observed_frames=5, blank_frames=3, step_s=0.0, general=False, **options):
    """Windows of five observed and three blank frames."""
    shape = {"observed_frames": observed_frames, "blank_frames": blank_frames, "repetitions": 1}
    return SequenceDataset(sources, TrainingSettings(**shape, **options), seed=1, step_s=step_s, general=general)


def test_windows_are_frames_of_the_recordings_and_depend_only_on_seed_and_number():
    data, again = (items(Shuttle(30), Shuttle(40), time_reversal=True) for _ in range(2))
    directions = set()
    for number in range(40):
        window = data[number].window
        assert torch.equal(window, again[number].window)
        columns = window[:, 1, 5].argmax(dim=-1)
        directions |= set(((columns[1:] - columns[:-1]) % 12).tolist())
        assert window[:, 1, 0].all()
        assert not window[:, 0, 11].any()
    assert directions == {1, 11}


@pytest.mark.parametrize(("time_reversal", "general"), [(False, False), (True, False), (False, True)])
def test_the_frames_of_an_item_are_in_the_window_of_the_last_one_that_is_observed(time_reversal, general):
    data = items(Drive(), time_reversal=time_reversal, general=general)
    first_columns = set()
    for number in range(60):
        visible, occupied = data[number].window.numpy().transpose(1, 0, 2, 3).astype(bool)
        assert visible[4].all()
        for t in range(8):
            unseen = np.flatnonzero(~visible[t].any(axis=0))
            assert len(unseen) == abs(t - 4), "columns that came in later, or have left"
            first_columns |= {bool(unseen[0] == 0)} if len(unseen) and t < 4 else set()
        places = {tuple(place) for plane in occupied for place in np.argwhere(plane).tolist()}
        assert len(places) <= 1, "a post stays at its place"
    assert first_columns == ({True, False} if time_reversal else {False})


def test_superposed_windows_are_the_frames_of_a_laser_with_the_objects_of_both():
    # Along a beam from the left: `one` is hit in cell 2, `other` in cell 5; cells behind a return are not visible.
    one = np.array([[[1, 1, 1, 0, 0, 0, 0, 0], [0, 0, 1, 0, 0, 0, 0, 0]]], np.uint8)
    other = np.array([[[1, 1, 1, 1, 1, 1, 0, 0], [0, 0, 0, 0, 0, 1, 0, 0]]], np.uint8)
    packed = superposed(np.packbits(one, axis=-1), np.packbits(other, axis=-1))
    assert np.array_equal(np.unpackbits(packed, axis=-1), one)


def test_superposition_applies_to_half_of_the_windows():
    data = items(Shuttle(60), superposition=True)
    dots = [int(data[number].window[0, 1, 5].sum()) for number in range(200)]
    assert set(dots) == {1, 2}
    assert 60 < sum(count == 2 for count in dots) < 130


@pytest.mark.parametrize(
    ("sources", "options", "message"),
    [
        ([Drive()], {"superposition": True}, "drive: the sensor moves.*superposition=false"),
        ([Walk(12, 0.2, 0.1)], {"superposition": True, "general": True}, "superposition=false"),
        ([Shuttle(5)], {}, "shuttle: 5 frames; training needs at least 8"),
    ],
)
def test_recordings_that_cannot_be_superposed_or_are_too_short_are_refused_by_name(sources, options, message):
    with pytest.raises(ConfigurationError, match=message):
        items(*sources, **options)


def test_a_window_in_which_nothing_moves_is_drawn_again():
    """A dot that stands and one that walks have the same duration: nearly every window has the walk."""

    class Stands(Recording):
        def draw(self, t, visible, occupied):
            occupied[20, 20] = True

    sources, shares = (Stands(40, 0.2, 0.1, 200), Walk(40, 0.2, 0.1, 200)), []
    for moving in (False, True):
        data = items(*sources, observed_frames=20, blank_frames=20, general=True, moving_windows=moving)
        moves = [bool((data[number].window[0] != data[number].window[-1]).any()) for number in range(60)]
        shares.append(sum(moves) / 60)
    assert 0.3 < shares[0] < 0.7
    assert shares[1] > 0.95


def test_the_first_updates_are_on_moving_shapes_and_a_share_of_the_others_has_some_added():
    source = Walk(40, 0.2, 0.1, unseen=10)
    data = items(source, general=True, shape_updates=3, batch=2, shape_share=0.5)
    plain = items(source, general=True)
    for number in range(6):
        window, resolution = data[number]
        assert not (window[:, 1] & ~window[:, 0]).any()
        assert window[:, 1].sum(dim=(1, 2)).max() > 5
        assert torch.equal(resolution, resolution_of(0.2, 0.1))
    added = 0
    for number in range(6, 106):
        window, own = data[number].window, plain[number].window
        assert not (window[:, 0] & ~own[:, 0]).any(), "shapes hide, and show nothing"
        assert not (window[:, 1] & ~window[:, 0]).any(), "only visible cells are occupied"
        assert (window[:, 1] >= own[:, 1] & window[:, 0]).all()
        added += bool((window != own).any())
    assert 35 < added < 65


def test_items_have_one_size_and_the_resolution_of_their_recording():
    """Larger grids are cut and smaller ones padded, at random places; nothing outside was observed."""
    data = items(Walk(140, 0.05, 0.1, unseen=60), Walk(40, 0.2, 0.1, unseen=10), general=True)
    rows = {0.05: set(), 0.2: set()}
    for number in range(30):
        window, resolution = data[number]
        assert window.shape == (8, 2, 64, 64)
        cell_m = min(rows, key=lambda cell: float((resolution_of(cell, 0.1) - resolution).abs().sum()))
        seen = window[4, 0].any(dim=1).nonzero().flatten().tolist()
        rows[cell_m].add(seen[0])
        assert window[4, 0].sum() == (len(seen) * 64 if cell_m == 0.05 else 30 * 40)
    assert all(len(found) > 5 for found in rows.values())


def test_every_recording_is_drawn_by_its_duration_and_not_by_its_number_of_frames():
    data = items(Walk(8, 0.2, 0.05, frames=407), Walk(8, 0.1, 0.2, frames=107), general=True)
    cells = [float(data[number].resolution[0]) for number in range(200)]
    assert 70 < sum(cell == 0.0 for cell in cells) < 130


def test_slow_frames_are_the_input_of_every_second_step_and_of_fast_ones_every_second_is_left_out():
    slow = items(Walk(40, 0.2, 0.2, unseen=10), step_s=0.1, general=True)[0]
    assert [bool(frame.any()) for frame in slow.window[:, 0]] == [False, True] * 4
    fast = items(Walk(40, 0.2, 0.05, unseen=10), step_s=0.1, general=True)[0]
    columns = fast.window[:, 1].any(dim=1).float().argmax(dim=1)
    assert {abs(int(step)) for step in columns.diff()} <= {0, 1, 2}, "a walk of 2 m/s: a cell of 0.2 m a step"
    assert all(torch.equal(each.resolution, resolution_of(0.2, 0.1)) for each in (slow, fast))


def test_the_occupied_rate_is_the_visible_cells():
    assert items(Shuttle(12)).occupied_rate == pytest.approx((12 + 1) / (12 * 11))


def test_at_a_site_the_target_of_an_unseen_cell_is_its_own_rate():
    target = items(Shuttle(12), unseen_weight=0.5).unseen_target
    rate = (12 + 1) / (12 * 11)
    expected = np.full((12, 12), 20 * rate / 32)
    expected[0], expected[5], expected[11] = (20 * rate + 12) / 32, (20 * rate + 1) / 32, rate
    np.testing.assert_allclose(target, expected, rtol=1e-6)
    assert items(Walk(12, 0.2, 0.1), general=True, unseen_weight=0.5).unseen_target.shape == ()


def test_devices_share_each_batch():
    """Two devices, batches of four: each has two windows of each."""
    samplers = [EpochSampler(8, 12, 4, rank=rank, devices=2) for rank in range(2)]
    assert [list(sampler) for sampler in samplers] == [[4, 6], [5, 7]], "a resumed training skips its first batch"
    for sampler in samplers:
        sampler.set_epoch(1)
    assert [list(sampler) for sampler in samplers] == [[8, 10], [9, 11]]
