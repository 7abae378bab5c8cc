"""The tracker `static-map`: the occupied rate of each cell in the training recordings."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from gridtrack.common.config import Settings
from gridtrack.common.errors import WeightsError
from gridtrack.common.grid import GridFrame
from gridtrack.trackers.contract import FitOutput, Forecast, FrameSource, Score, StreamSpec, Tracker
from gridtrack.trackers.weights import array, card_for, load_weights, save_weights

STATIC_MAP = "static-map"


class StaticMapOptions(Settings):
    """Options of the static map."""

    prior_frames: float = Field(1.0, ge=0.0)
    """Weight of the overall rate as a prior, in frames: it dominates in cells that were rarely visible."""


class StaticMapTracker(Tracker):
    """Forecasts the occupied rate of each cell among its visible training frames, for every step."""

    Options = StaticMapOptions
    learns = True
    role = "floor"

    def __init__(self, stream: StreamSpec, options: StaticMapOptions) -> None:
        super().__init__(stream, options)
        weights = load_weights(stream, STATIC_MAP)
        occupied, visible = (array(weights, name, stream.grid.shape) for name in ("occupied", "visible"))
        if not ((occupied >= 0) & (occupied <= visible)).all():
            raise WeightsError(f"weights of {STATIC_MAP}: a cell has more occupied than visible frames: train again")
        self.frequency = frequency(occupied, visible, options.prior_frames)

    def reset(self, seed: int) -> None:
        """The map does not change."""

    def update(self, frame: GridFrame) -> None:
        """The map does not change."""

    def predict(self, steps: int) -> Forecast:
        """The map (steps+1, M, M), the same for every step."""
        return Forecast(np.tile(self.frequency, (steps + 1, 1, 1)))

    @classmethod
    def fit(
        cls,
        train: Sequence[FrameSource],
        validation: Sequence[FrameSource],
        score: Score,
        out: FitOutput,
        options: StaticMapOptions,
    ) -> None:
        """Count the visible and the occupied frames of every cell in `train`.

        Raises WeightsError where the stretches differ in grid, period or site, or no cell is visible.
        """
        card = card_for(STATIC_MAP, out, train, validation, options.model_dump(mode="json"))
        shape = train[0].grid.shape
        occupied, visible = np.zeros(shape, np.int64), np.zeros(shape, np.int64)
        for frame in (frame for source in train for frame in source):
            visible += frame.visible
            occupied += frame.occupied
        if not visible.any():
            raise WeightsError(f"{STATIC_MAP}: no cell is visible in {', '.join(source.name for source in train)}")
        save_weights(out.path, card, {"occupied": occupied, "visible": visible})
        out.report(
            f"{STATIC_MAP}: {np.count_nonzero(visible)} cells seen, overall rate {occupied.sum() / visible.sum():.4f}"
        )


def frequency(occupied: NDArray[np.int64], visible: NDArray[np.int64], prior_frames: float) -> NDArray[np.float32]:
    """P(occupied) (M, M) from counts of frames (M, M), with the overall rate as a prior of weight `prior_frames`.

    A cell that was never visible has the overall rate.
    """
    rate = occupied.sum() / visible.sum()
    seen = visible + prior_frames
    smoothed = np.full(visible.shape, rate)
    np.divide(occupied + prior_frames * rate, seen, out=smoothed, where=seen > 0)
    return smoothed.astype(np.float32)
