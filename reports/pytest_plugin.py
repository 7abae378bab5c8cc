"""The pytest plugin for a tracker's repository: tests fail if the tracker breaks the contract or is worse than before.

    def test_it_keeps_the_contract(tracker_contract):
        tracker_contract("my-tracker")

    def test_it_is_not_worse(tracker_regression):
        tracker_regression("my-tracker", "demo.mcap", baseline="my-tracker.json")

pytest loads this module in every run, so nothing is imported before the fixture is called.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from gridtrack.evaluation.regression.measurement import Measurement
    from gridtrack.evaluation.regression.verdict import Verdict
    from gridtrack.evaluation.runs.plan import ComparisonPlan
    from gridtrack.trackers.contract import StreamSpec

UPDATE = "--gridtrack-update-baseline"
PATHS = ("validation", "weights", "trackers_toml")
"""Options of a comparison that are files or folders."""
WRITTEN = pytest.StashKey[dict[Path, str]]()
"""In the configuration of a session: the written baselines, and the comparison in each."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option that writes baselines instead of comparing with them."""
    parser.getgroup("gridtrack").addoption(
        UPDATE, action="store_true", help="write the measurements of tracker_regression as the new baseline"
    )


@pytest.fixture
def tracker_contract() -> Callable[..., None]:
    """Check a tracker with the contract suite; fail the test if it breaks a clause of the contract."""
    return _require_contract


def _require_contract(tracker: str, stream: StreamSpec | None = None) -> None:
    """Check `tracker`, NAME[:key=value,...], on `stream`; None: a small grid at 8 Hz, without weights."""
    from gridtrack.common.errors import GridtrackError, printable
    from gridtrack.common.grid import GridSpec
    from gridtrack.evaluation.hosting.contract_suite import check_tracker
    from gridtrack.reports.contract import clause_lines, contract_line
    from gridtrack.trackers.contract import StreamSpec
    from gridtrack.trackers.selection import launch, parse_selection

    try:
        chosen = parse_selection(tracker)
        results = check_tracker(launch(chosen.name), stream or StreamSpec(GridSpec(40, 0.2), 0.125), chosen.options)
    except GridtrackError as error:
        pytest.fail(f"{tracker} was not checked: {printable(str(error))}", pytrace=False)
    if not all(result.kept for result in results):
        lines = [line for result in results if not result.kept for line in clause_lines(result)]
        pytest.fail("\n".join([contract_line(tracker, results), *lines]), pytrace=False)


@pytest.fixture
def tracker_regression(request: pytest.FixtureRequest, tmp_path: Path) -> TrackerRegression:
    """Run a tracker on a recording; fail the test if it is worse than its baseline or could not be measured."""
    config = request.config
    written = config.stash.setdefault(WRITTEN, {}) if config.getoption(UPDATE) else None
    if written is not None and hasattr(config, "workerinput"):
        pytest.fail(f"{UPDATE}: tests in several processes could replace one another's baseline: leave -n out", False)
    return TrackerRegression(request.path.parent, tmp_path, request.node.nodeid, written)


class TrackerRegression:
    """The value of the fixture: a function of a tracker and a recording."""

    def __init__(self, beside: Path, scratch: Path, test: str, written: dict[Path, str] | None) -> None:
        """`beside`: the folder of the test, for relative paths; `scratch`: the folder of the runs.

        `written`: the baselines of this session; None if it compares instead of writing.
        """
        self._beside, self._scratch, self._test, self._written = beside, scratch, test, written

    def __call__(
        self,
        tracker: str,
        recording: str,
        *,
        baseline: str | Path,
        margin: float | None = None,
        tolerance: float | None = None,
        **options: Any,
    ) -> Verdict | None:
        """Compare `tracker`, [LABEL=]NAME[:key=value,...], on `recording`, RECORDING[@range], with `baseline`.

        Paths are relative to the test's folder. `margin` and `tolerance` are options of `gridtrack regress`; None: its
        defaults. `options` are the fields of `CompareSettings`: horizon_s, every_s, grid, rate_hz, seed, weights, ...
        Returns the verdict; None if the baseline was written instead.
        """
        from gridtrack.common.errors import GridtrackError, printable
        from gridtrack.evaluation.regression.baseline import baseline_of, write_baseline
        from gridtrack.reports.verdict_text import text_of

        try:
            plan = self._plan(tracker, recording, options)
            if self._written is not None:
                self._refuse_second(self._beside / baseline, f"{tracker} on {recording} in {self._test}")
                write_baseline(self._beside / baseline, baseline_of([self._measure(plan, None)]))
                return None
            verdict = self._verdict(plan, self._beside / baseline, margin, tolerance)
        except GridtrackError as error:
            pytest.fail(f"{tracker} was not measured: {printable(str(error))}{self._how_to(str(error))}", pytrace=False)
        if verdict.worse:
            pytest.fail(f"{text_of(verdict)}\nIf the change is intended: pytest {self._test} {UPDATE}", pytrace=False)
        return verdict

    def located(self, path: str) -> str:
        """A path relative to the test's folder as an absolute one; a URL as it is."""
        from gridtrack.common.remote_files import is_url

        return path if is_url(path) else str(self._beside / path)

    def _refuse_second(self, baseline: Path, content: str) -> None:
        """Fail the test if this session has written another comparison to the same file."""
        assert self._written is not None
        first = self._written.setdefault(baseline.resolve(), content)
        if first != content:
            pytest.fail(f"{baseline}: has the baseline of {first}: name another file for {content}", pytrace=False)

    def _plan(self, tracker: str, recording: str, options: dict[str, Any]) -> ComparisonPlan:
        from gridtrack.common.config import validated
        from gridtrack.evaluation.runs.plan import resolve
        from gridtrack.evaluation.runs.settings import CompareSettings

        given = {
            "recordings": (self.located(recording),),
            "trackers": (tracker,),
            "no_floors": True,
            "out": Path(tempfile.mkdtemp(dir=self._scratch, prefix="run-")),
            **options,
            **{name: self.located(str(options[name])) for name in PATHS if options.get(name) is not None},
        }
        return resolve(validated(CompareSettings, given, "tracker_regression"))

    def _verdict(self, plan: ComparisonPlan, baseline: Path, margin: float | None, tolerance: float | None) -> Verdict:
        from gridtrack.common.config import validated
        from gridtrack.evaluation.regression.baseline import read_baseline
        from gridtrack.evaluation.regression.settings import GateSettings
        from gridtrack.evaluation.regression.verdict import compare_with_baseline

        values = {
            "margin": margin,
            "tolerance": None if tolerance is None else {plan.trials[0].label: tolerance},
        }
        given = {key: value for key, value in values.items() if value is not None}
        settings = validated(GateSettings, given, "tracker_regression")
        stored = read_baseline(baseline)
        return compare_with_baseline(stored, self._measure(plan, stored.first), settings)

    def _measure(self, plan: ComparisonPlan, like: Measurement | None) -> Measurement:
        """Run the plan and measure the run."""
        from gridtrack.evaluation.regression.measuring import measure_run
        from gridtrack.evaluation.runs.runner import run
        from gridtrack.reports.run_progress import RunProgress

        with RunProgress() as progress:
            summary = run(plan, ("pytest", self._test), progress)
        if summary.interrupted:
            raise KeyboardInterrupt
        return measure_run(plan.settings.out, like)

    def _how_to(self, error: str) -> str:
        """The command that makes the baseline, if `error` says that there is none."""
        return f"\nTo make it: pytest {self._test} {UPDATE}" if "--update" in error else ""
