"""The pytest plugin in use: a session of pytest on the tests of a third-party tracker."""

from __future__ import annotations

import io
import json
import subprocess
import sys
from contextlib import redirect_stdout
from pathlib import Path
from typing import NamedTuple

import pytest

from gridtrack.recordings import packaged_recording
from gridtrack.reports.pytest_plugin import TrackerRegression

EXAMPLE = Path(__file__).parents[2] / "examples" / "example_tracker" / "example_tracker.py"
TEST = """
def test_fading(tracker_regression):
    tracker_regression("mine=fading{options}", "demo.mcap@90s-97s", baseline="fading.json",
                       validation="demo.mcap@75s-79s", horizon_s=1.0, every_s=0.5{more})
"""


class Session(NamedTuple):
    """A session of pytest that has ended."""

    code: int
    out: str


def run_pytest(folder, code, *arguments):
    """Run pytest, in this process and with no other plugin, on a file test_it.py with this code."""
    (folder / "test_it.py").write_text(code)
    plugins = "--disable-plugin-autoload -p gridtrack.reports.pytest_plugin -p no:cacheprovider"
    where = ["--rootdir", folder, "--import-mode", "importlib", folder / "test_it.py"]
    with redirect_stdout(io.StringIO()) as out:
        ended = pytest.main(["-q", *plugins.split(), *map(str, where), *arguments])
    sys.modules.pop("test_it", None)
    return Session(int(ended), out.getvalue())


@pytest.fixture
def suite(tmp_path, install, trackers_here):
    """`suite(*arguments, half_life_s, options, more)` runs the regression test of the example tracker, in a version
    that forgets half in `half_life_s`."""
    code, field = EXAMPLE.read_text(), "half_life_s: float = {}"
    site = install("fading-tracker", {"fading": "example_tracker:FadingTracker"}, {"example_tracker.py": code})
    (tmp_path / "demo.mcap").symlink_to(packaged_recording("leg_tracker"))

    def suite(*arguments, half_life_s=1.0, options="", more=""):
        (site / "example_tracker.py").write_text(code.replace(field.format(1.0), field.format(half_life_s)))
        return run_pytest(tmp_path, TEST.format(options=options, more=more), *arguments)

    return suite


def test_a_regression_test_in_the_repository_of_a_tracker_fails_when_it_is_worse(suite, tmp_path):
    missing = suite()
    assert missing.code == 1
    assert "there is no such baseline" in missing.out
    assert "To make it: pytest test_it.py::test_fading --gridtrack-update-baseline" in missing.out

    assert suite("--gridtrack-update-baseline").code == 0
    assert json.loads((tmp_path / "fading.json").read_text())["runs"][0]["trackers"].keys() == {"mine"}
    assert suite().code == 0

    worse = suite(half_life_s=0.05)
    assert worse.code == 1
    assert "worse: mine, dynamic, 0.5 to 1.5 s: F1 0." in worse.out
    assert "Traceback" not in worse.out
    assert suite(half_life_s=0.05, more=", tolerance=0.9").code == 0

    other = suite(options=":half_life_s=0.05")
    assert other.code == 1
    assert "mine is not the tracker of the baseline (options: none in the baseline, half_life_s=0.05" in other.out


@pytest.mark.usefixtures("trackers_here")
def test_a_path_of_an_option_is_relative_to_the_test_and_a_url_stays_as_it_is(tmp_path):
    fixture = TrackerRegression(tmp_path, tmp_path, "a test", None)
    assert fixture.located("site/weights") == str(tmp_path / "site" / "weights")
    assert fixture.located("s3://bucket/demo.mcap@0s-9s") == "s3://bucket/demo.mcap@0s-9s"


@pytest.mark.usefixtures("trackers_here")
def test_two_tests_that_write_one_baseline_are_refused(tmp_path):
    code = """
def test_one(tracker_regression):
    tracker_regression("{0}", "demo.mcap@90s-97s", baseline="one.json", horizon_s=1.0, every_s=0.5)

def test_two(tracker_regression):
    tracker_regression("{1}", "demo.mcap@90s-97s", baseline="./one.json", horizon_s=1.0, every_s=0.5)
"""
    (tmp_path / "demo.mcap").symlink_to(packaged_recording("leg_tracker"))
    done = run_pytest(tmp_path, code.format("persistence", "blank"), "--gridtrack-update-baseline")
    assert (done.code, "1 failed, 1 passed" in done.out) == (1, True)
    assert "one.json: has the baseline of persistence on demo.mcap@90s-97s in test_it.py::test_one: name" in done.out
    assert json.loads((tmp_path / "one.json").read_text())["runs"][0]["trackers"].keys() == {"persistence"}


def test_an_option_that_does_not_exist_is_an_error_of_one_line(suite):
    done = suite(more=", horizon=2")
    assert done.code == 1
    assert "there is no option 'horizon'; did you mean 'horizon_s'?" in done.out
    assert "Traceback" not in done.out


@pytest.mark.usefixtures("bad_trackers", "trackers_here")
def test_a_broken_clause_of_the_contract_is_named_with_the_remedy(tmp_path):
    done = run_pytest(tmp_path, 'def test_it(tracker_contract):\n    tracker_contract("counts-predictions")\n')
    assert done.code == 1
    assert "counts-predictions does not keep the contract: 13 passed, 2 not applicable, 1 failed" in done.out
    assert "failed          predict-keeps-the-state  predicted twice in a row" in done.out
    assert "to mend:  Copy the state" in done.out
    assert "repeatable " not in done.out


def test_the_plugin_imports_no_large_library():
    code = "import gridtrack.reports.pytest_plugin, sys; print(*sorted(sys.modules))"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert not {"numpy", "pydantic", "polars", "pyarrow", "numba", "typer", "rich", "torch"} & set(loaded)
