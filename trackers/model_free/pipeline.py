"""The pipeline from a grid frame to tracks and their forecast (after Wang, Posner and Newman, IJRR 2015)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec, Mask, Shift, rolled, shift_between
from gridtrack.trackers.model_free.arrays import Array, bounds_of, owners_of, split
from gridtrack.trackers.model_free.association import assign, assign_returns, distances_to
from gridtrack.trackers.model_free.background import Background, BackgroundMap, outside_of
from gridtrack.trackers.model_free.estimators import MakeEstimator, SwitchingEstimator
from gridtrack.trackers.model_free.forecast import add_tracks, attribute, normalise, weight_by_cell_prior
from gridtrack.trackers.model_free.matching import Match
from gridtrack.trackers.model_free.measurement import HEADING_FROM_M, measured_poses, membership, pairing_of, pose_noise
from gridtrack.trackers.model_free.motion import Regimes
from gridtrack.trackers.model_free.residence import NOT_OCCUPIED, next_ages
from gridtrack.trackers.model_free.segmentation import BACKGROUND, Cluster, clusters_of, cut_off_returns, segment
from gridtrack.trackers.model_free.settings import PipelineSettings
from gridtrack.trackers.model_free.shape import Shape, in_view, to_body, to_grid
from gridtrack.trackers.model_free.tracks import (
    Track,
    Window,
    boundaries_of,
    existence_when_detected,
    existence_when_missed,
    poses_of,
)
from gridtrack.trackers.site_map import SiteMap


class Pipeline:
    """Tracks of moving objects against a static background, and their forecast.

    `background` is the map of the site on a grid at `world_T_map` (by default at the grid of the first frame);
    `residence` (A, S) float32 is the life table of returns that stay in place. Positions are in metres in the fixed
    frame of the `window`, which scrolls with the sensor: the arrays of cells move with it by whole cells.
    """

    def __init__(
        self,
        grid: GridSpec,
        period_s: float,
        background: BackgroundMap,
        residence: NDArray[np.float32],
        settings: PipelineSettings,
        make_estimator: MakeEstimator,
        world_T_map: SE2 | None = None,
    ) -> None:
        self.grid, self.residence, self.settings = grid, residence, settings
        self.make_estimator = make_estimator
        self.window = self.previous_window = Window(grid)
        self.site = SiteMap(np.stack(background), outside_of(background), grid.cell_m, world_T_map)
        self.background = Background(background, period_s, settings)
        self.regimes = settings.motion(period_s, grid.size * grid.cell_m)
        self.period_s = period_s
        self.survival = math.exp(-period_s / settings.mean_lifetime_s)
        self.background_merge_periods = round(settings.background_merge_s / period_s)
        self.track_merger = TrackMerger(settings.link_m, round(settings.track_merge_s / period_s))
        self.ages = np.full(grid.shape, NOT_OCCUPIED)
        self.tracks: list[Track] = []
        self.frame: GridFrame | None = None
        self.elapsed = 1
        self.initiated = self.restarts = 0

    def update(self, frame: GridFrame) -> None:
        """Update the tracks with one frame."""
        self.elapsed = self._periods_until(frame)
        self._scroll(frame)
        self.background.observe(frame, self.elapsed)
        clusters = self._segment(frame)
        self._predict()
        views = in_view(boundaries_of(self.tracks), self.window.fixed_grid, frame.visible)
        shares, poses, unassigned = self._associate(clusters, views)
        self._correct(shares, poses, frame.visible)
        self._update_existence(shares, views)
        self._merge()
        self._initiate(unassigned)
        self.frame = frame

    def _periods_until(self, frame: GridFrame) -> int:
        """Number of periods since the previous frame: more than one if frames are missing."""
        if self.frame is None:
            return 1
        return max(1, round((frame.stamp_ns - self.frame.stamp_ns) * 1e-9 / self.period_s))

    def _scroll(self, frame: GridFrame) -> None:
        """Move the arrays of cells to the window of the frame; if no cell remains, all tracks end."""
        self.previous_window = self.window
        if self.frame is None:
            shift = Shift()
        else:
            shift = shift_between(self.frame.world_T_grid, frame.world_T_grid, self.grid.cell_m)
        if shift or self.frame is None:
            self.background.scroll(shift, BackgroundMap(*self.site.at(frame.world_T_grid)))
        if shift:
            self.ages = rolled(self.ages, shift, NOT_OCCUPIED)
        if max(map(abs, shift)) >= self.grid.size:
            self.tracks, self.window = [], Window(self.grid)
        elif shift:
            self.window = self.window.moved(shift)

    def _segment(self, frame: GridFrame) -> list[Cluster]:
        """Clusters of the returns outside the background. Also updates the residence ages of the cells."""
        explained = self.background.explained
        self.ages = next_ages(self.ages, frame.occupied & ~explained, len(self.residence) - 1, self.elapsed)
        cells, inside = self.grid.cells_of(frame.points)
        new = inside.copy()
        new[inside] = ~explained[cells[inside, 0], cells[inside, 1]]
        points = frame.points[new].astype(np.float64)
        ranges = np.linalg.norm(points - frame.origins[frame.point_origin[new]], axis=1)
        labels = np.full(len(new), BACKGROUND)
        labels[new] = segment(points, ranges, self.settings.link_m, self.settings.link_per_m)
        cut = cut_off_returns(frame, self.grid, labels)[new]
        return clusters_of(points + self.window.offset_m, cut, labels[new])

    def _predict(self) -> None:
        """Predict the state and the existence of each track at the stamp of the frame."""
        for track in self.tracks:
            track.previous_pose = track.pose
            for _ in range(self.elapsed):
                track.estimator.predict()
            track.existence *= self.survival**self.elapsed

    def _associate(
        self, clusters: list[Cluster], views: list[Mask]
    ) -> tuple[dict[int, Cluster], dict[int, Match], list[Cluster]]:
        """Track number -> its returns, track number -> its measured pose, and the unassigned clusters."""
        if not self.tracks or not clusters:
            return {}, {}, clusters
        points = np.concatenate([cluster.points for cluster in clusters])
        distances = distances_to(points, boundaries_of(self.tracks))
        pairing = pairing_of(self.tracks, clusters, distances, views, self.settings)
        gate, method = self.settings.gate_probability, self.settings.association
        pairs = assign(pairing.costs, pairing.distances, pairing.freedom, gate, method)
        candidates = membership(self.tracks, clusters, pairs, self.settings)
        shares, unassigned = assign_returns(clusters, pairs, distances, candidates)
        return shares, measured_poses(self.tracks, shares, clusters, pairing, views, self.settings), unassigned

    def _correct(self, shares: dict[int, Cluster], poses: dict[int, Match], visible: Mask) -> None:
        """Update the state of each track with its measured pose, and its shape with its returns."""
        for number, found in poses.items():
            estimator = self.tracks[number].estimator
            before = estimator.restarts
            estimator.update(found.pose, found.covariance)
            self.restarts += estimator.restarts - before
        if shares:
            self._update_shapes([self.tracks[number] for number in shares], list(shares.values()), visible)

    def _update_shapes(self, tracks: list[Track], clusters: list[Cluster], visible: Mask) -> None:
        """Update the shape of each track with its returns; returns at previously hidden positions are `revealed`."""
        assert self.frame is not None  # the previous frame: there are tracks
        owners = owners_of(bounds_of(clusters))
        points = np.concatenate([cluster.points for cluster in clusters])
        bodies = to_body(points, poses_of(tracks)[owners])
        past = split(to_grid(bodies, np.array([track.previous_pose for track in tracks])[owners]), clusters)
        each = zip(
            *(tracks, clusters, self._ages_of(clusters), split(bodies, clusters)),
            in_view(past, self.previous_window.fixed_grid, self.frame.visible),
            in_view(boundaries_of(tracks), self.window.fixed_grid, visible),
            strict=True,
        )
        gain = -math.expm1(-self.elapsed * self.period_s / self.settings.shape_memory_s)
        for track, cluster, ages, body, known, seen in each:
            track.returns, track.ages = cluster.points, ages
            track.shape.update(body, cluster.cut, ~known, seen, self.settings.surface_noise_m, gain)

    def _update_existence(self, shares: dict[int, Cluster], views: list[Mask]) -> None:
        """Update the existence of each track with its detection, or with its miss in proportion to its visible share;
        delete improbable tracks."""
        settings = self.settings
        for number, track in enumerate(self.tracks):
            if number in shares:
                track.unseen = 0
                track.existence = existence_when_detected(
                    track.existence, settings.detection_probability, settings.clutter_probability
                )
                track.confirmed |= track.existence >= settings.confirm_above
            else:
                track.unseen += self.elapsed
                visible_share = float(track.shape.weights[views[number]].sum() / track.shape.weights.sum())
                detectable = settings.detection_probability * visible_share
                track.existence = existence_when_missed(track.existence, detectable)
        self.tracks = [track for track in self.tracks if self._is_alive(track)]

    def _is_alive(self, track: Track) -> bool:
        """Whether the track probably exists and has not left the grid unobserved."""
        if track.existence < self.settings.delete_below:
            return False
        return not track.unseen or bool(self.window.fixed_grid.cells_of(track.boundary)[1].any())

    def _merge(self) -> None:
        """Merge tracks with the background and with each other."""
        seen = [track for track in self.tracks if not track.unseen]
        for track in seen:
            track.stopped = track.stopped + self.elapsed if is_stopped(track) else 0
        static = [track for track in seen if track.stopped >= self.background_merge_periods]
        for track in static:
            self.background.add_stopped(self._cells_of(track.returns))
        self.tracks = self.track_merger.merged([track for track in self.tracks if track not in static], self.elapsed)

    def _cells_of(self, points: Array) -> Mask:
        """The cells (M, M) in which `points` (N, 2) lie."""
        cells, inside = self.window.fixed_grid.cells_of(points)
        marked = np.zeros(self.grid.shape, np.bool_)
        marked[tuple(cells[inside].T)] = True
        return marked

    def _initiate(self, clusters: list[Cluster]) -> None:
        """Initiate a tentative track from each unassigned cluster."""
        existing = tuple(self.tracks)
        for cluster, ages in zip(clusters, self._ages_of(clusters), strict=True):
            estimator = initiate(self.make_estimator, cluster, existing, self.regimes, self.settings)
            shape = Shape.of(to_body(cluster.points, estimator.mean[:3]), cluster.cut, self.settings.surface_noise_m)
            existence = self.settings.initiation_probability
            self.tracks.append(Track(self.initiated, estimator, shape, cluster.points, ages, existence))
            self.initiated += 1

    def forecast(self, steps: int) -> NDArray[np.float32]:
        """P(occupied) (steps+1, M, M) float32 at steps 0..steps; visible cells of step 0 are as observed."""
        no_classes = np.zeros((0, *self.grid.shape), np.float32), np.zeros((len(self.tracks), 0), np.float32)
        return self.forecast_classes(steps, *no_classes)[0]

    def forecast_classes(
        self, steps: int, cell_prior: NDArray[np.float32], classes: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """`forecast`, and P(class | occupied) (steps+1, K, M, M) float32.

        Tracks have `classes` (T, K), the background has the `cell_prior` (K, M, M). The classes of a cell are weighted
        by the contributions to its occupancy.
        """
        occupancy = self.background.probabilities(steps)
        semantics = weight_by_cell_prior(occupancy, cell_prior)
        if self.frame is not None:
            add_tracks(
                occupancy,
                self.tracks,
                survival=self.survival,
                regimes=self.regimes,
                frame=self.frame,
                grid=self.window.fixed_grid,
                residence=self.residence,
                settings=self.settings,
                semantics=semantics,
                classes=classes,
            )
            occupancy[0] = np.where(self.frame.visible, self.frame.occupied, occupancy[0])
            if len(cell_prior):
                attribute(semantics[0], cell_prior, self.frame.occupied, self.tracks, classes, self.window.fixed_grid)
        normalise(semantics)
        return occupancy, semantics

    def _ages_of(self, clusters: list[Cluster]) -> list[NDArray[np.int64]]:
        """Residence age of each return (N,) of each cluster, periods."""
        if not clusters:
            return []
        cells, _ = self.window.fixed_grid.cells_of(np.concatenate([cluster.points for cluster in clusters]))
        rows, columns = cells.clip(0, self.grid.size - 1).T  # a return on the edge may be rounded to the outside
        return split(self.ages[rows, columns], clusters)


def compile_pipeline(
    period_s: float, residence: NDArray[np.float32], settings: PipelineSettings, make_estimator: MakeEstimator
) -> None:
    """Compile the kernels of all stages, by running them on a scene of three frames.

    Compilation takes seconds on a machine without a cache; a tracker spends them at its start, not in an update.
    """
    grid = GridSpec(8, 0.1)
    empty = BackgroundMap(*np.zeros((2, *grid.shape), np.float32))
    pipeline = Pipeline(grid, period_s, empty, residence, settings, make_estimator)
    occupied, visible = np.zeros(grid.shape, bool), np.ones(grid.shape, bool)
    occupied[4, 4:6] = True
    for cells in (occupied, occupied, ~visible):
        points = grid.cell_centres(cells)
        origin, owner = np.zeros((1, 2), np.float32), np.zeros(len(points), np.uint8)
        pipeline.forecast(1)
        pipeline.update(GridFrame(0, visible, cells, SE2(), origin, points, owner))
    pipeline.forecast(1)


SHADOW_M = 2.0
"""Largest gap between the cut-off ends of a body and of a cluster that may be its continuation behind an occluder."""
MOVING_MPS = 1.0
"""Slower bodies are not continued: in a queue, neighbours are different objects."""
PART_VELOCITY_MPS = 0.5
"""Standard deviation of the velocity of such a cluster relative to the body."""
SIGNIFICANT = float(chdtri(2, 1.0 - 0.95))
"""Beyond this squared Mahalanobis distance two velocities differ significantly."""
KNOWN_MPS = 0.5
"""Limit of the root mean square error of a velocity that counts as zero."""


def initiate(
    make_estimator: MakeEstimator,
    cluster: Cluster,
    tracks: Sequence[Track],
    regimes: Regimes,
    settings: PipelineSettings,
) -> SwitchingEstimator:
    """The estimator of a new track; the body frame lies at the centre of the cluster, parallel to the grid.

    The mean velocity is zero, or the velocity of the long moving body of `tracks` that the cluster seems to continue: a
    bus appears from behind pedestrians window by window, and the pose of a single window does not show its speed.
    """
    initiated = SwitchingEstimator(make_estimator, np.array([*cluster.centre, 0.0]), pose_noise(settings), regimes)
    body = continued_by(cluster, tracks)
    if body is not None:
        mean, covariance = initiated.mean.copy(), initiated.covariance.copy()
        mean[3:5] = body.estimator.mean[3:5]
        covariance[3:5, 3:5] = body.estimator.covariance[3:5, 3:5] + PART_VELOCITY_MPS**2 * np.eye(2)
        initiated.reinitialise(mean, covariance)
    return initiated


def continued_by(cluster: Cluster, tracks: Sequence[Track]) -> Track | None:
    """The confirmed, long, moving track with cut-off boundary points nearest to the cut-off points of the cluster."""
    bodies = [track for track in tracks if _can_continue(track)]
    if not bodies or not cluster.cut.any():
        return None
    ends = [body.boundary[body.shape.cut] for body in bodies]
    gaps = distances_to(cluster.points[cluster.cut], ends).min(axis=0)
    nearest = int(gaps.argmin())
    return bodies[nearest] if gaps[nearest] <= SHADOW_M else None


def _can_continue(track: Track) -> bool:
    moving = float(np.hypot(*track.estimator.mean[3:5])) > MOVING_MPS
    long = track.shape.extent_m >= HEADING_FROM_M
    return track.confirmed and not track.unseen and moving and long and bool(track.shape.cut.any())


def velocities_agree(difference: Array, covariance: Array) -> bool:
    """Whether a velocity, or a difference of two, (2,) m/s with covariance (2, 2), is not significantly nonzero."""
    (x, y), ((xx, xy), (_, yy)) = difference.tolist(), covariance.tolist()
    return bool(yy * x * x - 2.0 * xy * x * y + xx * y * y < SIGNIFICANT * (xx * yy - xy * xy))


def is_stopped(track: Track) -> bool:
    """Whether the track's velocity is known and not significantly different from zero."""
    mean, covariance = track.estimator.mean[3:5], track.estimator.covariance[3:5, 3:5]
    return bool(covariance.trace() <= KNOWN_MPS**2) and velocities_agree(mean, covariance)


class TrackMerger:
    """Merges two tracks after `periods` consecutive periods in which they touched and their velocities agreed."""

    def __init__(self, touch_m: float, periods: int) -> None:
        self._touch_m, self._periods = touch_m, periods
        self._together: dict[tuple[int, int], int] = {}

    def merged(self, tracks: Sequence[Track], periods: int) -> list[Track]:
        """The tracks, `periods` after the last call, without the younger track of each merged pair."""
        seen = [track for track in tracks if track.confirmed and not track.unseen]
        together = {}
        merged: set[int] = set()
        for older, younger in _touching(seen, self._touch_m):
            if _velocities_of_tracks_agree(older, younger):
                key = older.identity, younger.identity
                together[key] = self._together.get(key, 0) + periods
                if together[key] >= self._periods and not merged & set(key):
                    merge_into(older, younger)
                    merged.add(younger.identity)
        self._together = together
        return [track for track in tracks if track.identity not in merged]


def merge_into(track: Track, other: Track) -> None:
    """Add the boundary and the newest returns of `other` to `track`."""
    track.shape.extend(other.shape, to_body(other.boundary, track.pose))
    track.returns = np.concatenate([track.returns, other.returns])
    track.ages = np.concatenate([track.ages, other.ages])


def _velocities_of_tracks_agree(one: Track, other: Track) -> bool:
    difference = one.estimator.mean[3:5] - other.estimator.mean[3:5]
    return velocities_agree(difference, one.estimator.covariance[3:5, 3:5] + other.estimator.covariance[3:5, 3:5])


def _touching(tracks: Sequence[Track], touch_m: float) -> Iterator[tuple[Track, Track]]:
    """Pairs of tracks with boundaries within `touch_m`, the older track first; bounding boxes are compared first."""
    if not tracks:
        return
    boundaries = boundaries_of(tracks)
    points, starts = np.concatenate(boundaries), bounds_of(boundaries)[:-1]
    low, high = np.minimum.reduceat(points, starts), np.maximum.reduceat(points, starts) + touch_m
    overlap = (low[:, None] <= high).all(axis=2) & (low <= high[:, None]).all(axis=2)
    for first, second in np.argwhere(np.triu(overlap, 1)).tolist():
        if distances_to(boundaries[first], [boundaries[second]]).min() <= touch_m:
            yield tracks[first], tracks[second]
