"""The explanation of a figure is text on the page: it opens from disk, where no link into the documentation works."""

import re

import pytest

from gridtrack.reports.page import meanings


@pytest.mark.parametrize("meaning", meanings(), ids=lambda meaning: meaning.name)
def test_a_meaning_reads_without_its_links_and_pictures(meaning):
    assert meaning.paragraphs
    for paragraph in meaning.paragraphs:
        assert re.fullmatch(r"[A-Z].*\.", paragraph)
        assert not re.search(r"[\[\]`*!]|\((definition|see)\)|\.md|: [a-z]+\.$", paragraph)
