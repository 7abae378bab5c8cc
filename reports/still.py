"""One moment of a recording as still pictures: what the page shows of its forecasts where no script runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gridtrack.common.grid import GridSpec, Mask
from gridtrack.evaluation.referee.samples import Sample
from gridtrack.reports.pictures import frame_png, probability_png
from gridtrack.reports.table import TableRow


@dataclass(frozen=True)
class Picture:
    """One grid as a PNG data address, and its description in words; `png` is empty where there is no picture."""

    png: str
    words: str


@dataclass(frozen=True)
class Still:
    """The input, the frame observed at one horizon, and each tracker's forecast of it.

    `sensors`: their positions in the input, cells from its upper left corner. In the observed frame, which has the
    same window, a sensor may have moved on.
    """

    grid: GridSpec
    when: str
    horizon: str
    input: Picture
    sensors: tuple[tuple[float, float], ...]
    observed: Picture
    forecasts: tuple[tuple[TableRow, Picture], ...]


def still_of(
    trackers: Sequence[TableRow], samples: Mapping[str, Sample | None], h: int, now_s: float, horizon_s: float
) -> Still:
    """The pictures of one moment at horizon `h`, `horizon_s` ahead; `samples` has at least one sample, by label."""
    seen = next(sample for sample in samples.values() if sample is not None)
    now, horizon = f"{now_s:.1f} s", f"{horizon_s:.3g} s"
    visible, occupied = seen.observed_visible[h], seen.observed_occupied[h]
    return Still(
        seen.grid,
        now,
        horizon,
        _frame_picture(f"Input at {now}", seen.visible, seen.occupied),
        _sensors(seen),
        _frame_picture(f"Observed {horizon} after {now}", visible, occupied),
        tuple((row, _forecast_picture(row.name, samples.get(row.label), h, now, horizon)) for row in trackers),
    )


def _frame_picture(title: str, visible: Mask, occupied: Mask) -> Picture:
    words = f"{title}: {visible.sum()} cells visible, {occupied.sum()} of them occupied"
    return Picture(frame_png(visible, occupied), words)


def _forecast_picture(name: str, sample: Sample | None, h: int, now: str, horizon: str) -> Picture:
    if sample is None:
        return Picture("", f"{name} has no forecast at {now}")
    expected = float(sample.forecast[h].sum())
    words = f"{name}: forecast for {horizon} after {now}, {expected:.0f} cells expected to be occupied"
    return Picture(probability_png(sample.forecast[h]), words)


def _sensors(sample: Sample) -> tuple[tuple[float, float], ...]:
    """Positions of the sensors inside the picture: cells, x from the left and y from the top."""
    cells = (sample.origins - np.array(sample.grid.origin, np.float32)) / np.float32(sample.grid.cell_m)
    size = sample.grid.size
    return tuple((round(x, 1), round(size - y, 1)) for x, y in cells.tolist() if 0 <= x <= size and 0 <= y <= size)
