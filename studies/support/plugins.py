"""Distributions made on the fly: entry points and modules, as if they were installed."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path


def write_distribution(
    site: Path,
    distribution: str,
    points: Mapping[str, str],
    files: Mapping[str, str],
    *,
    group: str,
    requires: str = "",
) -> None:
    """Write a distribution with entry points {name: "module:attribute"} of a `group`, and {file: text}, into `site`.

    `requires`: lines of its metadata. `site` must be on the import path.
    """
    info = site / f"{distribution.replace('-', '_')}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.4\nName: {distribution}\nVersion: 1.0\n{requires}")
    lines = [f"[{group}]", *(f"{name} = {value}" for name, value in points.items())]
    (info / "entry_points.txt").write_text("\n".join(lines) + "\n")
    for name, text in files.items():
        (site / name).write_text(text)


def every_class(module: Path) -> dict[str, str]:
    """The entry points of all classes in a module that have a base: class ForksAndLives as `forks-and-lives`."""
    classes = re.findall(r"^class ([A-Z]\w+)\(", module.read_text("utf-8"), re.MULTILINE)
    return {re.sub(r"(?<!^)(?=[A-Z])", "-", name).lower(): f"{module.stem}:{name}" for name in classes}
