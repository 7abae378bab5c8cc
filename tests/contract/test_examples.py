"""The examples work as their pages describe: an installed package, and a C++ program that implements the wire."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gridtrack.cli.trackers import new_tracker
from gridtrack.common.errors import ConfigurationError
from gridtrack.common.grid import GridSpec
from gridtrack.evaluation.hosting.contract_scene import scene
from gridtrack.evaluation.hosting.contract_suite import check_tracker
from gridtrack.evaluation.hosting.limits import Limits
from gridtrack.evaluation.hosting.tracker_process import TrackerProcess
from gridtrack.recordings import packaged_recording
from gridtrack.trackers.contract import StreamSpec
from gridtrack.trackers.selection import Launch, launch, read_trackers_toml

from studies.support.plugins import write_distribution

EXAMPLES = Path(__file__).parents[2] / "examples"
DEMO = packaged_recording("leg_tracker")
QUICK = ("--horizon", "0.5s", "--every", "0.5s", "--validation", f"{DEMO}@75s-78s", "--json")
STREAM = StreamSpec(GridSpec(40, 0.2), 0.125)
OFFLINE = {"PIP_NO_INDEX": "1", "PIP_NO_BUILD_ISOLATION": "0"}  # 0: pip reads the variable inverted
"""For pip: without a package index, and built by the setuptools that is here."""


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The example package, installed by pip into a separate folder."""
    folder = tmp_path_factory.mktemp("example")
    shutil.copytree(EXAMPLES / "example_tracker", folder / "source")
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-index"]
    options = ["--no-deps", "--no-build-isolation", "--target", str(folder / "site"), str(folder / "source")]
    subprocess.run([*command, *options], check=True)
    return folder


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


def test_a_new_package_works_in_a_fresh_environment_by_the_lines_of_its_ci_file(tmp_path: Path) -> None:
    folder = tmp_path / "package"
    assert new_tracker("my-own-2", folder) == folder / "my_own_2.py"
    written = [path.read_text() for path in folder.rglob("*") if path.is_file()]
    assert len(written) == 6
    assert not re.search("example|Fading", "".join(written))
    assert set(re.findall(r"^(?:from|import) (\w+)", (folder / "my_own_2.py").read_text(), re.MULTILINE)) == {
        "__future__",
        "numpy",
        "gridtrack",
    }
    python = fresh_environment(tmp_path / "env")
    lines = re.findall(r"- run: (.+)", (folder / ".github" / "workflows" / "test.yml").read_text())
    refused = run_line(lines[0], python, folder, gridtrack="")
    assert refused.returncode
    assert "say in this file from where pip installs gridtrack" in refused.stderr
    for line in lines:
        done = run_line(line, python, folder, gridtrack="gridtrack")  # which this environment has
        assert done.returncode == 0, done.stdout + done.stderr


def run_line(line: str, python: Path, folder: Path, *, gridtrack: str) -> subprocess.CompletedProcess[str]:
    """Run a line of a workflow in `folder`, by the shell of its service, with `python` and this value of GRIDTRACK."""
    environment = os.environ | OFFLINE | {"PATH": f"{python.parent}:{os.environ['PATH']}", "GRIDTRACK": gridtrack}
    command = ["bash", "-c", line]
    return subprocess.run(command, check=False, cwd=folder, env=environment, capture_output=True, text=True)


def test_a_tracker_is_compared_in_an_environment_with_another_numpy(tmp_path: Path) -> None:
    python, other = fresh_environment(tmp_path / "env"), "2.4.3" if np.__version__ != "2.4.3" else "2.4.2"
    require_from_index(f"numpy=={other}", python)
    assert run_python(python, "-c", "import numpy; print(numpy.__version__)", cwd=tmp_path).strip() == other
    module = new_tracker("my-own-2", tmp_path / "package")
    (site,) = python.parents[1].glob("lib/python*/site-packages")  # of this environment alone: it shows which one ran
    (name,) = re.findall(r"^class (\w+)\(Tracker\)", module.read_text(), re.MULTILINE)
    points, files = {"my-own-2": f"my_own_2:{name}"}, {module.name: module.read_text()}
    write_distribution(site, "my-own-2", points, files, group="gridtrack.trackers")
    (tmp_path / "trackers.toml").write_text('[elsewhere]\npython = "env/bin/python"\ntracker = "my-own-2"\n')
    arguments = ("-m", "gridtrack.cli", "compare", f"{DEMO}@114s-118s", "--trackers-toml", "trackers.toml")
    out = run_python(Path(sys.executable), *arguments, "--no-floors", "--tracker", "elsewhere", *QUICK, cwd=tmp_path)
    assert outcomes(out) == {"elsewhere": "ok"}


def require_from_index(requirement: str, python: Path) -> None:
    """Install `requirement` from the package index beside `python`; skip the test where the index is out of reach."""
    (site,) = python.parents[1].glob("lib/python*/site-packages")
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--target", str(site)]
    try:
        patience = ["--retries", "1", "--timeout", "15"]
        subprocess.run([*command, *patience, requirement], check=True, capture_output=True, text=True, timeout=60)
    except (subprocess.CalledProcessError, subprocess.TimeoutExpired) as error:
        pytest.skip(f"{requirement} cannot be installed from a package index: {error.stderr or 'no answer in 60 s'}")


def fresh_environment(folder: Path) -> Path:
    """The Python of a new environment that sees the packages of this one, and into which others can be installed."""
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(folder)], check=True)
    (site,) = folder.glob("lib/python*/site-packages")
    (site / "these_tests.pth").write_text(f"import site; site.addsitedir({sysconfig.get_path('purelib')!r})\n")
    return folder / "bin" / "python"


def run_python(python: Path, *arguments: str, cwd: Path) -> str:
    """The output of `python`, without a package index; a failure shows it."""
    environment = os.environ | OFFLINE
    done = subprocess.run(
        [str(python), *arguments], cwd=cwd, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def outcomes(summary: str) -> dict[str, str]:
    """The outcome of each tracker of a comparison on one recording."""
    trackers = json.loads(summary)["trackers"]
    return {name: trial["outcome"] for name, one in trackers.items() for trial in one["recordings"].values()}


@pytest.mark.parametrize(
    ("name", "problem"),
    [
        ("numpy", "a Python module 'numpy' exists"),
        ("json", "a Python module 'json' exists"),
        ("kalman", "a tracker 'kalman' exists"),
        ("../up", "is not a valid name"),
        ("x" * 61, "is not a valid name"),
        ("my_tracker", "is not a valid name"),
        ("", "is not a valid name"),
    ],
)
def test_a_name_that_cannot_work_is_refused_before_anything_is_written(name: str, problem: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=problem):
        new_tracker(name, tmp_path / "package")
    assert list(tmp_path.iterdir()) == []


def test_a_name_that_says_tracker_is_not_doubled_in_the_class(tmp_path: Path) -> None:
    text = new_tracker("my-tracker", tmp_path / "package").read_text()
    assert "class MyTracker(Tracker):" in text
    assert "my-tracker" not in text.replace("--tracker my-tracker:half_life_s=2", "")


def test_an_existing_folder_is_left_as_it_is(tmp_path: Path) -> None:
    (tmp_path / "mine").write_text("kept")
    (tmp_path / "link").symlink_to(tmp_path / "absent")
    for folder in ("mine", "link"):
        with pytest.raises(ConfigurationError, match="exists; choose another folder with --out"):
            new_tracker("my-own-2", tmp_path / folder)
    assert (tmp_path / "mine").read_text() == "kept"
    assert not (tmp_path / "absent").exists()


def test_the_program_in_cpp_satisfies_the_contract(program: Launch) -> None:
    assert [r for r in check_tracker(program, STREAM) if not r.kept] == []


def test_the_program_in_cpp_is_compared(program: Launch, tmp_path: Path, gridtrack: Any) -> None:
    toml = tmp_path / "trackers.toml"
    toml.write_text(f"[fading-cpp]\ncommand = {json.dumps(str(program.cwd / program.argv[0]))}\n")
    trackers = ("--trackers-toml", str(toml), "--tracker", "fading-cpp")
    done = gridtrack("compare", "--no-floors", f"{DEMO}@114s-118s", *trackers, *QUICK, "--out", tmp_path / "run")
    assert outcomes(done.out) == {"fading-cpp": "ok"}


def test_the_program_in_cpp_refuses_options(program: Launch) -> None:
    with pytest.raises(ConfigurationError, match="this tracker has no options"):
        check_tracker(program, STREAM, {"half_life_s": 2})


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
