"""Masses against hand-computed values: measurement, prediction, Dempster's rule, newborn mass."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gridtrack.trackers.dogma.filter import Masses, combined, measured_masses, newborn_mass, predicted_free


def cell(value: float) -> np.ndarray:
    return np.full((1, 1), value, np.float32)


def test_a_return_is_evidence_of_occupied_a_crossed_cell_of_free_and_a_hidden_cell_of_neither() -> None:
    visible, occupied = np.array([[True, True, False]]), np.array([[True, False, False]])
    evidence = measured_masses(visible, occupied, occupied_mass=0.9, free_mass=0.7)
    assert evidence.occupied.tolist() == [[pytest.approx(0.9), 0.0, 0.0]]
    assert evidence.free.tolist() == [[0.0, pytest.approx(0.7), 0.0]]


def test_the_combination_of_one_cell_equals_a_computation_by_hand() -> None:
    # unknown before: 0.2, silent: 0.1, conflict: 0.5 * 0.1 + 0.3 * 0.8 = 0.29
    found = combined(Masses(cell(0.5), cell(0.3)), Masses(cell(0.8), cell(0.1)))
    assert found.occupied[0, 0] == pytest.approx((0.5 * 0.8 + 0.5 * 0.1 + 0.2 * 0.8) / 0.71, rel=1e-6)
    assert found.free[0, 0] == pytest.approx((0.3 * 0.1 + 0.3 * 0.1 + 0.2 * 0.1) / 0.71, rel=1e-6)


def test_the_masses_of_a_hidden_cell_do_not_change() -> None:
    before = Masses(cell(0.4), cell(0.35))
    after = combined(before, Masses(cell(0.0), cell(0.0)))
    assert after.occupied == before.occupied
    assert after.free == before.free


def test_without_unknown_mass_the_combination_is_bayes_rule() -> None:
    # likelihoods P(z | occupied) : P(z | free) = 1 : 1 - 0.9
    found = combined(Masses(cell(0.2), cell(0.8)), Masses(cell(0.9), cell(0.0)))
    assert found.occupied[0, 0] == pytest.approx(0.2 / (0.2 + 0.8 * 0.1), rel=1e-6)


def test_the_newborn_mass_of_one_cell_equals_a_computation_by_hand() -> None:
    # rho_b = 0.9 * 0.02 * 0.6 / (0.4 + 0.02 * 0.6)
    assert newborn_mass(cell(0.9), cell(0.4), 0.02)[0, 0] == pytest.approx(0.9 * 0.012 / 0.412, rel=1e-6)


def test_without_predicted_mass_all_occupied_mass_is_newborn() -> None:
    assert newborn_mass(cell(0.9), cell(0.0), 0.02) == cell(0.9)


def test_free_mass_decays_and_is_bounded_by_the_predicted_occupied_mass() -> None:
    assert predicted_free(cell(0.8), 0.5, cell(0.1))[0, 0] == pytest.approx(0.4)
    assert predicted_free(cell(0.8), 0.5, cell(0.7))[0, 0] == pytest.approx(0.3)


share = st.floats(0.0, 0.99)


@given(share, share, share, share)
def test_masses_are_valid(occupied: float, free: float, hit: float, crossed: float) -> None:
    prior = Masses(cell(occupied * 0.98), cell(free * (1 - occupied * 0.98)))
    for evidence in (Masses(cell(hit), cell(0.0)), Masses(cell(0.0), cell(crossed))):
        found = combined(prior, evidence)
        assert found.occupied >= 0.0
        assert found.free >= 0.0
        assert found.occupied + found.free <= 1.0 + 1e-6
        born = newborn_mass(found.occupied, prior.occupied, 0.02)
        assert 0.0 <= born <= found.occupied * (1 + 1e-6) + 1e-30
