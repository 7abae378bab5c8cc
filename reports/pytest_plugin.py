"""The pytest plugin: a test in a tracker's own repository that fails when the tracker is worse than its baseline.

    def test_my_tracker(tracker_regression):
        tracker_regression("my-tracker", "demo.mcap", baseline="my-tracker.json")

pytest loads this module in every run, so nothing is imported before the fixture is called.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from gridtrack.evaluation.comparison.plan import ComparisonPlan
    from gridtrack.evaluation.regression import Measurement, Verdict

UPDATE = "--gridtrack-update-baseline"


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option that writes baselines in place of comparing with them."""
    parser.getgroup("gridtrack").addoption(
        UPDATE, action="store_true", help="write what tracker_regression measures as the new baseline"
    )


@pytest.fixture
def tracker_regression(request: pytest.FixtureRequest, tmp_path: Path) -> TrackerRegression:
    """Runs a tracker on a recording and fails the test where it is worse than its baseline, or was not measured."""
    return TrackerRegression(request.path.parent, tmp_path, request.node.nodeid, request.config.getoption(UPDATE))


class TrackerRegression:
    """What the fixture gives: call it with a tracker and a recording."""

    def __init__(self, beside: Path, scratch: Path, test: str, update: bool) -> None:
        """Files are named from `beside`, the test's folder; runs are left in `scratch`."""
        self._beside, self._scratch, self._test, self._update = beside, scratch, test, update

    def __call__(
        self,
        tracker: str,
        recording: str,
        *,
        baseline: str | Path,
        margin: float = 0.005,
        tolerance: float | None = None,
        **options: Any,
    ) -> Verdict | None:
        """Compare `tracker`, [LABEL=]NAME[:key=value,...], on `recording`, RECORDING[@range], with `baseline`.

        Paths are relative to the test's folder. `margin` and `tolerance` are those of `gridtrack regress`, `options`
        those of a comparison: horizon_s, every_s, grid, rate_hz, seed, weights and the others of `CompareSettings`.
        Returns the verdict; None where the baseline was written instead.
        """
        from gridtrack.common.errors import GridtrackError, printable
        from gridtrack.evaluation.regression import write_baseline
        from gridtrack.reports.regression import text_of

        try:
            plan = self._plan(tracker, recording, options)
            if self._update:
                write_baseline(self._beside / baseline, [self._measured(plan, None)])
                return None
            verdict = self._verdict(plan, self._beside / baseline, margin, tolerance)
        except GridtrackError as error:
            pytest.fail(f"{tracker} was not measured: {printable(str(error))}{self._how(str(error))}", pytrace=False)
        if verdict.worse:
            pytest.fail(f"{text_of(verdict)}\nIf that is wanted: pytest {self._test} {UPDATE}", pytrace=False)
        return verdict

    def _plan(self, tracker: str, recording: str, options: dict[str, Any]) -> ComparisonPlan:
        from gridtrack.common.config import validated
        from gridtrack.evaluation.comparison.plan import resolve
        from gridtrack.evaluation.comparison.settings import CompareSettings

        given = {
            "recordings": (str(self._beside / recording),),
            "trackers": (tracker,),
            "out": Path(tempfile.mkdtemp(dir=self._scratch, prefix="run-")),
            **options,
        }
        return resolve(validated(CompareSettings, given, "tracker_regression"))

    def _verdict(self, plan: ComparisonPlan, baseline: Path, margin: float, tolerance: float | None) -> Verdict:
        from gridtrack.common.config import validated
        from gridtrack.evaluation.regression import GateSettings, compare_with_baseline, read_baseline

        stated = {} if tolerance is None else {plan.trials[0].label: tolerance}
        settings = validated(GateSettings, {"margin": margin, "tolerance": stated}, "tracker_regression")
        against = read_baseline(baseline)
        return compare_with_baseline(against, self._measured(plan, against.first), settings)

    def _measured(self, plan: ComparisonPlan, like: Measurement | None) -> Measurement:
        """Run the plan, and measure what it left."""
        from gridtrack.evaluation.comparison.runner import run
        from gridtrack.evaluation.regression import measure_run
        from gridtrack.reports.terminal import RunProgress

        with RunProgress() as progress:
            summary = run(plan, ("pytest", self._test), progress)
        if summary["interrupted"]:
            raise KeyboardInterrupt
        return measure_run(plan.settings.out, like)

    def _how(self, error: str) -> str:
        """How to make the baseline here, where the error is that there is none."""
        return f"\nTo make it: pytest {self._test} {UPDATE}" if "--update" in error else ""
