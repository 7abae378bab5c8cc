"""A baseline holds histograms: runs of zeros and of numbered parts are short in its file, and come back whole."""

from __future__ import annotations

import json

from hypothesis import given
from hypothesis import strategies as st
from pydantic import TypeAdapter

from gridtrack.evaluation.regression.measurement import PackedSums, Parts

SUMS, PARTS = TypeAdapter(PackedSums), TypeAdapter(Parts)


@given(st.lists(st.one_of(st.just(0.0), st.floats(-1e300, 1e300), st.integers(0, 9).map(float)), max_size=40))
def test_sums_come_back_as_they_were(sums):
    assert SUMS.validate_json(SUMS.dump_json(tuple(sums))) == tuple(sums)


@given(st.lists(st.tuples(st.sampled_from(["contacts", "lead", "tp", "a b"]), st.integers(0, 12)), max_size=8))
def test_names_of_parts_come_back_as_they_were(blocks):
    names = tuple(name for base, size in blocks for name in (base, *(f"{base} {n}" for n in range(size))))
    assert PARTS.validate_json(PARTS.dump_json(names)) == names


def test_a_histogram_of_few_counts_is_short():
    packed = json.loads(SUMS.dump_json((*[0.0] * 700, 3.0, 0.0, 0.5, *[0.0] * 70)))
    assert packed == ["700*0", 3, 0, 0.5, "70*0"]
    assert json.loads(PARTS.dump_json((*(f"contacts {n}" for n in range(700)), "seconds"))) == [
        "contacts 0-699",
        "seconds",
    ]
