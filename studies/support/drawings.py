"""Charts and pictures of docs/results as SVG, by matplotlib: the same numbers give the same file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from gridtrack.common.grid import Mask
from gridtrack.evaluation.referee.samples import Sample
from gridtrack.reports.pictures import SHADES, UNOBSERVED, palette

COLOURS = ("#1d4ed8", "#c2410c", "#0f766e", "#7e22ce")
SETTINGS: dict[Any, Any] = {
    "font.size": 9,
    "axes.titlesize": "medium",
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "image.interpolation": "none",
    "legend.frameon": False,
    "svg.fonttype": "none",  # text stays text
    "svg.hashsalt": "gridtrack",
}
PANEL_INCHES = 2.3

Picture = NDArray[np.uint8]
"""Colours (M, M, 3) of cells, row 0 at the bottom."""


def write_svg(figure: Figure, path: Path) -> None:
    """Write a figure that was drawn with SETTINGS."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with matplotlib.rc_context(SETTINGS):
        figure.savefig(path, format="svg", metadata={"Date": None})


def probability_picture(probability: NDArray[np.float32]) -> Picture:
    """P(occupied) (M, M) in the colours of the report."""
    return np.asarray(palette()[np.rint(np.clip(probability, 0.0, 1.0) * (SHADES - 1)).astype(np.int64)])


def frame_picture(visible: Mask, occupied: Mask) -> Picture:
    """A frame (M, M) in the colours of the report."""
    return np.asarray(palette()[np.where(visible, np.where(occupied, SHADES - 1, 0), UNOBSERVED)])


def draw_pictures(rows: Sequence[Mapping[str, Picture]], path: Path) -> None:
    """Draw pictures in rows, each below its title."""
    columns = max(map(len, rows))
    with matplotlib.rc_context(SETTINGS):
        size = PANEL_INCHES * columns, (PANEL_INCHES + 0.25) * len(rows)
        figure = Figure(size, layout="constrained")
        axes = figure.subplots(len(rows), columns, squeeze=False)
        for line, row in zip(axes, rows, strict=True):
            for axis, (title, picture) in zip(line, row.items(), strict=True):
                axis.imshow(picture, origin="lower")
                axis.set_title(title)
                axis.set(xticks=(), yticks=())
                axis.spines[:].set(visible=True, color="#999")
        write_svg(figure, path)


def forecast_pictures(title: str, samples: Mapping[str, Sample], horizon_s: float) -> dict[str, Picture]:
    """A row of pictures of one moment: the input, the frame that followed, and the forecast of each tracker for it."""
    one = next(iter(samples.values()))
    at = one.horizons_s.index(horizon_s)
    return {
        title: frame_picture(one.visible, one.occupied),
        f"{horizon_s:g} s later": frame_picture(one.observed_visible[at], one.observed_occupied[at]),
        **{name: probability_picture(sample.forecast[at]) for name, sample in samples.items()},
    }
