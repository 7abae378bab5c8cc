"""SVG documents of the drawings in docs/results."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path


def svg_path(text: str) -> Path:
    """An argument of a command: the file of a drawing. Raises ArgumentTypeError for another suffix than .svg."""
    path = Path(text)
    if path.suffix != ".svg":
        raise argparse.ArgumentTypeError(f"{text}: the drawing is written as SVG: end its name in .svg")
    return path


def document(width: float, height: float, parts: Sequence[str], font_size: int) -> str:
    """`parts` on a white page of this size."""
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" font-family="sans-serif"'
        f' font-size="{font_size}"><rect width="100%" height="100%" fill="white"/>{"".join(parts)}</svg>\n'
    )
