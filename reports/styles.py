"""The look of rows in every figure: a colour or grey for a tracker, dashes for a run, as page.css defines them."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path

from gridtrack.reports.run import ReportedRun
from gridtrack.reports.table import row_key

TEMPLATES = Path(__file__).parent / "templates"
TRACKER_COLOURS = 8
REPEATS = ("", " again", " again2", " again3")
"""Further trackers repeat the colours, with other dashes and dots in each round."""
FLOOR_GREYS, RUN_DASHES = 5, 4
"""Further floors repeat the greys; further runs repeat the dashes."""
DASHES: Mapping[str, tuple[float, ...]] = {
    "f0": (7, 3),
    "f1": (3, 2),
    "f2": (1.5, 3),
    "f3": (9, 2, 2, 2),
    "f4": (12, 4),
    "ceiling": (1, 2),
    "again": (10, 2, 2, 2),
    "again2": (2, 2),
    "again3": (5, 2, 1, 2, 1, 2),
    "run0": (),
    "run1": (7, 3),
    "run2": (2, 2),
    "run3": (9, 2, 2, 2),
}
"""Dashes of each class of a style, as in page.css; the last class of a style decides."""


@cache
def page_css() -> str:
    """The styles of the page."""
    return (TEMPLATES / "page.css").read_text("utf-8")


def look_of(style: str) -> tuple[str, tuple[float, ...]]:
    """The colour and the dashes of a style (CSS classes) on the light page."""
    name, *further = style.split()
    variable = "ink" if name == "ceiling" else name
    found = re.search(rf"--{variable}: (#[0-9a-f]{{3,6}})", page_css())
    if found is None:
        raise AssertionError(f"page.css has no colour --{variable}")
    return found[1], DASHES.get((name, *further)[-1], ())


def styles_of(runs: Sequence[ReportedRun]) -> dict[str, str]:
    """The style (CSS classes) of each row on the page by its key: a colour for a tracker, a grey for the floor.

    A tracker has one colour in all runs; each of several runs has its own dashes, and then repeated colours have wide
    lines.
    """
    colours = _colours_of(runs)
    if len(runs) == 1:
        return colours
    return {
        row_key(run.name, label): f"{colours[label]} run{i % RUN_DASHES}"
        for i, run in enumerate(runs)
        for label in run.summary.trackers
    }


def _colours_of(runs: Sequence[ReportedRun]) -> dict[str, str]:
    colours: dict[str, str] = {}
    trackers = floors = 0
    for label, entry in (one for run in runs for one in run.summary.trackers.items()):
        if label in colours:
            continue
        if entry.ceiling:
            colours[label] = "ceiling"
        elif entry.floor:
            colours[label] = f"f{floors % FLOOR_GREYS}"
            floors += 1
        else:
            again, colour = divmod(trackers, TRACKER_COLOURS)
            colours[label] = f"t{colour}{REPEATS[again % len(REPEATS)]}"
            trackers += 1
    return colours
