"""Forecasts of a drive with perfect poses and with the ego-motion ignored, as pictures.

`python -m studies.moving_pictures TRACKER` (some seconds) reads the comparisons of `python -m studies.moving` and
draws, for each of MOMENTS and each kind of poses, the input, a forecast for one second later, and what was observed.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

from gridtrack.evaluation.referee.samples import SAMPLES, Sample, read_samples
from gridtrack.reports.figures import document
from gridtrack.reports.pictures import frame_png, probability_png

KINDS = ("perfect", "ignored")
MOMENTS = (("car-202", 46.0), ("robot-201", 30.0))
"""A drive, and seconds since its beginning; drawn is the kept forecast that is nearest."""
HORIZON_S = 1.0
SIDE, GAP, TOP = 260, 16, 22


def nearest_sample(folder: Path, at_s: float) -> Sample:
    """The kept forecast of a trial that is nearest to a time."""
    return min(read_samples(folder / SAMPLES), key=lambda sample: abs(sample.stamp_ns / 1e9 - at_s))


def panels(sample: Sample, minute: str, kind: str) -> Iterator[tuple[str, str]]:
    """Title and PNG data address of the three pictures of a forecast."""
    h = sample.horizons_s.index(HORIZON_S)
    yield f"{minute}, {sample.stamp_ns / 1e9:.1f} s, {kind}: input", frame_png(sample.visible, sample.occupied)
    yield f"forecast for {HORIZON_S:g} s later", probability_png(sample.forecast[h])
    yield (
        f"observed {HORIZON_S:g} s later",
        frame_png(sample.observed_visible[h], sample.observed_occupied[h]),
    )


def drawing(out: Path, tracker: str) -> str:
    """SVG: three pictures in a row for each moment and kind of poses."""
    parts, row = [], 0
    for minute, at_s in MOMENTS:
        for kind in KINDS:
            sample = nearest_sample(out / kind / f"{tracker}@{minute}", at_s)
            y = row * (TOP + SIDE + GAP)
            for column, (title, png) in enumerate(panels(sample, minute, kind)):
                x = column * (SIDE + GAP)
                parts.append(
                    f'<text x="{x}" y="{y + 15}">{title}</text>'
                    f'<image x="{x}" y="{y + TOP}" width="{SIDE}" height="{SIDE}" style="image-rendering:pixelated"'
                    f' href="{png}"/><rect x="{x}" y="{y + TOP}" width="{SIDE}" height="{SIDE}" fill="none"'
                    ' stroke="#999"/>'
                )
            row += 1
    return document(3 * (SIDE + GAP) - GAP, row * (TOP + SIDE + GAP) - GAP, parts, font_size=13)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("tracker")
    parser.add_argument("--out", type=Path, default=Path("runs/moving"), help="folder of the comparisons")
    parser.add_argument("--picture", type=Path, default=Path("docs/results/moving/drives.svg"))
    given = parser.parse_args()
    given.picture.write_text(drawing(given.out, given.tracker))


if __name__ == "__main__":
    main()
