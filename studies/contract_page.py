"""The clauses of docs/contract.md, from their definition: `python -m studies.contract_page` (one second)."""

from __future__ import annotations

import argparse
import re
from pathlib import Path
from textwrap import fill

from gridtrack.common.files import write_text
from gridtrack.evaluation.processes.contract_clauses import CLAUSES, Clause

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


def main() -> None:
    """Write the sections."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    write_text(PAGE, filled(PAGE.read_text("utf-8")))


if __name__ == "__main__":
    main()
