"""The glossary is in alphabetical order, defines each word once, and gives new names that exist."""

from __future__ import annotations

import re

from docs.definitions import definitions
from docs.pages import ROOT

GLOSSARY = (ROOT / "docs/glossary.md").read_text("utf-8")


def test_the_words_are_in_alphabetical_order_and_defined_once() -> None:
    words = [word.lower() for word in re.findall(r"^- \*\*(.+?)\*\*", GLOSSARY, re.MULTILINE)]
    assert words
    assert sorted(set(words)) == words


def test_the_new_names_in_python_exist() -> None:
    rows = re.findall(r"^\| .* \| (.*) \|$", GLOSSARY.partition("Names in Python")[2], re.MULTILINE)
    names = {name for row in rows for name in re.findall(r"`(\w+)`", row)}
    assert len(names) > 10
    assert names - definitions().keys() == set()
