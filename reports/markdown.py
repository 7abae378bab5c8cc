"""Markdown tables, with names that cannot break out of a cell."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from gridtrack.common.errors import printable


def markdown_table(headings: Sequence[str], rows: Iterable[Sequence[str]], aligned_right: range = range(0)) -> str:
    """A table of cells that are Markdown already; the columns `aligned_right` are right-aligned."""
    rule = ["---:" if i in aligned_right else "---" for i in range(len(headings))]
    return "".join(f"| {' | '.join(line)} |\n" for line in (headings, rule, *rows))


def cell_text(name: str) -> str:
    """A name on one line, with `|` escaped."""
    return " ".join(name.replace("|", "\\|").split())


def escaped(text: str) -> str:
    """Text on one line, escaped so that Markdown and HTML show every character as it is."""
    text = printable(text).replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    return "".join(f"\\{sign}" if sign in "\\`*_[]|#!~@" else sign for sign in text)
