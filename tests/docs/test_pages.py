"""Every relative link and anchor of a page exists; the glossary is in order."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

from docs.pages import PAGES, ROOT, name_of, prose

LINK = re.compile(r"(?<!`)\[[^\]]*\]\(([^)\s]+)\)")
HEADING = re.compile(r"^#+ +(.+?) *$", re.MULTILINE)


@cache
def anchors(page: Path) -> frozenset[str]:
    """The anchors that GitHub gives to the headings of a page."""
    titles = [re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", title) for title in HEADING.findall(prose(page))]
    return frozenset(re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles)


def broken(page: Path, link: str) -> str:
    if re.match(r"[a-z]+:", link):
        return ""
    path, _, anchor = link.partition("#")
    target = (page.parent / path).resolve() if path else page
    if not target.exists():
        return f"{link}: no such file"
    if not target.is_relative_to(ROOT):
        return f"{link}: outside the repository"
    if anchor and anchor not in anchors(target):
        return f"{link}: no such heading"
    return ""


def test_every_link_of_the_pages_leads_to_a_file_and_a_heading() -> None:
    links = [(page, link) for page in PAGES for link in LINK.findall(prose(page))]
    assert [f"{name_of(page)}: {problem}" for page, link in links if (problem := broken(page, link))] == []


def test_a_missing_file_and_a_missing_heading_are_found() -> None:
    page = ROOT / "README.md"
    assert broken(page, "docs/absent.md") == "docs/absent.md: no such file"
    assert broken(page, "docs/glossary.md#absent") == "docs/glossary.md#absent: no such heading"
    assert broken(page, "docs/glossary.md#s-to-z") == ""


def test_the_words_of_the_glossary_are_in_alphabetical_order_and_defined_once() -> None:
    text = (ROOT / "docs/glossary.md").read_text("utf-8")
    words = [word.lower() for word in re.findall(r"^- \*\*(.+?)\*\*", text, re.MULTILINE)]
    assert words
    assert sorted(set(words)) == words
