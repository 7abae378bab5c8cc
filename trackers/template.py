"""A tracker package to begin with: the example, under a name of one's own."""

from __future__ import annotations

import keyword
import re
from importlib.resources import files
from pathlib import Path

from gridtrack.common.errors import ConfigurationError
from gridtrack.trackers import registry

EXAMPLE = "examples/example_tracker"
TEMPLATE_FILES = ("README.md", "pyproject.toml", "example_tracker.py", "tests/test_example_tracker.py")
PACKAGE_NAME = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")


def new_tracker(name: str, folder: Path) -> Path:
    """Write a whole tracker package called `name` into `folder`, which must not exist yet, and return its module.

    It installs, passes its tests and keeps the contract as it is. Raises ConfigurationError.
    """
    module = name.replace("-", "_")
    if not PACKAGE_NAME.fullmatch(name) or keyword.iskeyword(module):
        raise ConfigurationError(f"'{name}' is no name for a tracker: expected small letters, digits and -: my-tracker")
    if name in registry.entries():
        raise ConfigurationError(f"there is a tracker '{name}' already: choose another name")
    if folder.exists():
        raise ConfigurationError(f"{folder}: exists already; choose another folder with --out")
    for file in TEMPLATE_FILES:
        path = folder / file.replace("example_tracker", module)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(_renamed(files("gridtrack").joinpath(EXAMPLE, file).read_text("utf-8"), name, module), "utf-8")
    return folder / f"{module}.py"


def _renamed(text: str, name: str, module: str) -> str:
    """The example's text with its distribution, module, classes and registered name replaced."""
    camel = "".join(part.capitalize() for part in name.split("-"))
    for old, new in (
        ("example-tracker", name),
        ("example_tracker", module),
        ("FadingTracker", f"{camel}Tracker"),
        ("FadingOptions", f"{camel}Options"),
    ):
        text = text.replace(old, new)
    # the registered name is `fading`; the method, a fading memory, keeps its name until it is replaced
    return re.sub(r"\bfading\b(?! memory)", name, text)
