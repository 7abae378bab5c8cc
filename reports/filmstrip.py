"""The filmstrip: at chosen moments the input, what came after it, and what each tracker forecast."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gridtrack.common.grid import GridSpec
from gridtrack.evaluation.scoring.samples import SAMPLES, Sample, SamplesError, read_samples
from gridtrack.evaluation.scoring.scores import SCORES
from gridtrack.reports.chosen_frames import ChosenFrame, choose_frames, frame_scores, rule
from gridtrack.reports.pictures import frame_png, probability_png
from gridtrack.reports.run import ReportError
from gridtrack.reports.table import HeadlineTable, TableRow

PICTURES = 320
"""About how many pictures a page holds: where there are more recordings or trackers, fewer moments are shown."""


@dataclass(frozen=True)
class Picture:
    """One grid as a picture, and what it shows in words; `png` is empty where there is nothing to show."""

    png: str
    words: str


@dataclass(frozen=True)
class FilmstripRow:
    """One chosen frame: the input, and per horizon the observed frame and every tracker's forecast."""

    when: str
    why: str
    input: Picture
    later: tuple[tuple[str, Picture, tuple[Picture, ...]], ...]


@dataclass(frozen=True)
class Filmstrip:
    """The chosen moments of one recording, the rows (trackers) that are pictured, and the rule of choice."""

    grid: GridSpec
    sensors: tuple[tuple[float, float], ...]
    """Where the sensors stand, in picture coordinates: cells from the upper left corner."""
    rule: str
    rows: tuple[TableRow, ...]
    strips: tuple[FilmstripRow, ...]


def filmstrip_of(
    table: HeadlineTable, folders: Mapping[str, Path], step: int, horizon_s: float, recordings: int
) -> tuple[Filmstrip | None, tuple[str, ...]]:
    """The film of one recording out of `recordings`, and notices of samples that could not be read.

    `folders` are the trials' by label. Moments are chosen by the moving cells at `step`, `horizon_s` ahead. There is no
    film where no trial kept samples.
    """
    kept, notices = _kept_stamps(table.rows, folders)
    rows = tuple(row for row in table.rows if kept.get(row.label))
    if not rows:
        return None, notices
    judged = [row for row in rows if row.group != "unranked"] or list(rows)
    scored = {
        row.label: {s: m for s, m in frame_scores(folders[row.label] / SCORES, step).items() if s in kept[row.label]}
        for row in judged
    }
    parts = 3 if recordings * 4 * (4 + 3 * len(rows)) <= PICTURES else 1
    chosen = choose_frames(scored, [row.label for row in judged if row.group != "floor"], parts)
    if not chosen:
        return None, notices
    wanted = {moment.stamp_ns for moment in chosen}
    samples = {row.label: _samples_at(folders[row.label] / SAMPLES, wanted) for row in rows}
    reference = samples[judged[0].label]
    start_ns = min(kept[judged[0].label])
    strips = tuple(_filmstrip_row(moment, rows, samples, reference[moment.stamp_ns], start_ns) for moment in chosen)
    first = reference[chosen[0].stamp_ns]
    return Filmstrip(first.grid, _sensors(first), rule(parts, horizon_s), rows, strips), notices


def _kept_stamps(rows: Sequence[TableRow], folders: Mapping[str, Path]) -> tuple[dict[str, set[int]], tuple[str, ...]]:
    """Stamps of the samples of each trial by label; of a damaged file, those before the damage and a notice."""
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
            notices.append(f"{error}: {row.label} has pictures only of the moments before the damage")
    return kept, tuple(notices)


def _samples_at(path: Path, stamps: set[int]) -> dict[int, Sample]:
    """The samples at `stamps`, as far as the file has them; it is not read beyond the last of them."""
    found: dict[int, Sample] = {}
    try:
        for sample in read_samples(path):
            if sample.stamp_ns in stamps:
                found[sample.stamp_ns] = sample
            if len(found) == len(stamps):
                break
    except SamplesError:
        # The first pass has already told of the damage; what stands before it is used.
        return found
    return found


def _filmstrip_row(
    moment: ChosenFrame,
    rows: Sequence[TableRow],
    samples: Mapping[str, Mapping[int, Sample]],
    reference: Sample,
    start_ns: int,
) -> FilmstripRow:
    now = f"{(moment.stamp_ns - start_ns) / 1e9:.1f} s"
    size = reference.visible.sum()
    words = f"Input at {now}: {size} cells visible, {reference.occupied.sum()} of them occupied"
    later = []
    for h, horizon_s in enumerate(reference.horizons_s):
        visible, occupied = reference.came_visible[h], reference.came_occupied[h]
        came = Picture(
            frame_png(visible, occupied),
            f"What came {horizon_s:g} s after {now}: {visible.sum()} cells visible, {occupied.sum()} of them occupied",
        )
        forecasts = tuple(_forecast(row, samples[row.label].get(moment.stamp_ns), reference, h, now) for row in rows)
        later.append((f"{horizon_s:g} s", came, forecasts))
    return FilmstripRow(now, moment.why, Picture(frame_png(reference.visible, reference.occupied), words), tuple(later))


def _forecast(row: TableRow, sample: Sample | None, reference: Sample, h: int, now: str) -> Picture:
    """One tracker's forecast for horizon `h`. Raises ReportError where it was made for another grid or horizons."""
    horizon_s = reference.horizons_s[h]
    if sample is None:
        return Picture("", f"{row.label} did not reach {now}")
    if sample.grid != reference.grid or sample.horizons_s != reference.horizons_s:
        raise ReportError(f"{row.label}: its samples are of another grid or other horizons than the rest: run it again")
    expected = float(sample.forecast[h].sum())
    return Picture(
        probability_png(sample.forecast[h]),
        f"{row.label}: forecast for {horizon_s:g} s after {now}, {expected:.0f} cells expected to be occupied",
    )


def _sensors(sample: Sample) -> tuple[tuple[float, float], ...]:
    """Where the sensors stand inside the picture: cells, x from the left and y from the top."""
    cells = (sample.origins - np.array(sample.grid.origin, np.float32)) / np.float32(sample.grid.cell_m)
    size = sample.grid.size
    return tuple((round(x, 1), round(size - y, 1)) for x, y in cells.tolist() if 0 <= x <= size and 0 <= y <= size)
