"""Every reader of untrusted input keeps one rule: a result, a part with a warning, or an error of one line.

`make fuzz` goes on with inputs of hypothesis.
"""

from collections import Counter

import pytest
from fuzz.damage import SeededChoices
from fuzz.rule import READERS, Inputs, finding

CASES = 300
"""Damaged files of the corpus: made anew from their seeds, each seed for the next reader."""


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    return Inputs(tmp_path_factory.mktemp("fuzz"))


@pytest.fixture(autouse=True)
def _own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


@pytest.mark.parametrize("name", READERS)
def test_the_inputs_are_valid_before_they_are_damaged(name, inputs, tmp_path):
    READERS[name].make(tmp_path)
    found = finding(name, tmp_path)
    assert not found.refused, found.line


@pytest.mark.parametrize("name", READERS)
def test_a_damaged_file_of_the_corpus_gives_a_result_or_one_line(name, inputs):
    mine = range(list(READERS).index(name), CASES, len(READERS))
    found = Counter(inputs.check(name, SeededChoices(case)).refused for case in mine)
    assert found[True], "no damage was noticed: the corpus tests nothing"
