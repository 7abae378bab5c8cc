"""The examples in the docstrings of public names run."""

import doctest
import importlib

import pytest

MODULES = ("gridtrack.common.grid", "gridtrack.recordings.opening")


@pytest.mark.parametrize("name", MODULES)
def test_the_examples_of_a_module_run(name):
    result = doctest.testmod(importlib.import_module(name))
    assert result.attempted, "the module has no example"
    assert result.failed == 0, "see the report of doctest above"
