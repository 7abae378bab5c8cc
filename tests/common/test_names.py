"""Names that become parts of paths have no separators, control characters or lone surrogates."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gridtrack.common.files import MAX_NAME_BYTES, is_label, is_name, name_from


@pytest.mark.parametrize("name", ["test", "leave-one-out", "first half", "exp[1]", "a*b?", "café", "東京", "x" * 160])
def test_names_that_are_allowed(name: str) -> None:
    assert is_name(name)


@pytest.mark.parametrize(
    "name", ["", ".", "..", "../x", "a/b", "a\\b", "/etc", ".hidden", " x", "a\nb", "a\x00b", "a\udce9", "é" * 81]
)
def test_names_that_are_refused(name: str) -> None:
    assert not is_name(name)


@given(st.text(max_size=300))
def test_a_name_never_leaves_its_folder(name: str) -> None:
    if is_name(name):
        assert (Path("/out") / name).parts == ("/", "out", name)
    assert is_name(name_from(name))
    assert is_label("a")
    assert not is_label("a" * (MAX_NAME_BYTES + 1))
