"""Entry points of a group are listed without importing them; an unusable one carries its problem and hides no other."""

from __future__ import annotations

import re

import pytest

from gridtrack.common.entry_points import VALID_NAME, registrations

GROUP = "gridtrack.example"


def test_entry_points_are_listed_by_name_with_their_distribution(install):
    install("my-things", {"second": "absent_module:B", "first": "absent_module:A"}, group=GROUP)
    found = registrations(GROUP)
    assert list(found) == ["first", "second"]
    assert (found["first"].value, found["first"].distribution) == ("absent_module:A", "my-things 1.0")
    assert (found["first"].distribution_name, found["first"].problem) == ("my-things", "")


def test_a_damaged_file_an_invalid_name_and_a_conflict_are_problems(install):
    site = install("damaged", {"x": "y:z"}, group=GROUP)
    (site / "damaged-1.0.dist-info" / "entry_points.txt").write_text(f"[{GROUP}]\nno equals sign\n")
    install("one", {"shared": "a:b", "Big": "a:b"}, group=GROUP)
    install("other", {"shared": "c:d", "fine": "c:d"}, group=GROUP)
    found = registrations(GROUP)
    assert "entry_points.txt cannot be read" in found["(damaged 1.0)"].problem
    assert "is not a valid name" in found["Big"].problem
    assert re.search("registered by two distributions, .*: uninstall one", found["shared"].problem)
    assert found["fine"].problem == ""


@pytest.mark.parametrize(("name", "valid"), [("ros1-bag", True), ("a.b_c", True), ("../x", False), ("", False)])
def test_names(name, valid):
    assert bool(VALID_NAME.fullmatch(name)) is valid


def test_files_are_read_again_only_after_a_change_of_the_path(install, monkeypatch):
    install("one", {"first": "a:b"}, group=GROUP)
    assert list(registrations(GROUP)) == ["first"]
    with monkeypatch.context() as unread:
        unread.setattr("importlib.metadata.PathDistribution.read_text", None)
        assert list(registrations(GROUP)) == ["first"]
    install("two", {"second": "a:b"}, group=GROUP)
    assert list(registrations(GROUP)) == ["first", "second"]
