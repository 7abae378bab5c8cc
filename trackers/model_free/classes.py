"""Classes of tracks: Gaussian mixtures of the features of a track's returns, averaged over its lifetime."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from gridtrack.common.errors import WeightsError
from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec
from gridtrack.trackers.model_free.arrays import Array, bounds_of
from gridtrack.trackers.model_free.tracks import Track, Window
from gridtrack.trackers.site_map import SiteMap, mean_of_cells
from gridtrack.trackers.training.weights import Weights, array

FEATURES = ("length", "along", "across", "speed", "range")
"""Each as a logarithm, see `features_of`."""
MAX_COMPONENTS, MAX_POWER, MAX_VALUE = 64, 10.0, 1e9
ARRAY_PREFIX = "class_"
"""Prefix of the names of the arrays in a weights file."""


class ClassModel(NamedTuple):
    """K classes, each a mixture of at most C Gaussians of F features: mixture discriminant analysis.

    `mixture_weights` (K, C), `means` (K, C, F), and one `whitening` (K, F, F) of each class: features times it have
    covariance 1. `frequency` (K,): prior of the classes of tracks; `cell_prior` (K, M, M): prior of the classes of the
    returns in each cell. `powers` (2,): a lifetime counts as so many independent frames, and the weight of the cell
    prior against the frequency.
    """

    mixture_weights: Array
    means: Array
    whitening: Array
    frequency: Array
    powers: Array
    cell_prior: Array

    @classmethod
    def of(cls, weights: Weights, grid: GridSpec) -> ClassModel:
        """The model in `weights`, checked. Raises WeightsError."""
        classes, features = len(weights.card.classes), len(FEATURES)
        mixture = weights.arrays.get(ARRAY_PREFIX + "mixture_weights")
        components = mixture.shape[1] if mixture is not None and mixture.ndim == 2 else 1
        if not 1 <= components <= MAX_COMPONENTS:
            raise WeightsError(
                f"weights of {weights.card.tracker}: {components} Gaussians of a class, expected 1 to {MAX_COMPONENTS}"
            )
        shapes: dict[str, tuple[int, ...]] = {
            "mixture_weights": (classes, components),
            "means": (classes, components, features),
            "whitening": (classes, features, features),
            "frequency": (classes,),
            "powers": (2,),
            "cell_prior": (classes, *grid.shape),
        }
        found = {name: array(weights, ARRAY_PREFIX + name, shape) for name, shape in shapes.items()}
        model = cls(**{name: np.ascontiguousarray(each, np.float64) for name, each in found.items()})
        model._check(f"weights of {weights.card.tracker}")
        return model

    def arrays(self) -> dict[str, NDArray[np.float32]]:
        """The arrays of the weights file, by name."""
        return {ARRAY_PREFIX + name: np.asarray(value, np.float32) for name, value in self._asdict().items()}

    def _check(self, where: str) -> None:
        """Raises WeightsError for values that are not finite or not probabilities."""
        for name, value in self._asdict().items():
            if not (np.abs(value) <= MAX_VALUE).all():
                raise WeightsError(
                    f"{where}: array '{ARRAY_PREFIX}{name}' is not finite or beyond {MAX_VALUE:g}: train again"
                )
        for name, axis in (("mixture_weights", 1), ("frequency", 0), ("cell_prior", 0)):
            value = getattr(self, name)
            if (value < 0).any() or np.abs(value.sum(axis=axis) - 1.0).max() > 1e-3:
                raise WeightsError(f"{where}: array '{ARRAY_PREFIX}{name}' does not hold probabilities: train again")
            if (value <= 0).any() and name != "mixture_weights":
                raise WeightsError(f"{where}: array '{ARRAY_PREFIX}{name}' rules a class out: train again")
        if not np.linalg.det(self.whitening).all():
            raise WeightsError(f"{where}: array '{ARRAY_PREFIX}whitening' is singular: train again")
        if self.powers.min() < 0 or self.powers.max() > MAX_POWER:
            raise WeightsError(f"{where}: '{ARRAY_PREFIX}powers' are not from 0 to {MAX_POWER:g}: train again")

    def without_site(self) -> ClassModel:
        """The model without knowledge of the site: the prior of each cell is the mean over all cells."""
        mean = self.cell_prior.mean(axis=(1, 2), keepdims=True)
        return self._replace(cell_prior=np.broadcast_to(mean, self.cell_prior.shape).copy())

    def log_densities(self, features: Array) -> Array:
        """log p(features | class) (T, K) of `features` (T, F)."""
        _, scale = np.linalg.slogdet(self.whitening)
        whitened, centres = features @ self.whitening, self.means @ self.whitening
        scale = scale - 0.5 * len(FEATURES) * math.log(2.0 * math.pi)
        return np.asarray(_log_mixtures(whitened, centres, self.mixture_weights, scale))

    def posteriors(self, evidence: Array, log_prior: Array) -> Array:
        """P(class) (T, K) from `evidence`, mean log densities over the lifetime of a track, and `log_prior` (T, K)."""
        life, prior = self.powers
        log = life * evidence + prior * log_prior + (1.0 - prior) * np.log(self.frequency)
        odds = np.exp(log - log.max(axis=1, keepdims=True))
        return np.asarray(odds / odds.sum(axis=1, keepdims=True))


def mean_log_prior(tracks: Sequence[Track], cell_prior: NDArray[np.floating], window: Window) -> Array:
    """log of the mean of `cell_prior` (K, M, M) over the newest returns of each track, (T, K)."""
    cells, inside = window.fixed_grid.cells_of(np.concatenate([track.returns for track in tracks]))
    owner = np.repeat(np.arange(len(tracks)), [len(track.returns) for track in tracks])[inside]
    found = np.zeros((len(tracks), len(cell_prior)))
    np.add.at(found, owner, cell_prior[:, cells[inside, 0], cells[inside, 1]].T)
    return np.log(found / np.maximum(np.bincount(owner, minlength=len(tracks)), 1)[:, None])


@dataclass(slots=True)
class Evidence:
    """Evidence of one track: sum of its log densities (K,) over `frames`, and its last log prior (K,)."""

    densities: Array
    frames: int
    log_prior: Array


class ClassFilter:
    """Classes of tracks, from the mean log density over all frames in which a track was seen, and its cell prior.

    Consecutive frames are strongly correlated, so they do not count as independent; frames before an occlusion count.
    `cell_prior` (K, M, M) float32 is in the present window; its counts are from a grid at `world_T_map`.
    """

    def __init__(self, model: ClassModel, grid: GridSpec, world_T_map: SE2 | None = None) -> None:
        prior = model.cell_prior.astype(np.float32)
        self.model, self.cell_prior = model, prior
        self._site = SiteMap(prior, mean_of_cells(prior), grid.cell_m, world_T_map)
        self._evidence: dict[int, Evidence] = {}

    def observe(self, tracks: Sequence[Track], frame: GridFrame, window: Window) -> None:
        """Update the evidence of the `tracks` after their update with `frame`, and forget deleted tracks."""
        self.cell_prior = self._site.at(frame.world_T_grid)
        kept = {one.identity: self._evidence[one.identity] for one in tracks if one.identity in self._evidence}
        seen = [track for track in tracks if not track.unseen]
        if seen:
            densities = self.model.log_densities(features_of(seen, frame, window))
            priors = mean_log_prior(seen, self.cell_prior, window)
            for track, density, prior in zip(seen, densities, priors, strict=True):
                known = kept.get(track.identity)
                total, frames = (known.densities, known.frames) if known else (0.0, 0)
                kept[track.identity] = Evidence(total + density, frames + 1, prior)
        self._evidence = kept

    def posteriors(self, tracks: Sequence[Track]) -> NDArray[np.float32]:
        """P(class) (T, K) float32 of tracks that have been observed."""
        if not tracks:
            return np.zeros((0, len(self.cell_prior)), np.float32)
        evidence = [self._evidence[track.identity] for track in tracks]
        means = np.stack([one.densities / one.frames for one in evidence])
        return self.model.posteriors(means, np.stack([one.log_prior for one in evidence])).astype(np.float32)


def compile_densities(model: ClassModel) -> None:
    """Compile the kernels, before the first frame."""
    points = np.zeros((1, 2))
    model.log_densities(_features(points, np.array([0, 1]), points, points))


def features_of(tracks: Sequence[Track], frame: GridFrame, window: Window) -> Array:
    """FEATURES (T, F), as logarithms, of tracks with returns in `frame`, which has this `window`.

    Extents of the newest returns along their principal axis, along the motion and across it, metres; speed, m/s; range
    of their centre from the nearest sensor, metres: distant objects have fewer returns.
    """
    ends = bounds_of([track.returns for track in tracks])
    motions = np.array([track.estimator.mean[3:5] for track in tracks])
    points = np.concatenate([track.returns for track in tracks])
    return np.asarray(_features(points, ends, motions, frame.origins + window.offset_m))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _features(points, ends, motions, origins):  # type: ignore[no-untyped-def]
    features = np.empty((len(motions), 5))
    for t in range(len(motions)):
        first, last = ends[t], ends[t + 1]
        x = y = xy = less = 0.0
        for i in range(first, last):
            x += points[i, 0]
            y += points[i, 1]
        x, y = x / (last - first), y / (last - first)
        for i in range(first, last):
            xy += (points[i, 0] - x) * (points[i, 1] - y)
            less += (points[i, 0] - x) ** 2 - (points[i, 1] - y) ** 2
        length, _ = _extents(points, first, last, 0.5 * math.atan2(2.0 * xy, less))
        along, across = _extents(points, first, last, math.atan2(motions[t, 1], motions[t, 0]))
        distance = np.inf if len(origins) else 0.0
        for i in range(len(origins)):
            distance = min(distance, math.hypot(origins[i, 0] - x, origins[i, 1] - y))
        # the offsets are about the resolution, so that the logarithms of smaller values differ little
        features[t, 0], features[t, 1], features[t, 2] = length + 0.2, along + 0.2, across + 0.2
        features[t, 3], features[t, 4] = math.hypot(motions[t, 0], motions[t, 1]) + 0.3, distance + 1.0
        for i in range(5):
            features[t, i] = math.log(features[t, i])
    return features


@numba.njit(error_model="numpy")
def _extents(points, first, last, heading):  # type: ignore[no-untyped-def]
    """Extents of the `points` (N, 2) from `first` up to but not including `last`, along a heading and across it."""
    cosine, sine = math.cos(heading), math.sin(heading)
    front = left = -np.inf
    back = right = np.inf
    for i in range(first, last):
        along, across = points[i, 0] * cosine + points[i, 1] * sine, points[i, 1] * cosine - points[i, 0] * sine
        front, back = max(front, along), min(back, along)
        left, right = max(left, across), min(right, across)
    return front - back, left - right


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _log_mixtures(features, centres, weights, scale):  # type: ignore[no-untyped-def]
    """Log densities (T, K) of whitened `features` (K, T, F): each class has C Gaussians around `centres` (K, C, F).

    `weights` (K, C) of the Gaussians; `scale` (K,) is the logarithm of the density at the centre of one.
    """
    classes, components, count = centres.shape
    found, logs = np.empty((features.shape[1], classes)), np.empty(components)
    for k in range(classes):
        for t in range(features.shape[1]):
            best = -np.inf
            for c in range(components):
                logs[c] = math.log(weights[k, c])
                for i in range(count):
                    logs[c] -= 0.5 * (features[k, t, i] - centres[k, c, i]) ** 2
                best = max(best, logs[c])
            total = 0.0
            for c in range(components):
                total += math.exp(logs[c] - best)
            found[t, k] = scale[k] + best + math.log(total)
    return found
