"""Static memory: the forecast y_1 without any input, beside the true outlines of the site.

`python -m studies.static_memory [TRACKER...]` (ten seconds) draws log P(occupied), from SMALLEST to 1, of each tracker
with its shipped weights for the junction. For the dilated ConvGRU that is its static memory (Ondruska et al., 2016,
fig. 5).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gridtrack.recordings.stream import GridStream, open_stream
from gridtrack.recordings.truth import static_cells

from studies.support.drawings import draw_pictures, probability_picture
from studies.support.results_file import ResultSection, study_parser, write_section
from studies.support.shipped import JUNCTION, shipped_tracker

OUT = Path("docs/results/junction")
PICTURE, MEASUREMENTS = "static-memory.svg", "measurements.json"
TRACKERS = ["dilated-convgru", "deep-tracking-rnn", "static-map"]
SMALLEST = 1e-3


def forecast_without_input(name: str, stream: GridStream) -> NDArray[np.float32]:
    """P(occupied) (M, M) one step ahead, before any input."""
    return np.asarray(shipped_tracker(name, stream).predict(1).occupancy[1])


def shade(probability: NDArray[np.float32]) -> NDArray[np.float32]:
    """log P from SMALLEST to 1, scaled to 0 to 1."""
    return np.asarray(1.0 - np.log(np.clip(probability, SMALLEST, 1.0)) / np.log(SMALLEST), np.float32)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = study_parser(__doc__)
    parser.add_argument("trackers", nargs="*", default=TRACKERS)
    parser.add_argument("--out", type=Path, default=OUT, help=f"folder of {PICTURE} and {MEASUREMENTS}")
    given = parser.parse_args(arguments)
    stream = open_stream(JUNCTION / "test-101.tracks")
    first = next(iter(stream.observations()))
    assert first.scene is not None
    outlines = static_cells(first.scene, stream.grid, first.frame.world_T_grid)
    pictures = {"true outlines": probability_picture(outlines.astype(np.float32))}
    values: dict[str, str] = {}
    for name in given.trackers:
        p = forecast_without_input(name, stream)
        pictures[f"{name}, log P"] = probability_picture(shade(p))
        values |= {
            f"{name}, mean P on the outlines": f"{p[outlines].mean():.2f}",
            f"{name}, mean P elsewhere": f"{p[~outlines].mean():.2f}",
            f"{name}, share above one half on the outlines": f"{100 * np.mean(p[outlines] > 0.5):.0f} %",
            f"{name}, share above one half elsewhere": f"{100 * np.mean(p[~outlines] > 0.5):.2f} %",
        }
    draw_pictures([pictures], given.out / PICTURE)
    section = ResultSection(command="python -m studies.static_memory", values=values)
    write_section(given.out / MEASUREMENTS, "static memory", section)
    print(section.text())


if __name__ == "__main__":
    main()
