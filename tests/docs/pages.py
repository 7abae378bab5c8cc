"""The Markdown pages of the repository, their code blocks and their commands."""

from __future__ import annotations

import re
from pathlib import Path
from textwrap import dedent

ROOT = Path(__file__).parents[2]
PAGES = sorted(
    [*ROOT.glob("*.md"), *(page for folder in ("docs", "data", "examples") for page in (ROOT / folder).rglob("*.md"))]
)
FENCE = re.compile(r"^```(\w*)\n(.*?)^```", re.MULTILINE | re.DOTALL)
COMMAND = re.compile(r"(gridtrack|make|python) (?!=)[^<]*")


def name_of(page: Path) -> str:
    """The page's path below the repository, for test names."""
    return page.relative_to(ROOT).as_posix()


def blocks(page: Path, language: str) -> list[str]:
    """The fenced blocks of `language` on a page."""
    return [text for found, text in FENCE.findall(page.read_text("utf-8")) if found == language]


def shell_blocks(page: Path) -> list[str]:
    """The code blocks of a page that have a line of the command `gridtrack`, fenced or indented."""
    text = page.read_text("utf-8")
    indented = re.findall(r"(?:^    .*\n)+", FENCE.sub("\n", text), re.MULTILINE)
    found = [block for _, block in FENCE.findall(text)] + [dedent(block) for block in indented]
    return [block for block in found if re.search(r"^\s*gridtrack ", block, re.MULTILINE)]


def prose(page: Path) -> str:
    """A page without its fenced blocks."""
    return FENCE.sub("", page.read_text("utf-8"))


def commands(page: Path) -> list[str]:
    """The command lines on a page, in code blocks or in backticks: continued lines joined, comments removed."""
    text = page.read_text("utf-8").replace("\\\n", " ")
    fenced = [line for _, block in FENCE.findall(text) for line in block.splitlines()]
    rest = FENCE.sub("", text)
    indented = [line for line in rest.splitlines() if line.startswith("    ")]
    quoted = [" ".join(span.split()) for span in re.findall(r"`([^`]+)`", rest)]
    lines = [re.split(r"\s+#\s", line)[0].strip() for line in (*fenced, *indented, *quoted)]
    return [line for line in lines if COMMAND.fullmatch(line)]
