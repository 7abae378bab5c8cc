"""The file of a drawing in docs/results, as an argument of a command."""

from __future__ import annotations

import argparse
from pathlib import Path


def svg_path(text: str) -> Path:
    """An argument of a command: the file of a drawing. Raises ArgumentTypeError for another suffix than .svg."""
    path = Path(text)
    if path.suffix != ".svg":
        raise argparse.ArgumentTypeError(f"{text}: the drawing is written as SVG: end its name in .svg")
    return path
