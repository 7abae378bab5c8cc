"""A template of a tracker package: the example, under another name."""

from __future__ import annotations

import keyword
import re
from importlib.resources import files
from pathlib import Path

from gridtrack.common.errors import ConfigurationError
from gridtrack.common.files import write_text
from gridtrack.trackers import registry

EXAMPLE = "examples/example_tracker"
TEMPLATE_FILES = ("README.md", "pyproject.toml", "example_tracker.py", "tests/test_example_tracker.py")
PACKAGE_NAME = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")


def new_tracker(name: str, folder: Path) -> Path:
    """Write a tracker package called `name` into the new folder `folder`, and return its module.

    It can be installed, passes its tests and keeps the contract. Raises ConfigurationError.
    """
    module = name.replace("-", "_")
    if not PACKAGE_NAME.fullmatch(name) or keyword.iskeyword(module):
        raise ConfigurationError(
            f"'{name}' is not a valid name of a tracker package: use a-z, 0-9 and -, such as my-tracker"
        )
    if name in registry.entries():
        raise ConfigurationError(f"a tracker '{name}' exists: choose another name")
    if folder.exists():
        raise ConfigurationError(f"{folder}: exists; choose another folder with --out")
    for file in TEMPLATE_FILES:
        path = folder / file.replace("example_tracker", module)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, _renamed(files("gridtrack").joinpath(EXAMPLE, file).read_text("utf-8"), name, module))
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
    # `fading` is the registered name; the method keeps its name, fading memory
    return re.sub(r"\bfading\b(?! memory)", name, text)
