"""The pipeline from a grid frame to tracks, stage by stage (after Wang, Posner and Newman, IJRR 2015)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.grid import GridFrame, GridSpec, Mask
from gridtrack.trackers.model_free.association import assign, share_out, squared_mahalanobis
from gridtrack.trackers.model_free.background import explained_cells
from gridtrack.trackers.model_free.estimation import ConstantVelocityKalman
from gridtrack.trackers.model_free.forecast import draw, noisy_or, splat
from gridtrack.trackers.model_free.segmentation import Cluster, segment
from gridtrack.trackers.model_free.settings import PipelineSettings
from gridtrack.trackers.model_free.tracks import Shape, Track, existence_when_detected, existence_when_missed

Array = NDArray[np.float64]


class Pipeline:
    """Tracks of what moves before a static background, and their forecast.

    `background` (M, M) float32, P(occupied | visible). Positions are in metres in the grid frame, which must not move.
    """

    def __init__(
        self, grid: GridSpec, period_s: float, background: NDArray[np.float32], settings: PipelineSettings
    ) -> None:
        self.grid, self.period_s, self.background, self.settings = grid, period_s, background, settings
        self.explained = explained_cells(background, settings.explained_above)
        self.gate = -2.0 * math.log(1.0 - settings.gate_probability)  # chi-square quantile, two degrees of freedom
        self.survival = math.exp(-period_s / settings.life_s)
        self.shape_keep = math.exp(-period_s / settings.shape_memory_s)
        self.tracks: list[Track] = []
        self.frame: GridFrame | None = None
        self.born = 0

    def update(self, frame: GridFrame) -> None:
        """Take in one frame: the stages in their order."""
        points, ranges = self._unexplained(frame)
        clusters = segment(points, ranges, self.settings.link_m, self.settings.link_per_m)
        self._predict()
        shares, left = self._associate(clusters)
        self._correct(shares)
        self._judge(shares, frame.visible)
        self._give_birth(left)
        self.frame = frame

    def _unexplained(self, frame: GridFrame) -> tuple[Array, Array]:
        """Returns (N, 2) that the background does not explain, metres, and the range (N,) of each."""
        cells, inside = self.grid.cells_of(frame.points)
        new = inside.copy()
        new[inside] = ~self.explained[cells[inside, 0], cells[inside, 1]]
        points = frame.points[new].astype(np.float64)
        return points, np.linalg.norm(points - frame.origins[frame.point_origin[new]], axis=1)

    def _predict(self) -> None:
        for track in self.tracks:
            track.estimator.predict()
            track.existence *= self.survival

    def _associate(self, clusters: list[Cluster]) -> tuple[dict[int, Cluster], list[Cluster]]:
        """Track number -> its returns, and the clusters left over."""
        if not self.tracks or not clusters:
            return {}, clusters
        positions = np.stack([track.position for track in self.tracks])
        spread = np.stack([track.estimator.covariance[:2, :2] for track in self.tracks])
        spread = spread + np.eye(2) * self.settings.position_noise_m**2
        centres = np.stack([cluster.centre for cluster in clusters])
        pairs = assign(squared_mahalanobis(centres, positions, spread), self.gate)
        return share_out(clusters, pairs, positions, self.settings.reach_m)

    def _correct(self, shares: dict[int, Cluster]) -> None:
        """Correct each track by its returns, and carry them on as its shape."""
        for number, cluster in shares.items():
            track = self.tracks[number]
            track.estimator.update(cluster.centre)
            track.returns = cluster.points
            track.shape.extend(cluster.points - track.position, self.shape_keep)

    def _judge(self, shares: dict[int, Cluster], visible: Mask) -> None:
        """Weigh each track's existence by what was and was not seen of it; drop the dead."""
        settings = self.settings
        for number, track in enumerate(self.tracks):
            if number in shares:
                track.unseen = 0
                track.existence = existence_when_detected(
                    track.existence, settings.detection_probability, settings.false_alarm
                )
                track.confirmed |= track.existence >= settings.confirm_above
            else:
                track.unseen += 1
                detectable = settings.detection_probability * self._share_in_view(track, visible)
                track.existence = existence_when_missed(track.existence, detectable)
        self.tracks = [track for track in self.tracks if track.existence >= settings.dead_below]

    def _share_in_view(self, track: Track, visible: Mask) -> float:
        """Which share of what the track would show falls on visible cells; outside the grid nothing does."""
        image = self._draw(track, 0)[0]
        return min(1.0, float(image[visible].sum()) / max(float(track.shape.weights.sum()), 1e-9))

    def _give_birth(self, clusters: list[Cluster]) -> None:
        s = self.settings
        for cluster in clusters:
            estimator = ConstantVelocityKalman(
                cluster.centre, self.period_s, s.acceleration, s.position_noise_m, s.initial_speed
            )
            shape = Shape.of(cluster.points - cluster.centre)
            self.tracks.append(Track(self.born, estimator, shape, cluster.points, s.birth_probability))
            self.born += 1

    def forecast(self, steps: int) -> NDArray[np.float32]:
        """P(occupied) (steps+1, M, M) float32 of steps 0..steps; where step 0 is visible it is what was seen."""
        occupancy = np.repeat(self.background[None], steps + 1, axis=0)
        for track in self.tracks:
            survival = track.existence * self.survival ** np.arange(steps + 1)
            noisy_or(occupancy, self._draw(track, steps) * survival[:, None, None].astype(np.float32))
        if self.frame is not None:
            occupancy[0] = np.where(self.frame.visible, self.frame.occupied, occupancy[0])
        return occupancy

    def _draw(self, track: Track, steps: int) -> NDArray[np.float32]:
        """What one track, if it exists, is expected to show at steps 0..steps: P(occupied) (steps+1, M, M).

        Two alternatives for its returns: they stay where they were last seen, or they move on with the object.
        """
        image = np.zeros((steps + 1, *self.grid.shape), np.float32)
        means, covariances = track.estimator.ahead(steps)
        deviations = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2)[:, :2])
        staying = np.exp(-(np.arange(steps + 1) + track.unseen) * self.period_s / self.settings.dwell_s)
        moving = splat(track.shape.offsets, track.shape.weights, self.grid.cell_m)
        draw(image, moving, self._in_cells(means[:, :2]), deviations / self.grid.cell_m, 1.0 - staying)
        anchor = track.returns[0]
        standing = splat(track.returns - anchor, np.ones(len(track.returns)), self.grid.cell_m)
        noise = np.full((steps + 1, 2), self.settings.return_noise_m / self.grid.cell_m)
        draw(image, standing, self._in_cells(np.tile(anchor, (steps + 1, 1))), noise, staying)
        return image

    def _in_cells(self, positions: Array) -> Array:
        """Positions (N, 2) in metres as cells from the grid's corner."""
        return (positions - np.array(self.grid.origin)) / self.grid.cell_m
