"""Training: background and life table are counted, settings searched, probabilities calibrated; then classes."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Sequence
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
from gridtrack.trackers.contract import FitTask, FrameSource, stream_of
from gridtrack.trackers.model_free.background import OUTSIDE_MAP, fit_background, general_background
from gridtrack.trackers.model_free.classes import ARRAY_PREFIX, FEATURES, ClassModel, features_of
from gridtrack.trackers.model_free.residence import (
    OpenCells,
    OpenSoFar,
    fit_residence,
    general_residence,
    table_shape,
)
from gridtrack.trackers.model_free.settings import ModelFreeSettings, PipelineSettings
from gridtrack.trackers.registry import registered_name
from gridtrack.trackers.site_map import NO_MAP, SiteMap
from gridtrack.trackers.training.card import with_classes
from gridtrack.trackers.training.labelled_scans import LabelledScans, LabelSettings, class_indices, draw_labelled
from gridtrack.trackers.training.searched_fit import SettingsSearch, fit_searched
from gridtrack.trackers.training.weights import load_weights, save_weights

if TYPE_CHECKING:
    from gridtrack.trackers.model_free.tracker import ModelFreeTracker


SETTING_RANGES = {
    "untracked_share": (0.02, 1.0),
    "rate_recovery_s": (0.3, 10.0),
    "static_above": (0.1, 0.8),
    "adaptation_s": (0.5, 10.0),
    "map_weight_s": (0.2, 5.0),
    "link_m": (0.15, 1.2),
    "acceleration": (0.02, 1.0),
    "speed_noise": (0.01, 0.3),
    "turn_acceleration": (0.01, 0.5),
    "manoeuvre_noise": (2.0, 40.0),
    "steady_duration_s": (1.0, 30.0),
    "manoeuvre_duration_s": (0.3, 5.0),
    "velocity_memory_s": (0.5, 50.0),
    "initial_speed": (0.5, 8.0),
    "initial_turn_rate": (0.02, 1.0),
    "surface_noise_m": (0.05, 0.25),
    "position_noise_m": (0.02, 0.3),
    "reach_m": (0.2, 1.5),
    "initiation_probability": (0.1, 0.8),
    "detection_probability": (0.5, 0.98),
    "clutter_probability": (0.02, 0.5),
    "mean_lifetime_s": (2.0, 60.0),
    "shape_memory_s": (0.2, 4.0),
    "residence_speed": (0.2, 20.0),
    "return_noise_m": (0.02, 0.2),
}
"""Ranges of the tuned settings, searched log-uniformly."""
PIPELINE_OF_PLACE = frozenset({"untracked_share", "rate_recovery_s", "static_above", "adaptation_s", "map_weight_s"})
"""Settings that weigh the map of the place against the stream: the settings of the background."""
WITHOUT_MAP = {"background": "none"}
"""The setting of a pipeline that learns its background from the stream."""
COMPONENTS = (1, 2, 4, 8)
LIFE_POWERS = (0.1, 0.15, 0.25, 0.35, 0.5, 0.7, 1.0)
PRIOR_POWERS = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Candidates, chosen on the validation stretch: see ClassModel."""
SHRINKAGE = 0.05
"""Added to the variances of the features, which are scaled to variance 1."""
SAMPLES_PER_COMPONENT = 40
"""Minimum number of samples (frames of tracks) of a class for each further Gaussian."""
SMOOTHING_M, SMOOTHED_WEIGHT, GLOBAL_WEIGHT = 1.6, 1.0, 10.0
"""The prior of a cell: its own returns, plus its surroundings (a Gaussian of deviation SMOOTHING_M) with the weight of
SMOOTHED_WEIGHT returns. The surroundings include all returns of the site with the weight of GLOBAL_WEIGHT returns."""


def fit_pipeline(tracker: type[ModelFreeTracker], task: FitTask) -> None:
    """Write the counted arrays, and the searched settings, to `task.out`.

    Raises WeightsError if the recordings differ in grid, period or site.
    """
    train, options = task.train, task.options
    given = options.model_dump(include=set(PipelineSettings.model_fields), exclude_unset=True)
    notes = {"classes": _without_classes(task)}
    arrays = general_arrays(train, options) if task.general else fit_arrays(train, options, task.report)
    search = SettingsSearch(
        tracker,
        PipelineSettings,
        SETTING_RANGES,
        PIPELINE_OF_PLACE,
        without_map=WITHOUT_MAP if (arrays["neighbourhood_rate"] < OUTSIDE_MAP).any() else {},
    )
    fit_searched(search, arrays, task, given, notes)


def _without_classes(task: FitTask) -> str:
    """The entry for classes in the card of a training without them."""
    if task.general:
        return "none: classes are learned at a site"
    if any(source.classes for source in task.train):
        return "none yet: add them with stage=classes"
    return f"none: {', '.join(source.name for source in task.train)} has no labels"


def general_arrays(train: Sequence[FrameSource], options: PipelineSettings) -> dict[str, NDArray[np.float32]]:
    """The counted arrays for any place: the mean rate, and a life table of any period."""
    residence = general_residence(train, 1.0 - options.explained_above)
    return {**general_background(train)._asdict(), "residence": residence}


def fit_arrays(
    train: Sequence[FrameSource], options: PipelineSettings, report: Callable[[str], None]
) -> dict[str, NDArray[np.float32]]:
    """The counted arrays: the background map, and the life table of the returns in open cells."""
    grid, period_s = train[0].grid, train[0].period_s
    background, moves = fit_background(train, grid.cell_m)
    if moves:
        report(NO_MAP)
    on_map = SiteMap(background.neighbourhood_rate < options.explained_above, True, grid.cell_m)

    def open_cells() -> OpenCells:
        return (
            OpenSoFar(grid, period_s, 1.0 - options.explained_above)
            if moves
            else lambda frame: on_map.at(frame.world_T_grid)
        )

    residence = fit_residence(train, open_cells, table_shape(period_s), grid.cell_m)
    return {**background._asdict(), "residence": residence}


class TrackSamples(NamedTuple):
    """Tracks in labelled frames: one row for each track and frame, ordered by track and then by time.

    `features` (N, F), `track` (N,) its number, `cells` (N, K) the number of labelled cells of each class among its
    returns, `returns` the cells (R,), row * M + column, of its newest returns.
    """

    features: NDArray[np.float64]
    track: NDArray[np.int64]
    cells: NDArray[np.int64]
    returns: list[NDArray[np.int64]]

    def mean_over_life(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """The mean (N, K) of values (N, K) over the rows of the same track up to each row."""
        sums = np.cumsum(values, axis=0)
        first = np.searchsorted(self.track, self.track)
        before = np.where(first[:, None] > 0, sums[first - 1], 0.0)
        return np.asarray((sums - before) / (np.arange(len(values)) - first + 1)[:, None])


def draw_scans(task: FitTask) -> LabelledScans | None:
    """The labelled scans of the training; None for general weights, and if no classes are requested or available.

    Raises ConfigurationError if too few scans are labelled or classes are requested for any place, WeightsError
    if there are no weights to add classes to.
    """
    train, options = task.train, task.options
    if task.general:
        if options.stage == "classes":
            raise ConfigurationError("classes are learned at a site: leave --general out")
        return None
    if options.stage == "classes" and not task.out.exists():
        raise WeightsError(f"{task.out}: no weights to add classes to: train with stage=both, or put them there")
    if options.stage == "occupancy" or (options.stage == "both" and not any(source.classes for source in train)):
        return None
    return draw_labelled(train, options, task.seed)


def fit_classes(kind: type[ModelFreeTracker], labelled: LabelledScans, task: FitTask) -> None:
    """Train classes on the `labelled` scans and add them to the weights at `task.out`.

    Raises ConfigurationError if `task.validation` has no labels.
    """
    classes, source = labelled.classes, task.train[0]
    task.report(f"classes {', '.join(classes)} from {labelled.name}")

    weights = load_weights(stream_of(source, task.out), registered_name(kind))
    bare = {name: value for name, value in weights.arrays.items() if not name.startswith(ARRAY_PREFIX)}
    with TemporaryDirectory() as folder:
        draft = Path(folder) / task.out.name
        save_weights(draft, weights.card.model_copy(update={"classes": ()}), bare)
        tracker = kind(stream_of(source, draft), ModelFreeSettings())
    training = track_samples(tracker, labelled.runs(), classes)
    held_out = track_samples(tracker, ((source, source.labelled()) for source in task.validation), classes)
    if not held_out.cells.any():
        names_of = ", ".join(source.name for source in task.validation)
        raise ConfigurationError(f"{names_of}: no track there has a label: give a --validation with labels")
    cell_prior = cell_prior_of(count_labelled_cells(labelled, classes), source.grid.cell_m)
    model, loss = best_model(training, held_out, cell_prior, task)

    results = _results(labelled, training, classes, model, loss, task)
    settings = task.options.model_dump(include=set(LabelSettings.model_fields)) | {"labelled_scans": labelled.count}
    card = with_classes(weights.card, classes, task, settings, results)
    save_weights(task.out, card, bare | model.arrays())


def track_samples(
    tracker: ModelFreeTracker,
    labelled: Iterable[tuple[FrameSource, Iterable[LabelledFrame]]],
    classes: Sequence[str],
) -> TrackSamples:
    """Samples of the tracks in labelled streams, each from its first frame; labels index the names of the stream."""
    grid, rows = tracker.stream.grid, []
    for stretch, (source, frames) in enumerate(labelled):
        tracker.reset(0)
        for item in frames:
            tracker.update(item.frame)
            class_at = np.full(grid.size**2, len(classes))
            target = class_indices(item.labels, source.classes, classes)
            class_at[item.cells[target >= 0]] = target[target >= 0]
            seen = [track for track in tracker.tracks if not track.unseen]
            for track, features in zip(
                seen, features_of(seen, item.frame, tracker.window) if seen else (), strict=True
            ):
                cells, inside = tracker.window.fixed_grid.cells_of(track.returns)
                returns = cells[inside, 0] * grid.size + cells[inside, 1]
                count = np.bincount(class_at[returns], minlength=len(classes) + 1)[:-1]
                rows.append(((stretch, track.identity), features, count, returns))
    rows.sort(key=lambda row: row[0])
    identities = np.array([row[0] for row in rows]).reshape(-1, 2)
    return TrackSamples(
        np.array([row[1] for row in rows]).reshape(-1, len(FEATURES)),
        np.unique(identities, axis=0, return_inverse=True)[1].reshape(-1),
        np.array([row[2] for row in rows], np.int64).reshape(-1, len(classes)),
        [row[3] for row in rows],
    )


def count_labelled_cells(labelled: LabelledScans, classes: Sequence[str]) -> NDArray[np.float64]:
    """Number of labels of each class in each cell (K, M, M); the mean of all cells if the windows differ."""
    size = labelled.sources[0].grid.size
    count, windows = np.zeros((len(classes), size**2)), set()
    for source, frames in labelled.scans():
        for item in frames:
            windows.add(item.frame.world_T_grid)
            np.add.at(count, (class_indices(item.labels, source.classes, classes), item.cells), 1.0)
    if len(windows) > 1:
        count[:] = count.mean(axis=1, keepdims=True)
    return count.reshape(-1, size, size)


def cell_prior_of(count: NDArray[np.float64], cell_m: float) -> NDArray[np.float64]:
    """P(class) of a return in each cell (K, M, M) from counts (K, M, M), smoothed: see SMOOTHING_M; all positive."""
    sigma = SMOOTHING_M / cell_m
    smooth = np.stack([gaussian_filter(each, sigma, mode="constant") for each in count]) * 2.0 * np.pi * sigma**2
    smooth += GLOBAL_WEIGHT * (count.sum(axis=(1, 2)) / count.sum())[:, None, None]
    smoothed = count + SMOOTHED_WEIGHT * smooth / smooth.sum(axis=0)
    return np.asarray(smoothed / smoothed.sum(axis=0))


def best_model(
    training: TrackSamples, held_out: TrackSamples, cell_prior: NDArray[np.float64], task: FitTask
) -> tuple[ClassModel, float]:
    """The model, over COMPONENTS and powers, with the least log loss of `held_out` cells; that loss, nats a cell."""
    flat = cell_prior.reshape(len(cell_prior), -1)
    log_prior = np.log(np.stack([flat[:, returns].mean(axis=1) for returns in held_out.returns]))
    best: tuple[ClassModel, float] | None = None
    for components in COMPONENTS:
        model = fit_mixtures(training, cell_prior, components, task.seed)
        evidence = held_out.mean_over_life(model.log_densities(held_out.features))
        tried = [
            (candidate, cell_log_loss(candidate.posteriors(evidence, log_prior), held_out.cells))
            for powers in product(LIFE_POWERS, PRIOR_POWERS)
            for candidate in [model._replace(powers=np.array(powers))]
        ]
        chosen = min(tried, key=lambda one: one[1])
        task.report(
            f"at most {components} Gaussians of a class: validation log loss {chosen[1]:.4f} nats a cell, powers"
            f" {chosen[0].powers.tolist()}"
        )
        best = chosen if best is None or chosen[1] < best[1] else best
    assert best is not None
    return best


def fit_mixtures(training: TrackSamples, cell_prior: NDArray[np.float64], components: int, seed: int) -> ClassModel:
    """Mixture discriminant analysis (Hastie and Tibshirani, 1996): Gaussians with one covariance for each class.

    The class of a sample is the class of most of its cells. A class without samples has the distribution of all
    samples. `best_model` chooses the powers.
    """
    known = training.cells.any(axis=1)
    features, targets = training.features[known], training.cells[known].argmax(axis=1)
    mean, scale = features.mean(axis=0), features.std(axis=0) + 1e-9
    classes, count = len(cell_prior), features.shape[1]
    shares, means = np.zeros((classes, components)), np.zeros((classes, components, count))
    whitening = np.zeros((classes, count, count))
    for k in range(classes):
        of_class = features[targets == k] if np.count_nonzero(targets == k) > count else features
        fitted = _mixture((of_class - mean) / scale, min(components, 1 + len(of_class) // SAMPLES_PER_COMPONENT), seed)
        number = len(fitted.weights_)
        shares[k, :number], means[k, :number] = fitted.weights_, fitted.means_ * scale + mean
        whitening[k] = fitted.precisions_cholesky_ / scale[:, None]
    frequency = np.bincount(targets, minlength=classes) + 1.0
    return ClassModel(shares, means, whitening, frequency / frequency.sum(), np.array([1.0, 0.0]), cell_prior)


def _mixture(features: NDArray[np.float64], components: int, seed: int) -> GaussianMixture:
    mixture = GaussianMixture(components, covariance_type="tied", reg_covar=SHRINKAGE, random_state=seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        return mixture.fit(features)


def cell_log_loss(posteriors: NDArray[np.float64], cells: NDArray[np.int64]) -> float:
    """Mean over labelled cells of -log P(class), nats, clipped as in the scores; both arguments (N, K)."""
    return float(-(cells * np.log(np.clip(posteriors, 0.001, 0.999))).sum() / cells.sum())


def _results(
    labelled: LabelledScans,
    training: TrackSamples,
    classes: Sequence[str],
    model: ClassModel,
    loss: float,
    task: FitTask,
) -> dict[str, Any]:
    """The results of the classes in the card, with their own command, as the settings may be from another training."""
    targets = training.cells.argmax(axis=1)[training.cells.any(axis=1)]
    tracks = [len(np.unique(training.track[training.cells[:, k] > 0])) for k in range(len(classes))]
    return {
        "command": task.command,
        "seed": task.seed,
        "labelled": labelled.name,
        "features": list(FEATURES),
        "tracks": dict(zip(classes, tracks, strict=True)),
        "frames_of_tracks": dict(zip(classes, np.bincount(targets, minlength=len(classes)).tolist(), strict=True)),
        "gaussians": dict(zip(classes, np.count_nonzero(model.mixture_weights, axis=1).tolist(), strict=True)),
        "life_power": float(model.powers[0]),
        "place_power": float(model.powers[1]),
        "validation_log_loss": round(loss, 5),
    }
