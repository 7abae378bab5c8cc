"""Rows of recorded forecasts: their file for each recording, and its checks against the observed frames."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.errors import ConfigurationError
from gridtrack.common.files import name_from, sha256_of
from gridtrack.common.forecast_file import ForecastFile, open_forecasts
from gridtrack.common.forecast_reader import CellMap, ForecastReader
from gridtrack.common.grid import GridFrame, Mask, nearest_step
from gridtrack.common.notices import Notice
from gridtrack.evaluation.referee.splits import EvaluationSplit
from gridtrack.trackers.selection import Selection

ForecastPlane = NDArray[np.float32]
Turn = Callable[[NDArray[Any]], NDArray[Any]]
FILE = "file"
"""The option of such rows that names their file, or a folder with a file for each recording."""
SUFFIX = ".npz"
COMPARED_FORECASTS = 60
"""Forecasts of a stretch that are compared with the observed frames, evenly spaced."""
BETTER_R, CERTAIN_R = 0.02, 0.2
"""The correlation with the frames by which another orientation or frame must be better for a notice, and for a
refusal. A symmetric room, or a forecast that is honestly one frame late, stays below the second one."""
TURNS: dict[str, Turn] = {
    "mirrored in x": lambda p: p[:, ::-1],
    "mirrored in y": lambda p: p[::-1],
    "turned by 180 degrees": lambda p: p[::-1, ::-1],
    "transposed (axes xy in place of yx)": lambda p: p.T,
    "turned by 90 degrees": lambda p: np.rot90(p, 1),
    "turned by 270 degrees": lambda p: np.rot90(p, 3),
    "transposed about the other diagonal": lambda p: p[::-1, ::-1].T,
}
"""The seven other orientations of a plane (H, W)."""
EARLIER, LATER = "one frame earlier", "one frame later"


def with_own_file(selection: Selection, split: EvaluationSplit) -> Selection:
    """The row on one recording with the path of its own file; its option may name a folder with a file for each.

    Raises ConfigurationError if there is none.
    """
    own = recorded_file(selection)
    if own.is_dir() and not (own / "occupancy.npy").exists():
        folder, name = own, name_from(split.path)
        own = next((path for path in (folder / f"{name}{SUFFIX}", folder / name) if path.exists()), folder)
        if own == folder:
            raise ConfigurationError(
                f"{selection.label}: {folder} has no {name}{SUFFIX}, the forecasts of {split.name}"
            )
    return replace(selection, options={**selection.options, FILE: str(own.absolute())})


def recorded_file(selection: Selection) -> Path:
    """The file of a row. Raises ConfigurationError without one."""
    if FILE not in selection.options:
        raise ConfigurationError(f"{selection.label}: it needs a file: {selection.label}={selection.name}:file=FILE")
    return Path(str(selection.options[FILE]))


def hash_of_file(selection: Selection) -> str:
    """SHA-256 of the file of a row. Raises ConfigurationError if it cannot be read."""
    path = recorded_file(selection)
    try:
        return sha256_of(path)
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be read ({error.strerror})") from None


def check_recorded(selection: Selection, split: EvaluationSplit) -> Iterator[Notice]:
    """Notices about the forecasts of a row on one recording.

    Raises RecordingError for a file that cannot be read, and ConfigurationError for one without a forecast of a scored
    frame, or clearly of another orientation or time.
    """
    file = open_forecasts(recorded_file(selection))
    reader = ForecastReader(file, split.test.grid, split.test.period_s)
    texts = [*_covered(file, reader, split), *_resampled(file, split), *_oriented(file, reader, split)]
    for text, kind in ((text, text.partition(":")[0]) for text in texts):
        yield Notice(text=f"recorded forecasts, {text}", row=selection.label, recording=split.name, kind=kind)


def _covered(file: ForecastFile, reader: ForecastReader, split: EvaluationSplit) -> Iterator[str]:
    """The number of scored frames without a forecast, and a horizon that is too short."""
    test = split.test
    stamps = [test.stamp_ns(index) for index in split.schedule.scored]
    missing = sum(reader.newest(stamp) is None for stamp in stamps)
    if stamps and missing == len(stamps):
        of_file, of_test = (
            [t / 1e9 for t in ends] for ends in ((file.stamp_ns[0], file.stamp_ns[-1]), (stamps[0], stamps[-1]))
        )
        raise ConfigurationError(
            f"{file.path}: no forecast of any scored frame of {split.name}: its stamps are {of_file[0]:.3f} to"
            f" {of_file[1]:.3f} s, the scored frames {of_test[0]:.3f} to {of_test[1]:.3f} s: write stamps in the clock"
            " of the recording"
        )
    if missing:
        yield f"frames without one: {missing} of {len(stamps)}; they are not scored"
    if file.lead_s[-1] < split.steps * test.period_s - test.period_s / 2:
        yield f"short: they end {file.lead_s[-1]:g} s ahead; later steps have the last one"


def _resampled(file: ForecastFile, split: EvaluationSplit) -> Iterator[str]:
    grid = split.test.grid
    if file.shape != grid.shape or abs(file.cell_m - grid.cell_m) > 1e-6:
        rows, columns = file.shape
        yield (
            f"resampled: {columns} x {rows} cells of {file.cell_m:g} m to {grid.size} x {grid.size} of {grid.cell_m:g}"
            " m; a cell outside the file counts as wrong"
        )


def _oriented(file: ForecastFile, reader: ForecastReader, split: EvaluationSplit) -> Iterator[str]:
    """A line if another orientation or frame fits the observed frames better; an error if it is certain.

    Cells that changed between two frames are occupied in one of them: what fits one there does not fit the other.
    """
    seen = list(_seen_with_forecasts(file, reader, split))
    own = [one.read(file, split) for one in seen]
    as_read = _correlation(own, [(one.now, one.now.visible) for one in seen])
    if np.isnan(as_read):
        yield "constant: every compared forecast has one value in all cells"
        return
    turned = {}
    for name, turn in _turns(file).items():
        planes = [one.read(file, split, turn) for one in seen]
        turned[name] = _correlation(planes, [(one.now, one.now.visible) for one in seen]) - as_read
    moved = {}
    if file.lead_s[0] < split.test.period_s / 2:
        for name, changed in ((EARLIER, _Seen.since_before), (LATER, _Seen.until_after)):
            moved[name] = -2 * _correlation(own, [(one.now, changed(one)) for one in seen])
    for better in filter(None, (turned, moved)):
        best = max(better, key=lambda name: np.nan_to_num(better[name], nan=-1.0))
        text = f"their first step fits the frames better {best}, by {better[best]:.2f} of correlation"
        if better[best] > CERTAIN_R and best != EARLIER:
            raise ConfigurationError(f"{file.path}: {text}: write the arrays so")
        if better[best] > BETTER_R:
            yield f"orientation: {text}"
            return


@dataclass(frozen=True)
class _Seen:
    """The frame that forecast `n` is for in its first step, and the frames before and after it."""

    n: int
    before: GridFrame
    now: GridFrame
    after: GridFrame

    def read(self, file: ForecastFile, split: EvaluationSplit, turn: Turn | None = None) -> ForecastPlane:
        """The first step, turned in its own plane, in the window of the frame."""
        plane = file.occupancy(self.n, 0)
        cells = CellMap(file, split.test.grid, self.now.world_T_grid.inverse() @ file.world_T_grid(self.n, 0))
        return cells.largest(turn(plane) if turn else plane)

    def since_before(self) -> Mask:
        """The cells that changed since the frame before, in the same window."""
        return _changed(self.before, self.now)

    def until_after(self) -> Mask:
        """The cells that will have changed in the frame after, in the same window."""
        return _changed(self.after, self.now)


def _changed(one: GridFrame, other: GridFrame) -> Mask:
    same_window = one.world_T_grid == other.world_T_grid
    changed: Mask = (one.occupied != other.occupied) & one.visible & other.visible & same_window
    return changed


def _seen_with_forecasts(file: ForecastFile, reader: ForecastReader, split: EvaluationSplit) -> Iterator[_Seen]:
    """Evenly spaced forecasts with the frames of their first step; frames of three moments are in memory."""
    scored, delay = split.schedule.scored, nearest_step(float(file.lead_s[0]), split.test.period_s)
    made_at = scored[:: max(1, len(scored) // COMPARED_FORECASTS)]
    numbers = {index + delay: reader.newest(split.test.stamp_ns(index)) for index in made_at}
    around: deque[GridFrame] = deque(maxlen=3)
    for index, frame in enumerate(split.test):
        around.append(frame)
        n = numbers.get(index - 1)
        if n is not None and len(around) == 3:
            yield _Seen(n, *around)


def _turns(file: ForecastFile) -> dict[str, Turn]:
    """The other orientations that keep the shape of a plane."""
    rows, columns = file.shape
    return {name: turn for name, turn in TURNS.items() if turn(np.empty(file.shape)).shape == (rows, columns)}


def _correlation(planes: Iterable[ForecastPlane], seen: Iterable[tuple[GridFrame, Mask]]) -> float:
    """The correlation of planes with the occupied cells of frames, among these cells of each; NaN without variation."""
    pairs = [
        (plane[cells], frame.occupied[cells])
        for plane, (frame, among) in zip(planes, seen, strict=True)
        for cells in (among & ~np.isnan(plane),)
    ]
    p, o = (np.concatenate([np.zeros(0), *own]) for own in zip(*pairs, strict=True)) if pairs else np.zeros((2, 0))
    return float(np.corrcoef(p, o)[0, 1]) if p.size and np.ptp(p) and np.ptp(o) else float("nan")
