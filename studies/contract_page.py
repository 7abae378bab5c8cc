"""The clauses of docs/contract.md, from their definition: `python -m studies.contract_page [--check]` (a second)."""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from pathlib import Path
from textwrap import fill

from gridtrack.common.files import write_text
from gridtrack.evaluation.hosting.contract_clauses import CLAUSES, Clause

from studies.support.results_file import study_parser

PAGE = Path(__file__).parents[1] / "docs" / "contract.md"
WIDTH = 120
BETWEEN = re.compile(r"(?<=<!-- clauses -->\n).*?(?=<!-- /clauses -->)", re.DOTALL)


def filled(text: str) -> str:
    """The page with the sections of all clauses between its markers."""
    sections = "\n".join(map(_section, CLAUSES))
    return BETWEEN.sub(lambda _: f"\n{sections}\n", text)


def _section(clause: Clause) -> str:
    needs = ", ".join(f"[{name}](#{name})" for name in clause.needs)
    paragraphs = [clause.requirement, f"*Reason:* {clause.reason}", f"*To mend:* {clause.mend}"]
    paragraphs += [f"*Needs:* {needs}"] if needs else []
    return "\n".join([f"### {clause.name}\n", *(f"{fill(text, WIDTH)}\n" for text in paragraphs)])


def main(arguments: Sequence[str] | None = None) -> None:
    parser = study_parser(__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing; exit with 1 if the page differs")
    check, text = parser.parse_args(arguments).check, PAGE.read_text("utf-8")
    differs = filled(text) != text
    if differs and not check:
        write_text(PAGE, filled(text))
    print(f"{PAGE.name}: {('differs' if check else 'written') if differs else 'has every clause'}")
    if check and differs:
        sys.exit(1)


if __name__ == "__main__":
    main()
