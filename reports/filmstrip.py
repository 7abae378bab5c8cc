"""The filmstrip: for each chosen frame the input, the observed frames after it, and the forecasts of every tracker."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gridtrack.common.grid import GridSpec
from gridtrack.evaluation.results.columns import SCORES_TABLE
from gridtrack.evaluation.scoring.samples import SAMPLES, Sample, SamplesError, read_samples
from gridtrack.reports.chosen_frames import ChosenFrame, choose_frames, frame_scores, selection_rule
from gridtrack.reports.pictures import frame_png, probability_png
from gridtrack.reports.run import ReportError
from gridtrack.reports.table import HeadlineTable, TableRow

MAX_PICTURES = 320
"""About this many pictures fit on a page: with more recordings or trackers, fewer frames are shown."""


@dataclass(frozen=True)
class Picture:
    """One grid as a PNG data address, and its description in words; `png` is empty where there is no picture."""

    png: str
    words: str


@dataclass(frozen=True)
class FilmstripRow:
    """One chosen frame: its time, why it was chosen, the input; and for each horizon its name, the observed frame and
    every tracker's forecast, in the order of `Filmstrip.trackers`.

    `sensors`: their positions in the input, cells from its upper left corner. In the observed frames, which have the
    same window, a sensor may have moved on.
    """

    when: str
    reason: str
    input: Picture
    sensors: tuple[tuple[float, float], ...]
    horizons: tuple[tuple[str, Picture, tuple[Picture, ...]], ...]


@dataclass(frozen=True)
class Filmstrip:
    """The chosen frames of one recording, the trackers that are shown, and the rule of the choice."""

    grid: GridSpec
    rule: str
    trackers: tuple[TableRow, ...]
    rows: tuple[FilmstripRow, ...]


def filmstrip_of(
    table: HeadlineTable, folders: Mapping[str, Path], step: int, horizon_s: float, recordings: int
) -> tuple[Filmstrip | None, tuple[str, ...]]:
    """The filmstrip of one recording out of `recordings`, and notices of samples that cannot be read.

    `folders`: the folder of each trial by label. Frames are chosen by the scores of cells in motion at `step`,
    `horizon_s` ahead. The filmstrip is None where no trial kept samples.
    """
    kept, notices = _kept_stamps(table.rows, folders)
    trackers = tuple(row for row in table.rows if kept.get(row.label))
    if not trackers:
        return None, notices
    complete = [row for row in trackers if row.group != "unranked"] or list(trackers)
    scores = {
        row.label: {
            s: f for s, f in frame_scores(folders[row.label] / SCORES_TABLE.file, step).items() if s in kept[row.label]
        }
        for row in complete
    }
    parts = 3 if recordings * 4 * (4 + 3 * len(trackers)) <= MAX_PICTURES else 1
    chosen = choose_frames(scores, [row.label for row in complete if row.group != "floor"], parts)
    if not chosen:
        return None, notices
    stamps = {frame.stamp_ns for frame in chosen}
    samples = {row.label: _samples_at(folders[row.label] / SAMPLES, stamps) for row in trackers}
    reference = samples[complete[0].label]
    start_ns = min(kept[complete[0].label])
    rows = tuple(_filmstrip_row(frame, trackers, samples, reference[frame.stamp_ns], start_ns) for frame in chosen)
    grid = reference[chosen[0].stamp_ns].grid
    return Filmstrip(grid, selection_rule(parts, horizon_s), trackers, rows), notices


def _kept_stamps(rows: Sequence[TableRow], folders: Mapping[str, Path]) -> tuple[dict[str, set[int]], tuple[str, ...]]:
    """The stamps of the samples of each trial by label; of a damaged file, those before the damage, and a notice."""
    kept: dict[str, set[int]] = {}
    notices = []
    for row in rows:
        path = folders[row.label] / SAMPLES
        if not path.exists():
            continue
        kept[row.label] = set()
        try:
            kept[row.label].update(sample.stamp_ns for sample in read_samples(path))
        except SamplesError as error:
            notices.append(f"{error}: {row.label} has pictures only of the frames before the damage")
    return kept, tuple(notices)


def _samples_at(path: Path, stamps: set[int]) -> dict[int, Sample]:
    """The samples at `stamps` that the file holds; reading stops after the last of them."""
    found: dict[int, Sample] = {}
    try:
        for sample in read_samples(path):
            if sample.stamp_ns in stamps:
                found[sample.stamp_ns] = sample
            if len(found) == len(stamps):
                break
    except SamplesError:
        # _kept_stamps has already reported the damage; the samples before it are used
        return found
    return found


def _filmstrip_row(
    frame: ChosenFrame,
    trackers: Sequence[TableRow],
    samples: Mapping[str, Mapping[int, Sample]],
    reference: Sample,
    start_ns: int,
) -> FilmstripRow:
    now = f"{(frame.stamp_ns - start_ns) / 1e9:.1f} s"
    size = reference.visible.sum()
    words = f"Input at {now}: {size} cells visible, {reference.occupied.sum()} of them occupied"
    horizons = []
    for h, horizon_s in enumerate(reference.horizons_s):
        visible, occupied = reference.observed_visible[h], reference.observed_occupied[h]
        observed = Picture(
            frame_png(visible, occupied),
            f"Observed {horizon_s:g} s after {now}: {visible.sum()} cells visible, {occupied.sum()} of them occupied",
        )
        forecasts = tuple(
            _forecast_picture(row, samples[row.label].get(frame.stamp_ns), reference, h, now) for row in trackers
        )
        horizons.append((f"{horizon_s:g} s", observed, forecasts))
    taken = Picture(frame_png(reference.visible, reference.occupied), words)
    return FilmstripRow(now, frame.reason, taken, _sensors(reference), tuple(horizons))


def _forecast_picture(row: TableRow, sample: Sample | None, reference: Sample, h: int, now: str) -> Picture:
    """One tracker's forecast for horizon `h`. Raises ReportError where it is of another grid or other horizons."""
    horizon_s = reference.horizons_s[h]
    if sample is None:
        return Picture("", f"{row.label} has no forecast at {now}")
    if sample.grid != reference.grid or sample.horizons_s != reference.horizons_s:
        raise ReportError(
            f"{row.label}: its samples are of another grid or other horizons than those of the other trackers: run it"
            " again"
        )
    expected = float(sample.forecast[h].sum())
    return Picture(
        probability_png(sample.forecast[h]),
        f"{row.label}: forecast for {horizon_s:g} s after {now}, {expected:.0f} cells expected to be occupied",
    )


def _sensors(sample: Sample) -> tuple[tuple[float, float], ...]:
    """Positions of the sensors inside the picture: cells, x from the left and y from the top."""
    cells = (sample.origins - np.array(sample.grid.origin, np.float32)) / np.float32(sample.grid.cell_m)
    size = sample.grid.size
    return tuple((round(x, 1), round(size - y, 1)) for x, y in cells.tolist() if 0 <= x <= size and 0 <= y <= size)
