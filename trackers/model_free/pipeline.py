"""The pipeline from a grid frame to tracks, stage by stage (after Wang, Posner and Newman, IJRR 2015)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec, Mask
from gridtrack.trackers.model_free.association import assign, share_out, squared_mahalanobis
from gridtrack.trackers.model_free.background import Background
from gridtrack.trackers.model_free.dwell import NOT_OCCUPIED, next_ages
from gridtrack.trackers.model_free.estimation import ConstantVelocityKalman, MotionNoise
from gridtrack.trackers.model_free.forecast import appearance, share_in_view
from gridtrack.trackers.model_free.rasterise import noisy_or
from gridtrack.trackers.model_free.segmentation import Cluster, segment
from gridtrack.trackers.model_free.settings import PipelineSettings
from gridtrack.trackers.model_free.tracks import Shape, Track, existence_when_detected, existence_when_missed

Array = NDArray[np.float64]


class Pipeline:
    """Tracks of what moves before a static background, and their forecast.

    `background` (M, M) float32 is P(occupied | visible), `dwell` (A, S) float32 the life table of returns in place.
    Positions are in metres in the grid frame, which must not move.
    """

    def __init__(
        self,
        grid: GridSpec,
        period_s: float,
        background: NDArray[np.float32],
        dwell: NDArray[np.float32],
        settings: PipelineSettings,
    ) -> None:
        self.grid, self.period_s, self.dwell, self.settings = grid, period_s, dwell, settings
        self.background = Background(
            background,
            period_s,
            settings.explained_above,
            settings.unforeseen_share,
            settings.return_s,
            settings.sink_above,
            settings.sink_s,
        )
        self.gate = -2.0 * math.log(1.0 - settings.gate_probability)  # chi-square quantile, two degrees of freedom
        self.survival = math.exp(-period_s / settings.life_s)
        self.shape_keep = math.exp(-period_s / settings.shape_memory_s)
        self.noise = MotionNoise(
            settings.acceleration, settings.velocity_memory_s, settings.position_noise_m, settings.initial_speed
        )
        self.ages = np.full(grid.shape, NOT_OCCUPIED)
        self.tracks: list[Track] = []
        self.frame: GridFrame | None = None
        self.born = 0

    def update(self, frame: GridFrame) -> None:
        """Take in one frame: the stages in their order."""
        self.background.observe(frame)
        points, ranges = self._unexplained(frame)
        self.ages = next_ages(self.ages, frame.occupied & ~self.background.explained, oldest=len(self.dwell) - 1)
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
        new[inside] = ~self.background.explained[cells[inside, 0], cells[inside, 1]]
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
            track.returns, track.ages = cluster.points, self._ages_of(cluster)
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
                in_view = share_in_view(self._appearance(track, 0)[0], track, visible)
                detectable = settings.detection_probability * in_view
                track.existence = existence_when_missed(track.existence, detectable)
        self.tracks = [track for track in self.tracks if track.existence >= settings.dead_below]

    def _give_birth(self, clusters: list[Cluster]) -> None:
        for cluster in clusters:
            estimator = ConstantVelocityKalman(cluster.centre, self.period_s, self.noise)
            shape = Shape.of(cluster.points - cluster.centre)
            existence = self.settings.birth_probability
            ages = self._ages_of(cluster)
            self.tracks.append(Track(self.born, estimator, shape, cluster.points, ages, existence))
            self.born += 1

    def forecast(self, steps: int) -> NDArray[np.float32]:
        """P(occupied) (steps+1, M, M) float32 of steps 0..steps; where step 0 is visible it is what was seen."""
        occupancy = self.background.probabilities(steps)
        for track in self.tracks:
            noisy_or(occupancy, self._appearance(track, steps), track.existence * self.survival ** np.arange(steps + 1))
        if self.frame is not None:
            occupancy[0] = np.where(self.frame.visible, self.frame.occupied, occupancy[0])
        return occupancy

    def _ages_of(self, cluster: Cluster) -> NDArray[np.int64]:
        """For how many frames each return of the cluster (N,) has been in place."""
        cells, _ = self.grid.cells_of(cluster.points)
        return self.ages[cells[:, 0], cells[:, 1]]

    def _appearance(self, track: Track, steps: int) -> NDArray[np.float32]:
        return appearance(track, steps, self.grid, self.dwell, self.settings.return_noise_m)


def compile_ahead(period_s: float, dwell: NDArray[np.float32], settings: PipelineSettings) -> None:
    """Run every stage once on a scene of three frames, so that what is compiled on first use has been.

    That takes seconds on a machine where nothing is compiled yet: a tracker has them when it starts, not in an update.
    """
    grid = GridSpec(8, 0.1)
    pipeline = Pipeline(grid, period_s, np.zeros(grid.shape, np.float32), dwell, settings)
    occupied, visible = np.zeros(grid.shape, bool), np.ones(grid.shape, bool)
    occupied[4, 4:6] = True
    for cells in (occupied, occupied, ~visible):
        points = grid.cell_centres(cells)
        origin, owner = np.zeros((1, 2), np.float32), np.zeros(len(points), np.uint8)
        pipeline.update(GridFrame(0, visible, cells, SE2(), origin, points, owner))
    pipeline.forecast(1)
