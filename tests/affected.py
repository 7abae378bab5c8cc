"""Check of a change: lint of the changed files, and the tests of the changed modules and their importers.

`PYTHONPATH=tests python -m affected [--since REV]` (`make check`) looks at the working tree against REV, by default the
last commit. Tests that import a changed module run first, then tests of its importers. After a minute the other tests
are skipped and counted: `make test` runs all. Types are checked last, from mypy's cache.
"""

from __future__ import annotations

import argparse
import ast
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import grimp
import pytest

ROOT = Path(__file__).parents[1]
MINUTE_S = 50.0
"""Time in which tests begin; the last of them then end within the minute."""
COMMANDS = ("benchmarks/", "studies/")
OTHER_FOLDERS = ("tests/", "examples/", "docs/", *COMMANDS)
"""Folders of modules that are not in the package."""
EVERY_COMMAND = "tests/studies/test_modules.py"
"""The tests that start each module of COMMANDS by its name."""
UNTIL = "GRIDTRACK_TESTS_BEGIN_UNTIL"
"""Environment variable: the time, in seconds since 1970, after which no test begins."""


def changed_files(since: str) -> list[str]:
    """The Python files that differ from the revision `since`, or are new: paths relative to the root."""
    differ = _git("diff", "--name-only", "--diff-filter=d", since, "--", "*.py")
    new = _git("ls-files", "--others", "--exclude-standard", "--", "*.py")
    return sorted({*differ, *new})


def _git(*words: str) -> list[str]:
    return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True).stdout.splitlines()


def affected_tests(changed: Sequence[str]) -> list[str]:
    """Files of tests: first the changed ones, then the ones that import a changed module, then an importer of it."""
    graph = grimp.build_graph("gridtrack")
    modules = {_module(path) for path in changed}
    known = modules & graph.modules
    importers = {importer for name in known for importer in graph.find_modules_that_directly_import(name)}
    imported = {str(path.relative_to(ROOT)): set(_imports(path)) for path in (ROOT / "tests").rglob("test_*.py")}
    nearest = [path for path in changed if path in imported]
    near = [path for path, names in imported.items() if names & modules]
    far = [path for path, names in imported.items() if names & importers]
    each = [EVERY_COMMAND] if any(path.startswith(COMMANDS) for path in changed) else []
    return list(dict.fromkeys([*nearest, *near, *each, *far]))


def _module(path: str) -> str:
    package = () if path.startswith(OTHER_FOLDERS) else ("gridtrack",)
    return ".".join((*package, *Path(path).with_suffix("").parts)).removesuffix(".__init__")


def _imports(path: Path) -> Iterator[str]:
    """The modules that a file names in its imports; of `from a import b` both `a` and `a.b`."""
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)


def pytest_runtest_setup() -> None:
    """Skip a test that would begin too late."""
    if time.time() > float(os.environ[UNTIL]):
        pytest.skip("the minute of `make check` is over")


def main(arguments: Sequence[str] | None = None) -> int:
    """Lint and test the affected files. Returns the exit code."""
    parser = argparse.ArgumentParser(prog="affected", description=__doc__.partition("\n")[0])
    parser.add_argument("--since", metavar="REV", default="HEAD", help="compare with this revision")
    changed = changed_files(parser.parse_args(arguments).since)
    if not changed:
        print("no Python file has changed")
        return 0
    tests = affected_tests(changed)
    print(f"{len(changed)} changed files, {len(tests)} files of tests", flush=True)
    os.environ |= {UNTIL: str(time.time() + MINUTE_S), "MYPYPATH": ".link"}
    lint = ("ruff check", "ruff format --check", "codespell_lib")
    modules = [word for path in changed if not path.startswith(OTHER_FOLDERS) for word in ("-m", _module(path))]
    pytest_words = ("pytest", "-q", "-p", "affected", "-n", str(os.cpu_count()), "--dist", "load")
    passed = [
        *(_passes(*words.split(), *changed) for words in lint),
        not tests or _passes(*pytest_words, *tests),
        not modules or _passes("mypy", *modules),
    ]
    return int(not all(passed))


def _passes(*words: str) -> bool:
    return subprocess.run([sys.executable, "-m", *words], cwd=ROOT, check=False).returncode == 0


if __name__ == "__main__":
    sys.exit(main())
