"""Classes of tracks: what a track's returns look like now, as mixtures of Gaussians, averaged over its life."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from gridtrack.common.errors import WeightsError
from gridtrack.common.grid import GridFrame, GridSpec, Mask
from gridtrack.trackers.model_free.arrays import Array
from gridtrack.trackers.model_free.ragged import bounds_of
from gridtrack.trackers.model_free.tracks import Track
from gridtrack.trackers.weights import Weights, array

Planes = NDArray[np.float32]

FEATURES = ("length", "along", "across", "speed", "range")
"""All of them logarithms, see `features_of`."""
MAX_COMPONENTS, MAX_POWER, LARGEST = 64, 10.0, 1e9
PREFIX = "class_"
"""Of the names of the arrays in a weights file."""
LEAST = 1e-6
"""Least weight of the place's prior in a cell, so that it decides where nothing is drawn."""


class ClassModel(NamedTuple):
    """Classes k of K, each a mixture of at most C Gaussians of F features: mixture discriminant analysis.

    `shares` (K, C) of the Gaussians, `means` (K, C, F), and for all of one class one `whitening` (K, F, F): features
    times it have covariance 1. `frequency` (K,) of the classes among tracks; `place` (K, M, M) of them among the
    returns of each cell. `powers` (2,): for how many independent frames a whole life counts, and how far the place a
    track is at goes before the frequency.
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
        kinds, features = len(weights.card.classes), len(FEATURES)
        shares = weights.arrays.get(PREFIX + "mixture_weights")
        components = shares.shape[1] if shares is not None and shares.ndim == 2 else 1
        if not 1 <= components <= MAX_COMPONENTS:
            raise WeightsError(
                f"weights of {weights.card.tracker}: {components} Gaussians of a class, expected 1 to {MAX_COMPONENTS}"
            )
        shapes: dict[str, tuple[int, ...]] = {
            "mixture_weights": (kinds, components),
            "means": (kinds, components, features),
            "whitening": (kinds, features, features),
            "frequency": (kinds,),
            "powers": (2,),
            "cell_prior": (kinds, *grid.shape),
        }
        found = {name: array(weights, PREFIX + name, shape) for name, shape in shapes.items()}
        model = cls(**{name: np.ascontiguousarray(each, np.float64) for name, each in found.items()})
        model._check(f"weights of {weights.card.tracker}")
        return model

    def arrays(self) -> dict[str, NDArray[np.float32]]:
        """What is kept in a file, by name."""
        return {PREFIX + name: np.asarray(value, np.float32) for name, value in self._asdict().items()}

    def _check(self, where: str) -> None:
        """Raises WeightsError where the values are no probabilities, or not finite."""
        for name, value in self._asdict().items():
            if not (np.abs(value) <= LARGEST).all():
                raise WeightsError(f"{where}: array '{PREFIX}{name}' is not finite or beyond {LARGEST:g}: train again")
        for name, axis in (("mixture_weights", 1), ("frequency", 0), ("cell_prior", 0)):
            value = getattr(self, name)
            if (value < 0).any() or np.abs(value.sum(axis=axis) - 1.0).max() > 1e-3:
                raise WeightsError(f"{where}: array '{PREFIX}{name}' does not hold probabilities: train again")
            if (value <= 0).any() and name != "mixture_weights":
                raise WeightsError(f"{where}: array '{PREFIX}{name}' rules a class out: train again")
        if not np.linalg.det(self.whitening).all():
            raise WeightsError(f"{where}: array '{PREFIX}whitening' is singular: train again")
        if self.powers.min() < 0 or self.powers.max() > MAX_POWER:
            raise WeightsError(f"{where}: '{PREFIX}powers' are not from 0 to {MAX_POWER:g}: train again")

    def of_unknown_place(self) -> ClassModel:
        """The same where nothing is known of the place: each class is everywhere as frequent as in the mean of it."""
        mean = self.cell_prior.mean(axis=(1, 2), keepdims=True)
        return self._replace(cell_prior=np.broadcast_to(mean, self.cell_prior.shape).copy())

    def log_densities(self, features: Array) -> Array:
        """log p(features | class) (T, K) of `features` (T, F)."""
        return np.asarray(_log_densities(features, self.mixture_weights, self.means, self.whitening))

    def log_place(self, tracks: Sequence[Track], grid: GridSpec) -> Array:
        """log P(class) (T, K) where the newest returns of the tracks lie, the mean over them."""
        cells, inside = grid.cells_of(np.concatenate([track.returns for track in tracks]))
        owner = np.repeat(np.arange(len(tracks)), [len(track.returns) for track in tracks])[inside]
        found = np.zeros((len(tracks), len(self.frequency)))
        np.add.at(found, owner, self.cell_prior[:, cells[inside, 0], cells[inside, 1]].T)
        return np.log(found / np.maximum(np.bincount(owner, minlength=len(tracks)), 1)[:, None])

    def posteriors(self, evidence: Array, log_place: Array) -> Array:
        """P(class) (T, K) from mean log densities (T, K) over each track's life, and from where each is (T, K)."""
        life, place = self.powers
        log = life * evidence + place * log_place + (1.0 - place) * np.log(self.frequency)
        odds = np.exp(log - log.max(axis=1, keepdims=True))
        return np.asarray(odds / odds.sum(axis=1, keepdims=True))


@dataclass(slots=True)
class Evidence:
    """Of one track: the sum of its log densities (K,) over `frames`, and log P(class) (K,) where it was last seen."""

    densities: Array
    frames: int
    log_place: Array


class ClassFilter:
    """The classes of tracks: the mean of the log densities of all frames in which a track was seen, and its place.

    What is seen in neighbouring frames is nearly the same, so that frames do not count as independent; what a track
    looked like before it was hidden still counts.
    """

    def __init__(self, model: ClassModel, grid: GridSpec) -> None:
        self.model, self.cell_prior, self._grid = model, model.cell_prior.astype(np.float32), grid
        self._evidence: dict[int, Evidence] = {}

    def observe(self, tracks: Sequence[Track], frame: GridFrame) -> None:
        """Take in what the `tracks` look like after the update with `frame`; those that are gone are forgotten."""
        kept = {one.identity: self._evidence[one.identity] for one in tracks if one.identity in self._evidence}
        seen = [track for track in tracks if not track.unseen]
        if seen:
            densities = self.model.log_densities(features_of(seen, frame))
            places = self.model.log_place(seen, self._grid)
            for track, density, place in zip(seen, densities, places, strict=True):
                before = kept.get(track.identity)
                total, frames = (before.densities, before.frames) if before else (0.0, 0)
                kept[track.identity] = Evidence(total + density, frames + 1, place)
        self._evidence = kept

    def posteriors(self, tracks: Sequence[Track]) -> Planes:
        """P(class) (T, K) float32 of tracks that have been observed."""
        if not tracks:
            return np.zeros((0, len(self.cell_prior)), np.float32)
        evidence = [self._evidence[track.identity] for track in tracks]
        means = np.stack([one.densities / one.frames for one in evidence])
        return self.model.posteriors(means, np.stack([one.log_place for one in evidence])).astype(np.float32)


def compile_ahead(model: ClassModel) -> None:
    """Run once what is compiled on first use, so that it has been when the first frame comes."""
    nowhere = np.zeros((1, 2))
    model.log_densities(_features(nowhere, np.array([0, 1]), nowhere, nowhere))


def features_of(tracks: Sequence[Track], frame: GridFrame) -> Array:
    """FEATURES (T, F) of tracks that are seen in `frame`.

    Extents of the newest returns along their own longer axis, and along and across the motion; speed; and the range of
    their centre from the nearest sensor, for what is far shows fewer returns.
    """
    ends = bounds_of([track.returns for track in tracks])
    motions = np.array([track.estimator.mean[3:5] for track in tracks])
    points = np.concatenate([track.returns for track in tracks])
    return np.asarray(_features(points, ends, motions, frame.origins.astype(np.float64)))


def weight_by_cell_prior(occupancy: Planes, cell_prior: Planes) -> Planes:
    """Semantics (steps+1, K, M, M), not normalised: what the background shows has the classes of `cell_prior`."""
    semantics = np.empty((len(occupancy), *cell_prior.shape), np.float32)
    _weight_by_cell_prior(semantics, occupancy, cell_prior)
    return semantics


def attribute(
    semantics: Planes, cell_prior: Planes, occupied: Mask, tracks: Sequence[Track], classes: Planes, grid: GridSpec
) -> None:
    """Give the cells seen `occupied` (M, M) the classes of what is seen there, in `semantics` (K, M, M) of that frame.

    A track's own returns have its `classes` (T, K); the others are the background's, with the classes of `cell_prior`.
    """
    semantics[:, occupied] = cell_prior[:, occupied]
    seen = [number for number, track in enumerate(tracks) if not track.unseen]
    if seen:
        cells, inside = grid.cells_of(np.concatenate([tracks[number].returns for number in seen]))
        owner = np.repeat(seen, [len(tracks[number].returns) for number in seen])[inside]
        semantics[:, cells[inside, 0], cells[inside, 1]] = classes[owner].T


def normalise(semantics: Planes) -> None:
    """Scale each cell's classes (steps+1, K, M, M) to sum to 1, in place; their sum must be positive."""
    steps, kinds, rows, columns = semantics.shape
    _normalise(semantics.reshape(steps, kinds, rows * columns))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _features(points, ends, motions, origins):  # type: ignore[no-untyped-def]
    features = np.empty((len(motions), 5))
    for t in range(len(motions)):
        own = points[ends[t] : ends[t + 1]]
        x, y = own[:, 0].mean(), own[:, 1].mean()
        xy, less = ((own[:, 0] - x) * (own[:, 1] - y)).sum(), ((own[:, 0] - x) ** 2 - (own[:, 1] - y) ** 2).sum()
        axis = 0.5 * math.atan2(2.0 * xy, less)
        length, _ = _extents(own, axis)
        along, across = _extents(own, math.atan2(motions[t, 1], motions[t, 0]))
        distance = np.inf if len(origins) else 0.0
        for i in range(len(origins)):
            distance = min(distance, math.hypot(origins[i, 0] - x, origins[i, 1] - y))
        # what is added is about the least that can be told apart, so that logarithms of less differ little
        features[t, 0], features[t, 1], features[t, 2] = length + 0.2, along + 0.2, across + 0.2
        features[t, 3], features[t, 4] = math.hypot(motions[t, 0], motions[t, 1]) + 0.3, distance + 1.0
    return np.log(features)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _extents(points, heading):  # type: ignore[no-untyped-def]
    """Extents of `points` (N, 2) along a heading and across it."""
    cosine, sine = math.cos(heading), math.sin(heading)
    along, across = points[:, 0] * cosine + points[:, 1] * sine, points[:, 1] * cosine - points[:, 0] * sine
    return along.max() - along.min(), across.max() - across.min()


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _log_densities(features, shares, means, whitening):  # type: ignore[no-untyped-def]
    kinds, components, count = means.shape
    found, logs = np.empty((len(features), kinds)), np.empty(components)
    for k in range(kinds):
        scale = math.log(abs(np.linalg.det(whitening[k]))) - 0.5 * count * math.log(2.0 * math.pi)
        whitened, centres = features @ whitening[k], means[k] @ whitening[k]
        for t in range(len(features)):
            best = -np.inf
            for c in range(components):
                logs[c] = math.log(shares[k, c])
                for i in range(count):
                    logs[c] -= 0.5 * (whitened[t, i] - centres[c, i]) ** 2
                best = max(best, logs[c])
            total = 0.0
            for c in range(components):
                total += math.exp(logs[c] - best)
            found[t, k] = scale + best + math.log(total)
    return found


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _weight_by_cell_prior(semantics, occupancy, place):  # type: ignore[no-untyped-def]
    steps, kinds, size, _ = semantics.shape
    for step in range(steps):
        for k in range(kinds):
            for row in range(size):
                into, shown, share = semantics[step, k, row], occupancy[step, row], place[k, row]
                for column in range(size):
                    into[column] = max(shown[column], np.float32(LEAST)) * share[column]


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def _normalise(semantics):  # type: ignore[no-untyped-def]
    steps, kinds, cells = semantics.shape
    if not kinds:
        return
    total = np.empty(cells, np.float32)
    for step in range(steps):
        total[:] = 0.0
        for k in range(kinds):
            for cell in range(cells):
                total[cell] += semantics[step, k, cell]
        for cell in range(cells):
            total[cell] = np.float32(1.0) / total[cell]
        for k in range(kinds):
            for cell in range(cells):
                semantics[step, k, cell] *= total[cell]
