"""Sections of pages that follow from definitions: `python -m studies.defined_pages [--check]` (a second).

The clauses of docs/contract.md, and the table of docs/scores.md.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from textwrap import fill

from gridtrack.evaluation.hosting.contract_clauses import CLAUSES, Clause
from gridtrack.evaluation.scores.definition import ScoreDefinition
from gridtrack.evaluation.scores.registry import built_in

from studies.support.results_file import fill_pages

DOCS = Path(__file__).parents[1] / "docs"
WIDTH = 120


def clauses() -> str:
    """The sections of all clauses of the contract."""
    return "\n".join(map(_section, CLAUSES))


def _section(clause: Clause) -> str:
    needs = ", ".join(f"[{name}](#{name})" for name in clause.needs)
    paragraphs = [clause.requirement, f"*Reason:* {clause.reason}", f"*To mend:* {clause.mend}"]
    paragraphs += [f"*Needs:* {needs}"] if needs else []
    return "\n".join([f"### {clause.name}\n", *(f"{fill(text, WIDTH)}\n" for text in paragraphs)])


def scores() -> str:
    """A section for each score with a table of its outputs."""
    return "\n".join("\n".join(_score(score)) for score in built_in())


def _score(score: ScoreDefinition) -> Iterator[str]:
    yield f"### {score.title}: `{score.name}`\n"
    yield f"{fill(score.about, WIDTH)}\n"
    yield "| output | title | unit | better | tested | margin of `regress` |\n|---|---|---|---|---|---|"
    for one in score.outputs:
        margin = "" if one.margin is None else f"{one.margin:g}{' of the value' if one.relative_margin else ''}"
        address = f"{score.name}.{one.name}"
        yield f"| `{address}` | {one.title} | {one.unit} | {one.better} | {'yes' if one.tested else ''} | {margin} |"
    yield ""


PAGES: dict[str, tuple[str, Callable[[], str]]] = {"contract.md": ("clauses", clauses), "scores.md": ("scores", scores)}
"""The mark of the section and its content, by page."""


def filled(page: str, text: str) -> str:
    """The text of the page with its section between the marks."""
    mark, content = PAGES[page]
    between = re.compile(rf"(?<=<!-- {mark} -->\n).*?(?=<!-- /{mark} -->)", re.DOTALL)
    return between.sub(lambda _: f"\n{content()}\n", text)


def main(arguments: Sequence[str] | None = None) -> None:
    fill_pages(__doc__, arguments, {DOCS / page: partial(filled, page) for page in PAGES})


if __name__ == "__main__":
    main()
