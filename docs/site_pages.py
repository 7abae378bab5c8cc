"""Hook of `mkdocs`: the files of the site are the repository's, at their own paths.

So a link from a page to a page, a heading or a file means the same on the site as in the repository, and `--strict`
checks those that leave docs/ too.
"""

from __future__ import annotations

from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parents[1]
OUTSIDE = ("README.md", "CHANGELOG.md", "CONTRIBUTING.md", "RELEASING.md", "LICENSE", "examples/**/*", "data/**/*.md")
"""Files of the site outside docs/."""
NOT_SHOWN = (".py", ".pyc", ".txt")
"""Files of docs/ that no page links to."""
PACKAGE = ROOT / ".link" / "docs" / "gridtrack"
"""The package as mkdocstrings reads it: it follows links, and from .link/ it would read the environment too."""
PARTS = ("__init__.py", "cli", "common", "evaluation", "recordings", "reports", "simulation", "trackers")


def on_startup(**_: object) -> None:
    """Link the parts of the package into PACKAGE, before mkdocstrings looks for it."""
    PACKAGE.mkdir(parents=True, exist_ok=True)
    for name in PARTS:
        if not (PACKAGE / name).is_symlink():
            (PACKAGE / name).symlink_to(ROOT / name)


def on_files(files: Files, *, config: MkDocsConfig) -> Files:
    """The files of the site in place of the files of docs/ alone."""
    found = (path for pattern in ("docs/**/*", *OUTSIDE) for path in sorted(ROOT.glob(pattern)))
    shown = dict.fromkeys(path for path in found if path.is_file() and path.suffix not in NOT_SHOWN)
    kept = [file for file in files if file.src_dir != config.docs_dir]  # of the theme and of plugins
    own = [File.generated(config, path.relative_to(ROOT).as_posix(), abs_src_path=str(path)) for path in shown]
    return Files([*kept, *own])


def on_post_page(output: str, **_: object) -> str:
    """The page with a name for the dialog of the search, to which the theme gives none."""
    return output.replace('role="dialog"', 'role="dialog" aria-label="Search"', 1)
