"""What a tracker expects of a place before it has seen anything: y_1 from no input, beside the place's outlines.

`python -m studies.static_memory [TRACKER...]` draws log P(occupied) of each tracker's shipped weights for the
junction into docs/results/junction. For the dilated ConvGRU that is its static memory (Ondruska et al., 2016, fig. 5).
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.comparison.learned import find_weights
from gridtrack.recordings import open_recording
from gridtrack.recordings.stream import GridStream
from gridtrack.recordings.truth import static_cells
from gridtrack.reports.pictures import probability_png
from gridtrack.trackers import registry
from gridtrack.trackers.contract import stream_of

RECORDING = Path("data/junction/test-101.tracks")
PICTURE = Path("docs/results/junction/static-memory.svg")
TRACKERS = ["dilated-convgru", "deep-tracking-rnn", "static-map"]
SMALLEST = 1e-3
SIDE, GAP, TOP = 300, 20, 24


def expected(name: str, stream: GridStream) -> NDArray[np.float32]:
    """P(occupied) (M, M) one step ahead of nothing."""
    found = find_weights(name, stream.site, None)
    kind = registry.load(name)
    tracker = kind(stream_of(stream, found.path if found else None), kind.Options())
    tracker.reset(0)
    one_ahead: NDArray[np.float32] = tracker.predict(1).occupancy[1]
    return one_ahead


def shade(probability: NDArray[np.float32]) -> NDArray[np.float32]:
    """log P from SMALLEST to 1 as 0 to 1."""
    return np.asarray(1.0 - np.log(np.clip(probability, SMALLEST, 1.0)) / np.log(SMALLEST), np.float32)


def panel(k: int, title: str, png: str) -> str:
    x = k * (SIDE + GAP)
    return (
        f'<text x="{x}" y="16">{title}</text>'
        f'<image x="{x}" y="{TOP}" width="{SIDE}" height="{SIDE}" style="image-rendering:pixelated" href="{png}"/>'
        f'<rect x="{x}" y="{TOP}" width="{SIDE}" height="{SIDE}" fill="none" stroke="#999"/>'
    )


def draw(recording: Path, names: list[str]) -> str:
    stream = GridStream(open_recording(recording))
    first = next(iter(stream.observations()))
    if first.scene is None:
        raise SystemExit(f"{recording}: it does not know what stands there")
    outlines = static_cells(first.scene, stream.grid, first.frame.world_T_grid)
    panels = [panel(0, "what stands there", probability_png(outlines.astype(np.float32)))]
    for k, name in enumerate(names, start=1):
        p = expected(name, stream)
        panels.append(panel(k, f"{name}: log P from {SMALLEST:g} to 1", probability_png(shade(p))))
        print(
            f"{name}: mean P {p[outlines].mean():.3f} where something stands, {p[~outlines].mean():.4f} elsewhere;"
            f" {100 * np.mean(p[outlines] > 0.5):.0f} % and {100 * np.mean(p[~outlines] > 0.5):.2f} % above one half"
        )
    width, height = len(panels) * (SIDE + GAP) - GAP, TOP + SIDE
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" font-family="sans-serif"'
        f' font-size="13"><rect width="100%" height="100%" fill="white"/>{"".join(panels)}</svg>\n'
    )


if __name__ == "__main__":
    PICTURE.write_text(draw(RECORDING, sys.argv[1:] or TRACKERS))
