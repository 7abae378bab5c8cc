"""Learning classes: mixtures of Gaussians fitted to the features of tracks in labelled scans, and counts of a place."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from sklearn.exceptions import ConvergenceWarning
from sklearn.mixture import GaussianMixture

from gridtrack.common.errors import ConfigurationError, WeightsError
from gridtrack.common.grid import LabelledFrame
from gridtrack.trackers.contract import FitOutput, FrameSource, stream_of
from gridtrack.trackers.labelled_stretch import LabelledStretch, class_indices, draw_labelled, learned_classes
from gridtrack.trackers.model_free.classes import FEATURES, PREFIX, ClassModel, features_of
from gridtrack.trackers.model_free.settings import ModelFreeSettings
from gridtrack.trackers.weights import load_weights, save_weights, with_classes

if TYPE_CHECKING:
    from gridtrack.trackers.model_free.tracker import ModelFreeTracker

COMPONENTS = (1, 2, 4, 8)
LIFE_POWERS = (0.1, 0.15, 0.25, 0.35, 0.5, 0.7, 1.0)
PLACE_POWERS = (0.0, 0.25, 0.5, 0.75, 1.0)
"""What is chosen by the validation stretch: see ClassModel."""
SHRINKAGE = 0.05
"""Added to the variances of features of which each has variance 1."""
TRACKS_A_COMPONENT = 40
"""A Gaussian has at least so many frames of tracks of its class to learn from."""
NEAR_M, NEAR_RETURNS, ANY_RETURNS = 1.6, 1.0, 10.0
"""A cell's classes are those of its own returns and, worth NEAR_RETURNS of them, of those about it, under a Gaussian so
wide; these in turn are worth what they are against ANY_RETURNS of all the place."""


class Tracked(NamedTuple):
    """Tracks seen in labelled frames, one row for each track and frame, in order of track and then of time.

    `features` (N, F), `track` (N,) its number, `cells` (N, K) how many labelled cells of each class its returns lie in,
    `returns` the cells (R,), row * M + column, of its newest returns.
    """

    features: NDArray[np.float64]
    track: NDArray[np.int64]
    cells: NDArray[np.int64]
    returns: list[NDArray[np.int64]]

    def mean_over_life(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """The mean (N, K) of values (N, K) over the rows of a track up to each."""
        sums = np.cumsum(values, axis=0)
        first = np.searchsorted(self.track, self.track)
        before = np.where(first[:, None] > 0, sums[first - 1], 0.0)
        return np.asarray((sums - before) / (np.arange(len(values)) - first + 1)[:, None])


def draw_scans(train: Sequence[FrameSource], out: FitOutput, options: ModelFreeSettings) -> LabelledStretch | None:
    """The labelled scans to learn from; None where no classes are asked for, or none are there.

    Raises ConfigurationError where fewer scans are labelled, WeightsError where classes are to be added to no weights.
    """
    if options.stage == "classes" and not out.path.exists():
        raise WeightsError(f"{out.path}: no weights to add classes to: train with stage=both, or put them there")
    if options.stage == "occupancy" or (options.stage == "both" and not any(source.classes for source in train)):
        return None
    return draw_labelled(train, options.labelled_scans, out.seed)


def add_classes(
    kind: type[ModelFreeTracker],
    stretch: LabelledStretch,
    train: Sequence[FrameSource],
    validation: Sequence[FrameSource],
    out: FitOutput,
    options: ModelFreeSettings,
) -> None:
    """Learn classes from `stretch` for the weights at `out.path`, and put them beside what is there, which stays.

    Raises ConfigurationError where `validation` has no labels to choose by.
    """
    names = stretch.source.classes
    classes = learned_classes(names, (item.labels for item in stretch.frames))
    out.report(f"classes {', '.join(classes)} from {stretch.name}")

    weights = load_weights(stream_of(stretch.source, out.path), kind.name)
    bare = {name: value for name, value in weights.arrays.items() if not name.startswith(PREFIX)}
    with TemporaryDirectory() as folder:
        draft = Path(folder) / out.path.name
        save_weights(draft, weights.card.model_copy(update={"classes": ()}), bare)
        tracker = kind(stream_of(stretch.source, draft), ModelFreeSettings())
    learned = tracked(tracker, [(names, stretch.frames)], classes)
    held_out = tracked(tracker, ((source.classes, source.labelled()) for source in validation), classes)
    if not held_out.cells.any():
        names_of = ", ".join(source.name for source in validation)
        raise ConfigurationError(f"{names_of}: no track there has a label: give a --validation with labels")
    place = place_classes(count_cells(stretch, classes), stretch.source.grid.cell_m)
    model, loss = best_model(learned, held_out, place, out)

    results = _results(stretch, learned, classes, model, loss, out)
    settings = {"labelled_scans": options.labelled_scans}
    card = with_classes(weights.card, classes, train, validation, settings, results)
    save_weights(out.path, card, bare | model.arrays())


def tracked(
    tracker: ModelFreeTracker,
    labelled: Iterable[tuple[Sequence[str], Iterable[LabelledFrame]]],
    classes: Sequence[str],
) -> Tracked:
    """The tracks in labelled streams, each from its beginning. Labels index the names that come with the frames."""
    grid, rows = tracker.stream.grid, []
    for stretch, (names, frames) in enumerate(labelled):
        tracker.reset(0)
        for item in frames:
            tracker.update(item.frame)
            class_at = np.full(grid.size**2, len(classes))
            target = class_indices(item.labels, names, classes)
            class_at[item.cells[target >= 0]] = target[target >= 0]
            seen = [track for track in tracker.tracks if not track.unseen]
            for track, features in zip(seen, features_of(seen, item.frame) if seen else (), strict=True):
                cells, inside = grid.cells_of(track.returns)
                returns = cells[inside, 0] * grid.size + cells[inside, 1]
                count = np.bincount(class_at[returns], minlength=len(classes) + 1)[:-1]
                rows.append(((stretch, track.identity), features, count, returns))
    rows.sort(key=lambda row: row[0])
    identities = np.array([row[0] for row in rows]).reshape(-1, 2)
    return Tracked(
        np.array([row[1] for row in rows]).reshape(-1, len(FEATURES)),
        np.unique(identities, axis=0, return_inverse=True)[1].reshape(-1),
        np.array([row[2] for row in rows], np.int64).reshape(-1, len(classes)),
        [row[3] for row in rows],
    )


def count_cells(stretch: LabelledStretch, classes: Sequence[str]) -> NDArray[np.float64]:
    """How often each cell was labelled as each class, (K, M, M)."""
    size = stretch.source.grid.size
    count = np.zeros((len(classes), size**2))
    for item in stretch.frames:
        target = class_indices(item.labels, stretch.source.classes, classes)
        np.add.at(count, (target, item.cells), 1.0)
    return count.reshape(-1, size, size)


def place_classes(count: NDArray[np.float64], cell_m: float) -> NDArray[np.float64]:
    """P(class) of a return in each cell (K, M, M) from counts (K, M, M), smoothed: see NEAR_M; all are positive."""
    sigma = NEAR_M / cell_m
    near = np.stack([gaussian_filter(each, sigma, mode="constant") for each in count]) * 2.0 * np.pi * sigma**2
    near += ANY_RETURNS * (count.sum(axis=(1, 2)) / count.sum())[:, None, None]
    smoothed = count + NEAR_RETURNS * near / near.sum(axis=0)
    return np.asarray(smoothed / smoothed.sum(axis=0))


def best_model(
    learned: Tracked, held_out: Tracked, place: NDArray[np.float64], out: FitOutput
) -> tuple[ClassModel, float]:
    """The model, out of COMPONENTS and powers, with the least log loss of `held_out` cells; and that, nats a cell."""
    flat = place.reshape(len(place), -1)
    log_place = np.log(np.stack([flat[:, returns].mean(axis=1) for returns in held_out.returns]))
    best: tuple[ClassModel, float] | None = None
    for components in COMPONENTS:
        model = fit_mixtures(learned, place, components, out.seed)
        evidence = held_out.mean_over_life(model.log_densities(held_out.features))
        tried = [
            (candidate, log_loss(candidate.posteriors(evidence, log_place), held_out.cells))
            for powers in product(LIFE_POWERS, PLACE_POWERS)
            for candidate in [model._replace(powers=np.array(powers))]
        ]
        chosen = min(tried, key=lambda one: one[1])
        out.report(
            f"at most {components} Gaussians of a class: validation log loss {chosen[1]:.4f} nats a cell, powers"
            f" {chosen[0].powers.tolist()}"
        )
        best = chosen if best is None or chosen[1] < best[1] else best
    assert best is not None
    return best


def fit_mixtures(learned: Tracked, place: NDArray[np.float64], components: int, seed: int) -> ClassModel:
    """Mixture discriminant analysis (Hastie and Tibshirani, 1996): for each class Gaussians of one covariance.

    A track's class is that of most of its cells. Powers are yet to be chosen. A class that no track has is as all
    tracks together are.
    """
    known = learned.cells.any(axis=1)
    features, targets = learned.features[known], learned.cells[known].argmax(axis=1)
    mean, scale = features.mean(axis=0), features.std(axis=0) + 1e-9
    kinds, count = len(place), features.shape[1]
    shares, means = np.zeros((kinds, components)), np.zeros((kinds, components, count))
    whitening = np.zeros((kinds, count, count))
    for k in range(kinds):
        of_class = features[targets == k] if np.count_nonzero(targets == k) > count else features
        fitted = _mixture((of_class - mean) / scale, min(components, 1 + len(of_class) // TRACKS_A_COMPONENT), seed)
        number = len(fitted.weights_)
        shares[k, :number], means[k, :number] = fitted.weights_, fitted.means_ * scale + mean
        whitening[k] = fitted.precisions_cholesky_ / scale[:, None]
    frequency = np.bincount(targets, minlength=kinds) + 1.0
    return ClassModel(shares, means, whitening, frequency / frequency.sum(), np.array([1.0, 0.0]), place)


def _mixture(features: NDArray[np.float64], components: int, seed: int) -> GaussianMixture:
    mixture = GaussianMixture(components, covariance_type="tied", reg_covar=SHRINKAGE, random_state=seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        return mixture.fit(features)


def log_loss(posteriors: NDArray[np.float64], cells: NDArray[np.int64]) -> float:
    """Mean over labelled cells of -log P(class), nats, clipped as the referee does; both (N, K)."""
    return float(-(cells * np.log(np.clip(posteriors, 0.001, 0.999))).sum() / cells.sum())


def _results(
    stretch: LabelledStretch, learned: Tracked, classes: Sequence[str], model: ClassModel, loss: float, out: FitOutput
) -> dict[str, Any]:
    """What the card says of the classes; their command is not that of the motion where it was tuned before."""
    targets = learned.cells.argmax(axis=1)[learned.cells.any(axis=1)]
    tracks = [len(np.unique(learned.track[learned.cells[:, k] > 0])) for k in range(len(classes))]
    return {
        "command": out.command,
        "seed": out.seed,
        "labelled": stretch.name,
        "features": list(FEATURES),
        "tracks": dict(zip(classes, tracks, strict=True)),
        "frames_of_tracks": dict(zip(classes, np.bincount(targets, minlength=len(classes)).tolist(), strict=True)),
        "gaussians": dict(zip(classes, np.count_nonzero(model.mixture_weights, axis=1).tolist(), strict=True)),
        "life_power": float(model.powers[0]),
        "place_power": float(model.powers[1]),
        "validation_log_loss": round(loss, 5),
    }
