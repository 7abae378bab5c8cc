"""Ragged arrays: bounds, owners, spans and means of the parts."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("filterpy")
from gridtrack.trackers.model_free.arrays import bounds_of, means_of, owners_of, spans_of, split

PARTS = [np.array([(0.0, 0.0), (3.0, 1.0)]), np.array([(5.0, 5.0)]), np.array([(1.0, 0.0), (1.0, 4.0), (4.0, 2.0)])]
ROWS, BOUNDS = np.concatenate(PARTS), bounds_of(PARTS)


def test_parts_keep_their_order():
    assert BOUNDS.tolist() == [0, 2, 3, 6]
    assert owners_of(BOUNDS).tolist() == [0, 0, 1, 2, 2, 2]
    assert [part.tolist() for part in split(ROWS, PARTS)] == [part.tolist() for part in PARTS]


def test_each_part_has_a_span_and_a_mean():
    assert spans_of(ROWS, BOUNDS).tolist() == [3.0, 0.0, 4.0]
    assert means_of(ROWS, BOUNDS).tolist() == [[1.5, 0.5], [5.0, 5.0], [2.0, 2.0]]
    assert means_of(ROWS > 2.0, BOUNDS).tolist() == [[0.5, 0.0], [1.0, 1.0], [1 / 3, 1 / 3]]


def test_without_parts_there_are_no_rows():
    assert bounds_of([]).tolist() == [0]
    assert split(np.empty((0, 2)), []) == []
