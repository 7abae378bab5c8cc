"""What each figure of the page means: the sections of docs/figures.md, as text that needs no link."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

FIGURES = Path(__file__).parents[1] / "docs" / "figures.md"
"""Part of the package too."""
_REMARK = re.compile(r" \(\[[^\]]*\]\([^)]*\)\)")
"""A link in parentheses: it has no words of the sentence."""
_MARKUP = re.compile(r"\[([^\]]*)\]\([^)]*\)|`([^`]*)`|\*([^*]*)\*")


@dataclass(frozen=True, slots=True)
class Meaning:
    """The section `name` of docs/figures.md: its heading and its paragraphs, without markup, links and pictures."""

    name: str
    heading: str
    paragraphs: tuple[str, ...]


def meanings() -> list[Meaning]:
    """The sections of docs/figures.md, one for each figure and table of the page."""
    _, *sections = re.split(r"^## ", FIGURES.read_text("utf-8"), flags=re.MULTILINE)
    return [_meaning(section) for section in sections]


def _meaning(section: str) -> Meaning:
    heading, _, text = section.partition("\n")
    paragraphs = (" ".join(one.split()) for one in text.strip().split("\n\n") if not one.startswith("!["))
    return Meaning(heading.lower().replace(" ", "-"), heading, tuple(map(_plain, paragraphs)))


def _plain(text: str) -> str:
    """Markdown without its links, code and emphasis."""
    text = _REMARK.sub("", text)
    while (plain := _MARKUP.sub(lambda found: next(filter(None, found.groups()), ""), text)) != text:
        text = plain
    return text
