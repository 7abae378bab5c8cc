"""Size of the repository: lines, files, files with one importer, repeated names, words of Markdown, glossary entries.

`python -m studies.size [REV]` (two seconds) counts the tracked files of the working tree; with REV also the files of
that revision, in a column before.
"""

from __future__ import annotations

import argparse
import ast
import io
import posixpath
import re
import subprocess
import tarfile
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from studies.support.results_file import measured_table

ROOT = Path(__file__).parents[1]
KINDS = ("*.py", "*.js", "*.md")
NOT_PRODUCT = ("tests/", "examples/", "docs/")
JS_IMPORT = re.compile(r'^(?:import|export)\b[^;"]*"(\./[\w./-]+\.js)"', re.MULTILINE)
ENTRY = re.compile(r"^- \*\*", re.MULTILINE)
"""An entry of the glossary."""

Texts = Mapping[str, str]
"""Text by path, relative to the root of the repository."""


def working_tree() -> dict[str, str]:
    """The tracked files of the working tree."""
    names = _git("ls-files", *KINDS).decode().splitlines()
    return {name: (ROOT / name).read_text("utf-8") for name in names if (ROOT / name).is_file()}


def revision(name: str) -> dict[str, str]:
    """The files of a revision. Raises CalledProcessError for an unknown one."""
    with tarfile.open(fileobj=io.BytesIO(_git("archive", name, *KINDS))) as archive:
        files = ((member.name, archive.extractfile(member)) for member in archive if member.isfile())
        return {path: file.read().decode() for path, file in files if file is not None}


def _git(*words: str) -> bytes:
    return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, check=True).stdout


def measured(texts: Texts) -> dict[str, int]:
    """The counts by their names."""
    code = {path: text for path, text in texts.items() if not path.endswith(".md")}
    product = {path: text for path, text in code.items() if not path.startswith(NOT_PRODUCT)}
    tests = [text for path, text in code.items() if path.startswith("tests/")]
    trees = {path: ast.parse(text) for path, text in product.items() if path.endswith(".py")}
    importers = Counter(target for path in product for target in imported(path, product, trees))
    defined = Counter(name for tree in trees.values() for name in set(names_in(tree)))
    return {
        "lines of Python and JavaScript": _lines(product.values()),
        "files": len(product),
        "files with one importer": sum(count == 1 for count in importers.values()),
        "names that several modules define": sum(count > 1 for count in defined.values()),
        "lines of tests": _lines(tests),
        "files of tests": len(tests),
        "words of Markdown": sum(len(text.split()) for path, text in texts.items() if path.endswith(".md")),
        "entries of the glossary": len(ENTRY.findall(texts.get("docs/glossary.md", ""))),
    }


def _lines(texts: Iterable[str]) -> int:
    return sum(text.count("\n") for text in texts)


def imported(path: str, product: Texts, trees: Mapping[str, ast.Module]) -> set[str]:
    """The files of the product that a file imports; a package's `__init__.py` is no file of its own."""
    if path.endswith(".js"):
        return {
            posixpath.normpath(posixpath.join(posixpath.dirname(path), one)) for one in JS_IMPORT.findall(product[path])
        }
    found = (_file_of(name, trees) for node in ast.walk(trees[path]) for name in _modules(node))
    return {one for one in found if one is not None and one != path}


def _modules(node: ast.AST) -> Iterator[str]:
    """The imported names; each may be a module, or a definition in one."""
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names)
    elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
        yield from (f"{node.module}.{alias.name}" for alias in node.names)


def _file_of(name: str, trees: Mapping[str, ast.Module]) -> str | None:
    """`gridtrack.common.grid.GridSpec` and `gridtrack.common.grid` are of common/grid.py."""
    parts = name.removeprefix("gridtrack.").split(".")
    paths = ("/".join(parts[:length]) + ".py" for length in (len(parts), len(parts) - 1))
    return next((path for path in paths if path in trees), None)


def names_in(tree: ast.Module) -> Iterator[str]:
    """The functions, classes and variables that a module defines."""
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield node.name
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names = (part for target in targets for part in ast.walk(target) if isinstance(part, ast.Name))
            yield from (name.id for name in names if isinstance(name.ctx, ast.Store))


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("revision", nargs="?", help="such as HEAD~20 or v0.2.0")
    given = parser.parse_args(arguments)
    columns = {given.revision: measured(revision(given.revision))} if given.revision else {}
    columns["working tree"] = measured(working_tree())
    rows = [[name, *(f"{of[name]:,}" for of in columns.values())] for name in columns["working tree"]]
    print(measured_table(("", *columns), rows).markdown())


if __name__ == "__main__":
    main()
