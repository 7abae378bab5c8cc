"""Smoothing does not shift paths, and headings neither flip nor turn a standing body."""

from __future__ import annotations

import numpy as np
import pytest

from gridtrack.simulation.motion import headings, smoothed, trailing_headings, unbroken_tracks


def test_smoothing_keeps_constants_and_averages_jitter() -> None:
    assert smoothed(np.full((30, 2), 7.0), 4.0) == pytest.approx(7.0)
    assert smoothed(np.full((1, 2), 7.0), 4.0) == pytest.approx(7.0)
    jitter = np.random.default_rng(0).normal(0.0, 1.0, (2000, 1))
    # The standard deviation of white noise under a Gaussian of s steps falls by sqrt(2 s sqrt(pi)).
    assert smoothed(jitter, 4.0).std() == pytest.approx(1.0 / np.sqrt(2.0 * 4.0 * np.sqrt(np.pi)), rel=0.1)


def test_a_straight_path_stays_straight_away_from_its_ends() -> None:
    line = np.column_stack([np.arange(60.0), np.arange(60.0) * -2.0])
    assert smoothed(line, 3.0)[15:45] == pytest.approx(line[15:45])


def test_the_heading_is_that_of_the_motion_and_kept_while_standing() -> None:
    there = np.column_stack([np.zeros(40), np.linspace(0.0, 6.0, 40)])
    path = np.concatenate([np.zeros((20, 2)), there, np.repeat(there[-1:], 40, axis=0)])
    assert headings(path, 0.125, 2.0) == pytest.approx(np.pi / 2)


def test_a_body_that_never_moves_has_the_resting_heading() -> None:
    assert headings(np.zeros((5, 2)), 0.125, 2.0, resting=1.0) == pytest.approx(1.0)
    assert headings(np.zeros((1, 2)), 0.125, 2.0, resting=1.0) == pytest.approx(1.0)


def test_the_heading_on_a_circle_has_no_jump() -> None:
    angle = np.linspace(0.0, 4.0 * np.pi, 400)
    turned = headings(np.column_stack([np.cos(angle), np.sin(angle)]) * 5.0, 0.125, 2.0)
    assert np.abs(np.diff(turned)).max() < 0.05
    assert turned[-20] - turned[20] == pytest.approx(angle[-20] - angle[20], abs=0.01)


def test_a_vehicle_s_rear_follows_its_front_and_a_standing_vehicle_does_not_turn() -> None:
    straight = np.column_stack([np.linspace(0.0, 20.0, 5000), np.zeros(5000)])
    found = trailing_headings(np.concatenate([straight, np.repeat(straight[-1:], 20, axis=0)]), 3.0, 0.5)
    # The tractrix of a straight pull: tan(heading / 2) falls exponentially with the way over the wheelbase.
    assert np.tan(found[4999] / 2.0) == pytest.approx(np.tan(0.25) * np.exp(-20.0 / 3.0), rel=0.05)
    assert found[4999:] == pytest.approx(found[4999], abs=1e-12)


def test_gaps_split_tracks() -> None:
    user, step = np.array([0, 0, 0, 1, 1, 2]), np.array([3, 4, 6, 7, 8, 9])
    assert unbroken_tracks(user, step) == [slice(0, 2), slice(2, 3), slice(3, 5), slice(5, 6)]
    assert unbroken_tracks(np.array([], int), np.array([], int)) == []
