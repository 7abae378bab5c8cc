"""The verdicts of the contract suite as lines of text."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from gridtrack.common.errors import printable
from gridtrack.evaluation.hosting.contract_clauses import CLAUSES
from gridtrack.evaluation.hosting.contract_suite import ClauseResult

CONTRACT_PAGE = "docs/contract.md"
VERDICT_WIDTH = len("not applicable")
NAME_WIDTH = max(len(clause.name) for clause in CLAUSES)


def clause_lines(result: ClauseResult) -> list[str]:
    """One line for a clause; for a failed one also its requirement and the remedy."""
    lines = [f"{result.verdict:{VERDICT_WIDTH}}  {result.clause.name:{NAME_WIDTH}}  {printable(result.observed)}"]
    if result.verdict == "failed":
        lines += [f"{'':{VERDICT_WIDTH}}  requires: {result.clause.requirement}"]
        lines += [f"{'':{VERDICT_WIDTH}}  to mend:  {result.clause.mend}"]
    return lines


def contract_line(tracker: str, results: Sequence[ClauseResult]) -> str:
    """Whether the tracker keeps the contract, with the number of each verdict."""
    counts = Counter(result.verdict for result in results)
    counted = ", ".join(f"{number} {verdict}" for verdict, number in counts.items())
    if all(result.kept for result in results):
        return f"{printable(tracker)} keeps the contract: {counted}"
    broken = "does not keep the contract" if counts["failed"] else "was not checked in full"
    return f"{printable(tracker)} {broken}: {counted}; every clause with its reason: {CONTRACT_PAGE}"
