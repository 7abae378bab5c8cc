"""The layout of Foxglove that ships: panels for recordings and for `forecasts.mcap`, looked down on from above."""

from __future__ import annotations

from pathlib import Path

LAYOUT_FILE = Path(__file__).parent / "assets" / "foxglove_layout.json"


def foxglove_layout() -> str:
    """The layout as Foxglove imports it, JSON."""
    return LAYOUT_FILE.read_text("utf-8")
