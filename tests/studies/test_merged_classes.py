"""Car and bus as one class: a hand-made forecast of two cells."""

import numpy as np
import pytest

from studies.merged_classes import Classes


def test_probabilities_of_car_and_bus_are_added_and_labels_follow():
    merged = Classes.of(("pedestrian", "car", "static", "bus"))
    assert merged.names == ("pedestrian", "vehicle", "static")
    assert merged.number.tolist() == [0, 1, 2, 1]
    of_two_cells = np.array([[0.1, 0.2], [0.3, 0.1], [0.2, 0.1], [0.4, 0.6]], np.float32)
    found = merged.summed(of_two_cells.reshape(1, 4, 1, 2))
    assert found.reshape(3, 2).tolist() == [
        pytest.approx([0.1, 0.2]),
        pytest.approx([0.7, 0.7]),
        pytest.approx([0.2, 0.1]),
    ]
