"""The glossary is in alphabetical order and defines each word once."""

from __future__ import annotations

import re

from docs.pages import ROOT

GLOSSARY = (ROOT / "docs/glossary.md").read_text("utf-8")


def test_the_words_are_in_alphabetical_order_and_defined_once() -> None:
    words = [word.lower() for word in re.findall(r"^- \*\*(.+?)\*\*", GLOSSARY, re.MULTILINE)]
    assert words
    assert sorted(set(words)) == words
