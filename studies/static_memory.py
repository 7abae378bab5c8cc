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
from gridtrack.reports.figures import document
from gridtrack.reports.pictures import probability_png

from studies.support.results_file import ResultSection, write_section
from studies.support.shipped import shipped_tracker

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


def drawing(recording: Path, names: list[str]) -> tuple[str, dict[str, str]]:
    """The pictures, SVG, and what is measured of each forecast."""
    stream = GridStream(open_recording(recording))
    first = next(iter(stream.observations()))
    if first.scene is None:
        raise SystemExit(f"{recording}: no true scene: choose a simulated recording")
    outlines = static_cells(first.scene, stream.grid, first.frame.world_T_grid)
    values: dict[str, str] = {}
    panels = [picture_panel(0, "true outlines", probability_png(outlines.astype(np.float32)))]
    for k, name in enumerate(names, start=1):
        p = forecast_from_nothing(name, stream)
        panels.append(picture_panel(k, f"{name}: log P from {SMALLEST:g} to 1", probability_png(shade(p))))
        measured = {
            "mean P on the outlines": f"{p[outlines].mean():.2f}",
            "mean P elsewhere": f"{p[~outlines].mean():.2f}",
            "share above one half on the outlines": f"{100 * np.mean(p[outlines] > 0.5):.0f} %",
            "share above one half elsewhere": f"{100 * np.mean(p[~outlines] > 0.5):.2f} %",
        }
        values.update({f"{name}, {key}": value for key, value in measured.items()})
    width, height = len(panels) * (SIDE + GAP) - GAP, TOP + SIDE
    return document(width, height, panels, font_size=13), values


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("trackers", nargs="*", default=TRACKERS)
    parser.add_argument("--out", type=Path, default=PICTURE.parent, help="folder of the picture and measurements.json")
    arguments = parser.parse_args()
    svg, values = drawing(RECORDING, arguments.trackers)
    (arguments.out / PICTURE.name).write_text(svg)
    section = ResultSection(command="python -m studies.static_memory", values=values)
    write_section(arguments.out / "measurements.json", "static memory", section)
    print("\n".join(f"{name}: {value}" for name, value in values.items()))


if __name__ == "__main__":
    main()
