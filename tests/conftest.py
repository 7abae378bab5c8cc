"""Plugins for the tests: distributions made on the fly, on the path of this process and of its children."""

from __future__ import annotations

import os
import re
import signal
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import pytest

from gridtrack.evaluation.processes.supervisor import PR_SET_CHILD_SUBREAPER, prctl

os.environ.setdefault("OMP_NUM_THREADS", "1")  # workers fill the cores: two threads beside a busy core crawl

# a shell that runs the tests in the background has them ignore Ctrl-C, and with them every process that they start
signal.signal(signal.SIGINT, signal.default_int_handler)

PLUGINS = Path(__file__).parent / "plugins"

Install = Callable[..., Path]


@pytest.fixture(scope="session", autouse=True)
def own_cache_of_stretches(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """What a training keeps is that of this session: no test passes on frames that earlier code made."""
    folder = tmp_path_factory.mktemp("cache")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("gridtrack.common.cache.user_cache_folder", lambda: folder)
        yield


@pytest.fixture(autouse=True)
def adopts_no_orphans() -> Iterator[None]:
    """A command that ran in this process has made it the parent of orphans, which other tests expect to be gone."""
    yield
    prctl(PR_SET_CHILD_SUBREAPER, 0)


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
        info = site / f"{distribution.replace('-', '_')}-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.4\nName: {distribution}\nVersion: 1.0\n{requires}")
        lines = [f"[{group}]", *(f"{name} = {value}" for name, value in points.items())]
        (info / "entry_points.txt").write_text("\n".join(lines) + "\n")
        for name, text in (files or {}).items():
            (site / name).write_text(text)
        return site

    return install


@pytest.fixture
def bad_trackers(install: Install) -> None:
    """Registers every tracker of plugins/bad_trackers.py: class ForksAndLives as `forks-and-lives`."""
    source = (PLUGINS / "bad_trackers.py").read_text()
    classes = re.findall(r"^class ([A-Z]\w+)\(", source, re.MULTILINE)
    points = {re.sub(r"(?<!^)(?=[A-Z])", "-", name).lower(): f"bad_trackers:{name}" for name in classes}
    install("bad-trackers", points, {"bad_trackers.py": source})
