"""Every link of a page, and every test and command of docs/attacks.md, exists; the glossary is in order."""

import re
from functools import cache
from importlib.util import find_spec

from docs.pages import PAGES, ROOT, name_of, prose

LINK = re.compile(r"(?<!`)\[[^\]]*\]\(([^)\s]+)\)")
ATTACK = re.compile(r"^\| .+ \| (.+) \| (.*)\|$", re.MULTILINE)
"""A row of docs/attacks.md: what the attack does, and the tests or commands that show it."""
HEADING = re.compile(r"^#+ +(.+?) *$", re.MULTILINE)


@cache
def anchors(page):
    """The anchors that GitHub gives to the headings of a page."""
    titles = [re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", title) for title in HEADING.findall(prose(page))]
    return frozenset(re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles)


def broken(page, link):
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


def test_every_link_of_the_pages_leads_to_a_file_and_a_heading():
    links = [(page, link) for page in PAGES for link in LINK.findall(prose(page))]
    assert [f"{name_of(page)}: {problem}" for page, link in links if (problem := broken(page, link))] == []


def test_a_missing_file_and_a_missing_heading_are_found():
    page = ROOT / "README.md"
    assert broken(page, "docs/absent.md") == "docs/absent.md: no such file"
    assert broken(page, "docs/glossary.md#absent") == "docs/glossary.md#absent: no such heading"
    assert broken(page, "docs/glossary.md#s-to-z") == ""


def test_the_words_of_the_glossary_are_in_alphabetical_order_and_defined_once():
    text = (ROOT / "docs/glossary.md").read_text("utf-8")
    words = [word.lower() for word in re.findall(r"^- \*\*(.+?)\*\*", text, re.MULTILINE)]
    assert words
    assert sorted(set(words)) == words


def exists(shown):
    """Whether there is the test `FILE::NAME` or the command `python -m MODULE`."""
    path, _, name = shown.partition("::")
    if name:
        file = ROOT / "tests" / path
        return file.is_file() and f"def {name}(" in file.read_text("utf-8")
    return find_spec(shown.removeprefix("python -m ")) is not None


def test_every_attack_names_a_test_or_a_command_that_exists_unless_it_is_a_limit():
    rows = [row for row in ATTACK.findall((ROOT / "docs/attacks.md").read_text("utf-8")) if row[0] != "result"]
    shown_by = [(result, re.findall(r"`(.+?)`", shown)) for result, shown in rows]
    assert len(rows) >= 30
    assert [result for result, shown in shown_by if not shown and "*limit*" not in result] == []
    assert [one for _, shown in shown_by for one in shown if not exists(one)] == []
    assert not exists("common/test_files.py::test_absent")
    assert not exists("python -m studies.absent")
