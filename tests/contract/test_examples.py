"""The examples work as their pages describe: an installed package, and a C++ program that implements the wire."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from gridtrack.common.grid import GridSpec
from gridtrack.evaluation.processes.contract_scene import scene
from gridtrack.evaluation.processes.contract_suite import check_tracker
from gridtrack.evaluation.processes.limits import Limits
from gridtrack.evaluation.processes.tracker_process import TrackerProcess
from gridtrack.trackers.contract import StreamSpec
from gridtrack.trackers.selection import Launch, launch, read_trackers_toml
from gridtrack.trackers.template import new_tracker

EXAMPLES = Path(__file__).parents[2] / "examples"
STREAM = StreamSpec(GridSpec(40, 0.2), 0.125)


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The example package, installed by pip into a separate folder."""
    folder = tmp_path_factory.mktemp("example")
    shutil.copytree(EXAMPLES / "example_tracker", folder / "source")
    pip_install(folder / "source", folder / "site")
    return folder


def pip_install(source: Path, site: Path) -> None:
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-index"]
    options = ["--no-deps", "--no-build-isolation", "--target", str(site), str(source)]
    subprocess.run([*command, *options], check=True)


@pytest.fixture
def example(installed: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("PYTHONPATH", str(installed / "site"))
    monkeypatch.syspath_prepend(str(installed / "site"))
    return installed


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Launch:
    """The C++ tracker, built by its Makefile and named in a trackers.toml."""
    if shutil.which("make") is None or shutil.which(os.environ.get("CXX", "g++")) is None:
        pytest.skip("no C++ compiler here")
    folder = tmp_path_factory.mktemp("cpp") / "cpp_tracker"
    shutil.copytree(EXAMPLES / "cpp_tracker", folder, ignore=shutil.ignore_patterns("fading_tracker"))
    subprocess.run(["make", "--silent", "-C", str(folder)], check=True)
    (folder / "trackers.toml").write_text('[fading-cpp]\ncommand = "./fading_tracker"\n')
    return read_trackers_toml(folder / "trackers.toml")["fading-cpp"]


def test_the_example_package_passes_its_own_tests(example: Path) -> None:
    tests = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--import-mode=importlib", "tests"]
    subprocess.run(tests, cwd=example / "source", check=True)


def test_a_new_tracker_package_installs_satisfies_the_contract_and_passes_its_tests(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = new_tracker("my-own-2", tmp_path / "package")
    assert module == tmp_path / "package" / "my_own_2.py"
    written = "".join(path.read_text() for path in (tmp_path / "package").rglob("*.*") if path.is_file())
    assert "example" not in written
    assert "class MyOwn2Tracker(Tracker)" in written
    pip_install(tmp_path / "package", tmp_path / "site")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "site"))
    monkeypatch.syspath_prepend(str(tmp_path / "site"))
    results = check_tracker(launch("my-own-2"), STREAM)
    assert len(results) == 10
    assert [result for result in results if result.verdict != "passed"] == []
    tests = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--import-mode=importlib", "tests"]
    subprocess.run(tests, cwd=tmp_path / "package", check=True)


def test_the_program_in_cpp_satisfies_the_contract(program: Launch) -> None:
    assert [r for r in check_tracker(program, STREAM) if r.verdict != "passed"] == []


def test_the_program_in_cpp_refuses_options(program: Launch) -> None:
    (result,) = check_tracker(program, STREAM, {"half_life_s": 2})
    assert (result.verdict, result.detail) == ("failed", "not-applicable: this tracker has no options")


@pytest.mark.usefixtures("example")
def test_both_examples_forecast_the_same(program: Launch, tmp_path: Path) -> None:
    with (
        TrackerProcess(launch("fading"), STREAM, {}, Limits(), tmp_path / "python.log") as one,
        TrackerProcess(program, STREAM, {}, Limits(), tmp_path / "cpp.log") as other,
    ):
        for tracker in (one, other):
            tracker.reset(0)
        for frame in scene(STREAM.grid, STREAM.period_s, 12, seed=1):
            one.update(frame)
            other.update(frame)
        a, b = one.predict(10).occupancy, other.predict(10).occupancy
    assert a.max() > 0.9
    np.testing.assert_allclose(a, b, atol=1e-6)
