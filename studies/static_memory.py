"""Static memory: the forecast y_1 from no input, beside the true outlines of the site.

`python -m studies.static_memory [TRACKER...]` (ten seconds) draws log P(occupied) of each tracker with its shipped
weights for the junction. For the dilated ConvGRU that is its static memory (Ondruska et al., 2016, fig. 5).
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gridtrack.recordings import open_recording
from gridtrack.recordings.stream import GridStream
from gridtrack.recordings.truth import static_cells
from gridtrack.reports.pictures import probability_png

from studies.support.shipped import shipped_tracker
from studies.support.svg import document

RECORDING = Path("data/junction/test-101.tracks")
PICTURE = Path("docs/results/junction/static-memory.svg")
TRACKERS = ["dilated-convgru", "deep-tracking-rnn", "static-map"]
SMALLEST = 1e-3
SIDE, GAP, TOP = 300, 20, 24


def forecast_from_nothing(name: str, stream: GridStream) -> NDArray[np.float32]:
    """P(occupied) (M, M) one step ahead, before any input."""
    return np.asarray(shipped_tracker(name, stream).predict(1).occupancy[1])


def shade(probability: NDArray[np.float32]) -> NDArray[np.float32]:
    """log P from SMALLEST to 1 as 0 to 1."""
    return np.asarray(1.0 - np.log(np.clip(probability, SMALLEST, 1.0)) / np.log(SMALLEST), np.float32)


def picture_panel(k: int, title: str, png: str) -> str:
    x = k * (SIDE + GAP)
    return (
        f'<text x="{x}" y="16">{title}</text>'
        f'<image x="{x}" y="{TOP}" width="{SIDE}" height="{SIDE}" style="image-rendering:pixelated" href="{png}"/>'
        f'<rect x="{x}" y="{TOP}" width="{SIDE}" height="{SIDE}" fill="none" stroke="#999"/>'
    )


def drawing(recording: Path, names: list[str]) -> str:
    stream = GridStream(open_recording(recording))
    first = next(iter(stream.observations()))
    if first.scene is None:
        raise SystemExit(f"{recording}: no true scene: choose a simulated recording")
    outlines = static_cells(first.scene, stream.grid, first.frame.world_T_grid)
    panels = [picture_panel(0, "true outlines", probability_png(outlines.astype(np.float32)))]
    for k, name in enumerate(names, start=1):
        p = forecast_from_nothing(name, stream)
        panels.append(picture_panel(k, f"{name}: log P from {SMALLEST:g} to 1", probability_png(shade(p))))
        print(
            f"{name}: mean P {p[outlines].mean():.3f} on the outlines, {p[~outlines].mean():.4f} elsewhere;"
            f" {100 * np.mean(p[outlines] > 0.5):.0f} % and {100 * np.mean(p[~outlines] > 0.5):.2f} % above one half"
        )
    width, height = len(panels) * (SIDE + GAP) - GAP, TOP + SIDE
    return document(width, height, panels, font_size=13)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("trackers", nargs="*", default=TRACKERS)
    parser.add_argument("--out", type=Path, default=PICTURE)
    arguments = parser.parse_args()
    arguments.out.write_text(drawing(RECORDING, arguments.trackers))


if __name__ == "__main__":
    main()
