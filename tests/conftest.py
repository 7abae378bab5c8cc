"""Plugins for the tests: distributions made on the fly, on the path of this process and of its children."""

from __future__ import annotations

import gc
import os
import shutil
import signal
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import hypothesis
import pytest

from studies.support.plugins import every_class, write_distribution

os.environ.setdefault("OMP_NUM_THREADS", "1")  # workers fill the cores: two threads beside a busy core crawl

# a shell that runs the tests in the background has them ignore Ctrl-C, and with them every process that they start
signal.signal(signal.SIGINT, signal.default_int_handler)

# a loaded machine may take any time for an example
hypothesis.settings.register_profile("loaded", deadline=None, suppress_health_check=[hypothesis.HealthCheck.too_slow])
hypothesis.settings.load_profile("loaded")

PLUGINS = Path(__file__).parent / "plugins"

Install = Callable[..., Path]
LONGEST = (
    *("test_contract.py", "test_commands_run.py", "test_own_trackers.py", "test_examples.py", "test_package.py"),
    *("test_remote.py", "test_slurm.py", "test_ray.py", "test_run_processes.py", "test_sandbox.py", "test_modules.py"),
    "test_compare_drive.py",
)
"""They start first, so that no processor waits for them at the end; kernels that others use are compiled in them."""


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """The garbage collector leaves out all that is loaded here: to walk it again and again took a tenth of the time."""
    gc.disable()
    result = yield
    gc.collect()
    gc.freeze()
    gc.set_threshold(10_000)  # from 700 objects: rows of tables and pages alone fill that in a moment
    gc.enable()
    return result


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Put the longest modules first where all tests run; `make check` has an order of its own."""
    if config.args == config.getini("testpaths"):
        items.sort(key=lambda item: LONGEST.index(item.path.name) if item.path.name in LONGEST else len(LONGEST))


@pytest.fixture(scope="session", autouse=True)
def own_cache_of_stretches(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Frames of trainings and copies of recordings are kept for this session only: none is of earlier code."""
    folder = tmp_path_factory.mktemp("cache")
    with pytest.MonkeyPatch.context() as patch:
        for module in ("common.cache", "recordings.importing"):
            patch.setattr(f"gridtrack.{module}.user_cache_folder", lambda: folder)
        yield


@pytest.fixture(scope="session", autouse=True)
def shipped_recordings_are_read_once() -> Iterator[None]:
    """Recordings that ship with gridtrack are surveyed and read once in a session: their files stay as they are."""
    from scenes.read_once import shipped_recordings_read_once

    with shipped_recordings_read_once():
        yield


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Install:
    """`install(distribution, {name: "module:attribute"}, {file: text})` installs a distribution with entry points."""
    site = tmp_path / "site"
    site.mkdir()
    monkeypatch.syspath_prepend(str(site))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, (str(site), os.environ.get("PYTHONPATH")))))

    def install(
        distribution: str,
        points: Mapping[str, str],
        files: Mapping[str, str] | None = None,
        requires: str = "",
        group: str = "gridtrack.trackers",
    ) -> Path:
        write_distribution(site, distribution, points, files or {}, requires=requires, group=group)
        return site

    return install


@pytest.fixture
def bad_trackers(install: Install) -> None:
    """Registers every tracker of plugins/bad_trackers.py: class ForksAndLives as `forks-and-lives`."""
    module = PLUGINS / "bad_trackers.py"
    install("bad-trackers", every_class(module), {module.name: module.read_text()})


@pytest.fixture
def burglar(install: Install) -> None:
    """Registers the tracker `burglar`, which attacks as its options say."""
    module = PLUGINS / "burglar.py"
    install("burglar", {"burglar": "burglar:Burglar"}, {module.name: module.read_text()})


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """Chromium, one for all tests; they are skipped if there is none.

    Its driver runs an event loop in this thread: code with a loop of its own runs in another thread.
    """
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright, of the extra dev, is not installed")
    if (program := shutil.which("chromium")) is None:
        pytest.skip("Chromium is not installed (Debian: apt install chromium)")
    with playwright.sync_playwright() as driver:
        chromium = driver.chromium.launch(executable_path=program, args=["--no-sandbox"])
        yield chromium
        chromium.close()


@pytest.fixture
def bucket() -> Iterator[Any]:
    """The store of fsspec in memory; files of a test below /bucket are removed after it."""
    fsspec = pytest.importorskip("fsspec", reason="fsspec, of the extra remote, is not installed")
    files = fsspec.filesystem("memory")
    yield files
    files.rm("/bucket", recursive=True)


@pytest.fixture(scope="session")
def serious_findings() -> Callable[[Any], list[tuple[str, str]]]:
    """Serious and critical findings of axe-core on an open page: (rule, HTML of the first element)."""
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe, of the extra dev, is not installed")

    def found(page: Any) -> list[tuple[str, str]]:
        violations = axe.Axe().run(page).response["violations"]
        return [(one["id"], one["nodes"][0]["html"]) for one in violations if one["impact"] in ("serious", "critical")]

    return found


class Done(NamedTuple):
    """A command that has ended: its exit code and its output."""

    code: int
    out: str
    err: str


@pytest.fixture
def gridtrack(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., Done]:
    """`gridtrack(*words)` runs the command in this process, as from a terminal."""
    from gridtrack.cli import main

    def gridtrack(*words: object) -> Done:
        monkeypatch.setattr(sys, "argv", ["gridtrack", *map(str, words)])
        capsys.readouterr()
        try:
            main()
        except SystemExit as end:
            return Done(int(end.code or 0), *capsys.readouterr())
        return Done(0, *capsys.readouterr())

    return gridtrack


@pytest.fixture
def trackers_here() -> Iterator[None]:
    """Trackers and trainings run in this process: for claims that are not about processes."""
    from scenes.programs_here import programs_here

    with programs_here():
        yield
