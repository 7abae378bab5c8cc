"""The pytest plugin in use: pytest in a separate folder, on the tests of a third-party tracker."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from gridtrack.recordings import packaged_recording

EXAMPLE = Path(__file__).parents[2] / "examples" / "example_tracker" / "example_tracker.py"
TEST = """
def test_fading(tracker_regression):
    tracker_regression("mine=fading{options}", "demo.mcap@90s-97s", baseline="fading.json",
                       horizon_s=1.0, every_s=0.5{more})
"""


@pytest.fixture
def suite(tmp_path: Path, install: Callable[..., Path]) -> Callable[..., subprocess.CompletedProcess[str]]:
    """`suite(*arguments, half_life_s, options, more)` runs pytest in a folder with the regression test of the example
    tracker, in a version that forgets half in `half_life_s`."""
    code, field = EXAMPLE.read_text(), "half_life_s: float = {}"
    site = install("fading-tracker", {"fading": "example_tracker:FadingTracker"}, {"example_tracker.py": code})
    (tmp_path / "demo.mcap").symlink_to(packaged_recording("leg_tracker"))

    def suite(
        *arguments: str, half_life_s: float = 1.0, options: str = "", more: str = ""
    ) -> subprocess.CompletedProcess[str]:
        (site / "example_tracker.py").write_text(code.replace(field.format(1.0), field.format(half_life_s)))
        (tmp_path / "test_fading.py").write_text(TEST.format(options=options, more=more))
        command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *arguments, str(tmp_path)]
        return subprocess.run(command, cwd="/", capture_output=True, text=True, check=False)

    return suite


def test_a_regression_test_in_the_repository_of_a_tracker_fails_when_it_is_worse(suite, tmp_path):
    missing = suite()
    assert missing.returncode == 1
    assert "there is no such baseline" in missing.stdout
    assert "To make it: pytest test_fading.py::test_fading --gridtrack-update-baseline" in missing.stdout

    assert suite("--gridtrack-update-baseline").returncode == 0
    assert json.loads((tmp_path / "fading.json").read_text())["runs"][0]["trackers"].keys() == {"mine"}
    assert suite().returncode == 0

    worse = suite(half_life_s=0.05)
    assert worse.returncode == 1
    assert "worse: mine, dynamic, 0.5 to 1.5 s: F1 0." in worse.stdout
    assert "Traceback" not in worse.stdout
    assert suite(half_life_s=0.05, more=", tolerance=0.9").returncode == 0

    other = suite(options=":half_life_s=0.05")
    assert other.returncode == 1
    assert "mine is not the tracker of the baseline (options: none in the baseline, half_life_s=0.05" in other.stdout


def test_an_option_that_does_not_exist_is_an_error_of_one_line(suite):
    done = suite(more=", horizon=2")
    assert done.returncode == 1
    assert "there is no option 'horizon'; did you mean 'horizon_s'?" in done.stdout
    assert "Traceback" not in done.stdout


def test_a_broken_clause_of_the_contract_is_named_with_what_to_mend(tmp_path, bad_trackers):
    (tmp_path / "test_it.py").write_text('def test_it(tracker_contract):\n    tracker_contract("counts-predictions")\n')
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(tmp_path / "test_it.py")]
    done = subprocess.run(command, cwd="/", capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "counts-predictions does not keep the contract: 13 passed, 2 not applicable, 1 failed" in done.stdout
    assert "failed          predict-keeps-the-state  predicted twice in a row" in done.stdout
    assert "to mend:  Copy the state" in done.stdout
    assert "repeatable " not in done.stdout


def test_the_plugin_imports_no_large_library():
    code = "import gridtrack.reports.pytest_plugin, sys; print(*sorted(sys.modules))"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert not {"numpy", "pydantic", "polars", "pyarrow", "numba", "typer", "rich", "torch"} & set(loaded)
