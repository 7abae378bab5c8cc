"""The contract suite: a verdict on each clause of the tracker contract over the wire, for trackers in any language."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from tempfile import TemporaryDirectory
from typing import Any, Literal

from gridtrack.evaluation.hosting.contract_checks import (
    CHECKS,
    ContractViolationError,
    NotApplicableError,
    NotCheckedError,
)
from gridtrack.evaluation.hosting.contract_clauses import CLAUSES, Clause
from gridtrack.evaluation.hosting.limits import Limits
from gridtrack.evaluation.hosting.outcome import TrialEnded
from gridtrack.evaluation.hosting.tracker_under_test import TrackerUnderTest
from gridtrack.trackers.contract import StreamSpec
from gridtrack.trackers.selection import Launch

ClauseVerdict = Literal["passed", "failed", "not applicable", "not checked"]
"""`not applicable`: the clause does not concern this tracker. `not checked`: another clause is broken, or weights or a
library are missing, so that nothing could be observed."""


@dataclass(frozen=True, slots=True)
class ClauseResult:
    """The verdict on one clause, and what was observed, in one line."""

    clause: Clause
    verdict: ClauseVerdict
    observed: str

    @property
    def kept(self) -> bool:
        """Whether the tracker keeps the clause, as far as it concerns it."""
        return self.verdict in {"passed", "not applicable"}

    def record(self) -> dict[str, str]:
        """The result as JSON: `mend` is empty unless the clause failed."""
        return {
            "clause": self.clause.name,
            "verdict": self.verdict,
            "observed": self.observed,
            "mend": self.clause.mend if self.verdict == "failed" else "",
            "requirement": self.clause.requirement,
            "reason": self.clause.reason,
        }


def check_tracker(
    launch: Launch,
    stream: StreamSpec,
    options: Mapping[str, Any] | None = None,
    limits: Limits | None = None,
    report: Callable[[ClauseResult], None] | None = None,
) -> list[ClauseResult]:
    """Check every clause of the contract on small synthetic streams; `report` receives each result.

    `stream` contains the grid, the period and, for a tracker that learns, its weights. A clause that needs a broken one
    is not checked; where a tracker cannot start because weights or a library are missing, none but the first are.
    Raises ConfigurationError for options that the tracker refuses.
    """
    results: dict[str, ClauseResult] = {}
    with (
        TemporaryDirectory() as folder,
        TrackerUnderTest(launch, stream, options or {}, limits or Limits(), folder) as subject,
    ):
        for clause in CLAUSES:
            unmet = [results[name] for name in clause.needs if results[name].verdict != "passed"]
            results[clause.name] = _not_checked(clause, unmet[0]) if unmet else _result(clause, subject)
            if report is not None:
                report(results[clause.name])
    return list(results.values())


def _not_checked(clause: Clause, unmet: ClauseResult) -> ClauseResult:
    """The result where the clause of `unmet`, which this one needs, is not kept; it names the first broken one."""
    why = unmet.observed if unmet.observed.startswith("needs ") else f"needs {unmet.clause.name}"
    return ClauseResult(clause, "not checked", why)


def _result(clause: Clause, subject: TrackerUnderTest) -> ClauseResult:
    try:
        return ClauseResult(clause, "passed", CHECKS[clause.name](subject))
    except NotApplicableError as reason:
        return ClauseResult(clause, "not applicable", str(reason))
    except NotCheckedError as reason:
        subject.restart()
        return ClauseResult(clause, "not checked", str(reason))
    except ContractViolationError as violation:
        return ClauseResult(clause, "failed", str(violation))
    except TrialEnded as ended:
        subject.restart()
        return ClauseResult(clause, "failed", str(ended))
