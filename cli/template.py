"""A new tracker package: the example, under another name."""

from __future__ import annotations

import keyword
import re
import sys
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path

from gridtrack.common.errors import ConfigurationError
from gridtrack.common.files import write_text
from gridtrack.evaluation.regression.baseline import write_baseline
from gridtrack.evaluation.regression.measurement import Baseline
from gridtrack.trackers import registry

EXAMPLE = "examples/example_tracker"
TEMPLATE_FILES = (
    "README.md",
    "pyproject.toml",
    ".github/workflows/test.yml",
    "example_tracker.py",
    "tests/test_example_tracker.py",
)
BASELINE_FILE = "tests/example_tracker.json"
MAX_NAME = 60
PACKAGE_NAME = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")


def new_tracker(name: str, folder: Path) -> Path:
    """Write a tracker package called `name` into the new folder `folder`, and return its module.

    It can be installed, passes its tests, keeps the contract, and has a baseline of its scores. Raises
    ConfigurationError.
    """
    module = name.replace("-", "_")
    if len(name) > MAX_NAME or not PACKAGE_NAME.fullmatch(name) or keyword.iskeyword(module):
        raise ConfigurationError(
            f"'{name}' is not a valid name of a tracker package: use a-z, 0-9 and -, at most {MAX_NAME}, such as"
            " my-tracker"
        )
    if name in registry.entries():
        raise ConfigurationError(f"a tracker '{name}' exists: choose another name")
    if module in sys.stdlib_module_names or find_spec(module):
        raise ConfigurationError(f"a Python module '{module}' exists: choose another name")
    if folder.exists() or folder.is_symlink():
        raise ConfigurationError(f"{folder}: exists; choose another folder with --out")
    for file in TEMPLATE_FILES:
        write_text(_new_file(folder, file, module), _renamed(_example(file), name, module))
    renamed = Baseline.model_validate_json(_renamed(_example(BASELINE_FILE), name, module))
    write_baseline(_new_file(folder, BASELINE_FILE, module), renamed.runs)
    return folder / f"{module}.py"


def _example(file: str) -> str:
    return files("gridtrack").joinpath(EXAMPLE, file).read_text("utf-8")


def _new_file(folder: Path, file: str, module: str) -> Path:
    path = folder / file.replace("example_tracker", module)
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


def _renamed(text: str, name: str, module: str) -> str:
    """The example's text with its distribution, module, classes and registered name replaced."""
    camel = "".join(part.capitalize() for part in name.removesuffix("-tracker").split("-"))
    for old, new in (
        ("example-tracker", name),
        ("example_tracker", module),
        ("FadingTracker", f"{camel}Tracker"),
        ("FadingOptions", f"{camel}Options"),
    ):
        text = text.replace(old, new)
    # `fading` is the registered name; the method keeps its name, fading memory
    return re.sub(r"\bfading\b(?! memory)", name, text)
