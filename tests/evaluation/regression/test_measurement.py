"""A baseline holds histograms: runs of zeros and of numbered parts are short in its file, and come back whole."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st
from pydantic import TypeAdapter

from gridtrack.evaluation.regression.measurement import PackedSums, Parts
from gridtrack.evaluation.regression.measuring import _steps_by_band

SUMS, PARTS = TypeAdapter(PackedSums), TypeAdapter(Parts)


@given(st.lists(st.one_of(st.just(0.0), st.floats(-1e300, 1e300), st.integers(0, 9).map(float)), max_size=40))
def test_sums_come_back_as_they_were(sums):
    assert SUMS.validate_json(SUMS.dump_json(tuple(sums))) == tuple(sums)


@given(st.lists(st.tuples(st.sampled_from(["contacts", "lead", "tp", "a b"]), st.integers(0, 12)), max_size=8))
def test_names_of_parts_come_back_as_they_were(blocks):
    names = tuple(name for base, size in blocks for name in (base, *(f"{base} {n}" for n in range(size))))
    assert PARTS.validate_json(PARTS.dump_json(names)) == names


def test_the_step_nearest_to_half_a_second_is_in_the_short_band_at_every_rate():
    """At 10 Hz it is 0.5 s ahead, at 5.9 Hz 0.51 s, at 7 Hz 0.571 s."""
    assert _steps_by_band([round(step / 7, 6) for step in range(9)])["short"] == [1, 2, 3, 4]
    assert _steps_by_band([step / 10 for step in range(21)]) == {
        "short": [1, 2, 3, 4, 5],
        "middle": [6, 7, 8, 9, 10, 11, 12, 13, 14, 15],
        "long": [16, 17, 18, 19, 20],
    }
    assert _steps_by_band([0.17 * step for step in range(10)]) == {"short": [1, 2, 3], "middle": [4, 5, 6, 7, 8, 9]}
