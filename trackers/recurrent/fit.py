"""Training of a network tracker, from recordings to its weights; it may start from a general network.

General weights have one bias for each channel. At a site each bias is a map of the place, the static memory, which
starts at the general bias in every cell. Before the first update both networks are therefore the same function. The
inputs for cell size and period stay. A general training that continues from general weights adds nothing.
"""

from __future__ import annotations

import logging
import math
import signal
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import deepcopy
from datetime import timedelta
from itertools import product
from pathlib import Path
from typing import Any

import lightning
import torch
from lightning.pytorch.callbacks import ModelCheckpoint
from lightning.pytorch.loggers import CSVLogger, TensorBoardLogger

from gridtrack.common.config import validated
from gridtrack.common.errors import WeightsError
from gridtrack.trackers.contract import FitTask, FrameSource, StretchScore, stream_of
from gridtrack.trackers.recurrent.devices import Devices, training_precision
from gridtrack.trackers.recurrent.network import Network
from gridtrack.trackers.recurrent.network_tracker import NetworkTracker
from gridtrack.trackers.recurrent.sequences import SequenceDataset
from gridtrack.trackers.recurrent.settings import TrainingSettings, TransferSettings
from gridtrack.trackers.recurrent.training_module import TrainingModule, scores_text
from gridtrack.trackers.registry import registered_name
from gridtrack.trackers.training.card import card_for
from gridtrack.trackers.training.checkpoints import is_resumed
from gridtrack.trackers.training.excerpts import (
    SELECTION_HORIZONS_S,
    SELECTION_STRATA,
    VALIDATED_S,
    excerpts_of_places,
    mean_of_defined,
    selection_scores,
    step_of,
)
from gridtrack.trackers.training.weights import Weights, array, load_start, save_interrupted, save_weights

FROM_GENERAL = {"updates": 600, "validate_every": 150, "warm_up": 50, "learning_rate": 1e-3}
"""Settings of a training that starts from general weights: minutes on a processor, at a learning rate at which the
network does not forget."""
AT_MOST = {"batch": 2, "burn_in": 20}
"""Upper limits of the settings that it takes from the general weights: batches for an accelerator are too slow on a
processor, and a longer burn-in takes twice as long and gains nothing at a site."""
FIRST_MOTION = frozenset({"shape_updates", "shape_share", "motion_weight"})
"""Settings for learning motion from nothing; a training from general weights does not have them."""
STORED_AS = torch.float16
"""Precision of the arrays in the file: half the size, and no score changes in its third digit."""
FOR_ANY_PLACE = {"resolution_input": True, "step_s": 0.1}
"""Settings of a general network, unless others are given."""


def fit_network(kind: type[NetworkTracker], task: FitTask) -> None:
    """Train the network of a tracker and write its weights; see NetworkTracker.fit."""
    name = registered_name(kind)
    start = None if task.start is None else load_start(task.start, name)
    options = task.options if start is None else settings_from_general(kind, task.options, start)
    if task.general:
        not_given = FOR_ANY_PLACE.keys() - options.model_fields_set
        options = options.model_copy(update={name: FOR_ANY_PLACE[name] for name in not_given})
    devices = Devices.of(task.device, options.devices, options.batch)
    dataset = SequenceDataset(task.train, options, task.seed, step_s=options.step_s, general=task.general)
    if task.general or not dataset.has_one_window:
        why = "general weights know no place" if task.general else "the windows of the training frames differ"
        options = kind.without_map(options, why, task)
    options = options.model_copy(update={"precision": training_precision(options, devices, task)})
    torch.manual_seed(task.seed)
    network = kind.build(dataset.size, options, classes=0)
    start_from_rate(network, dataset.occupied_rate)
    in_training = kind.prepare_training(network, devices.kind)
    if start is not None:
        begin_from(network, start)
    held_out = excerpts_of_places(task.validation, VALIDATED_S) if task.general else task.validation

    def validate(trained: Network) -> dict[str, float]:
        def score_on(source: FrameSource) -> StretchScore:
            stream, steps = stream_of(source), step_of(source, max(SELECTION_HORIZONS_S))
            inference = kind.inference_for(as_stored(trained), stream, options)
            return task.objective(kind(stream, options, inference, dataset.first_window), source, steps)

        return validation_scores(score_on, held_out)

    module = TrainingModule(network, in_training, dataset, options, devices, validate)
    others = {*TransferSettings.model_fields, *kind.running.model_fields}
    scores, reached = train_network(module, task, options.model_dump(exclude=others), start)
    arrays = {name: value.contiguous().numpy() for name, value in network.to(STORED_AS).state_dict().items()}
    settings = options.model_dump(mode="json", exclude=set(kind.running.model_fields))
    card = card_for(name, task, settings, scores)
    if reached:
        save_interrupted(task.out, card, arrays, reached)
        raise KeyboardInterrupt
    save_weights(task.out, card, arrays)


def as_stored(network: Network) -> Network:
    """A copy on the processor, as precise as in the file: the network that a user will run."""
    return deepcopy(network).cpu().to(STORED_AS).float()


@torch.no_grad()
def start_from_rate(network: Network, rate: float) -> None:
    """Set the output bias so that an untrained network forecasts the occupied `rate` in (0, 1), not one half.

    About 2 % of the visible cells are occupied; the first updates of training need not learn that number.
    """
    network.output_bias.fill_(math.log(rate / (1.0 - rate)))


def settings_from_general(kind: type[NetworkTracker], options: Any, weights: Weights) -> Any:
    """The `options`, with the settings of the general `weights` for options that were not given.

    Raises WeightsError if a given option is another shape than theirs.
    """
    fields = kind.Options.model_fields.keys() - TransferSettings.model_fields.keys()
    shared = fields - {"precision", "devices", *kind.map_options, *FIRST_MOTION, *kind.running.model_fields}
    theirs = {name: value for name, value in weights.card.settings.items() if name in shared}
    trained = validated(kind.Options, theirs, f"weights of {weights.card.tracker}, settings")
    for name in sorted(options.model_fields_set & shared - TrainingSettings.model_fields.keys()):
        if getattr(options, name) != getattr(trained, name):
            raise WeightsError(
                f"the general weights have {name}={getattr(trained, name)}, not {getattr(options, name)}: leave the"
                " option out, or train with --from-scratch"
            )
    shorter = FROM_GENERAL | {name: min(getattr(trained, name), most) for name, most in AT_MOST.items()}
    return validated(kind.Options, theirs | shorter | options.model_dump(exclude_unset=True), "training")


def begin_from(network: Network, weights: Weights) -> None:
    """Load the arrays of the general `weights` into `network`, at a site each bias in every cell of its map.

    Their class decoder is left out. Raises WeightsError if an array is missing or has another shape.
    """
    maps = network.maps()
    for name, value in network.state_dict().items():
        shape = (value.shape[0], 1, 1) if name in maps else tuple(value.shape)
        value.copy_(torch.from_numpy(array(weights, name, shape)))


def validation_scores(score: Callable[[FrameSource], StretchScore], sources: Sequence[FrameSource]) -> dict[str, float]:
    """The selection scores, each the mean over the stretches; `score` is the mean of the defined ones.

    `log_loss` is the mean over the same cells, nats. A stretch without motion has no F1 of dynamic cells, and does not
    count there.
    """
    found: dict[str, list[float]] = {}
    losses: list[float] = []
    for source in sources:
        scores = score(source)
        for name, value in selection_scores(scores, source).items():
            found.setdefault(name, []).append(value)
        for stratum, horizon_s in product(SELECTION_STRATA, SELECTION_HORIZONS_S):
            losses.append(float(scores.log_loss[stratum][step_of(source, horizon_s)]))
    results = {name: mean_of_defined(values) for name, values in found.items()}
    return {"score": mean_of_defined(list(results.values())), "log_loss": mean_of_defined(losses), **results}


BEST, LAST = "best", "last"
"""Names of the checkpoints with the best validation score, and of the last one."""
CHECKPOINT_EVERY_S = 60.0
"""Time between two checkpoints; there is one after every validation too."""
NEAR_TIE = 0.002
"""Smaller differences of the selection score count as zero: trainings with other seeds differ by as much."""
IGNORED_WARNINGS = (
    "You're resuming from a checkpoint that ended before the epoch ended",  # the next window is an unused one
    ".*does not have many workers",  # see Devices.loading_processes
    "The `srun` command is available",
    "Checkpoint directory .* exists and is not empty",
    ".*isinstance.treespec, LeafSpec",
    "It is recommended to use `self.log",  # on several devices: each has the scores of the first one
)
"""Warnings of Lightning, as patterns, that are of no use to the user of a training."""


def train_network(
    module: TrainingModule, task: FitTask, settings: Mapping[str, Any], start: Weights | None = None
) -> tuple[dict[str, float], str]:
    """Train the network of `module` in place to the weights with the best validation score; a `start` is a candidate
    too. `settings`: those that the training depends on. Returns the scores of these weights, and the progress that the
    training reached when it was interrupted, or "".

    Logs (CSV, TensorBoard) and checkpoints are written to `task.log_dir`; checkpoints of the same training in it are
    resumed. An interrupt ends the training at the best weights so far. Raises ConfigurationError if the folder has
    checkpoints of another training, and KeyboardInterrupt if it is interrupted before the first validation.
    """
    for name in ("lightning.pytorch", "lightning.fabric"):  # they print advertisements
        logging.getLogger(name).setLevel(logging.WARNING)
    network = module.network
    last = _checkpoint_in(task, LAST)
    resumed = last if is_resumed(task, last, settings) else None
    module.done = _updates_in(resumed) if resumed else 0
    initial, initial_scores = deepcopy(network.state_dict()), {}
    if start is not None:
        initial_scores = module.validate(network)
        task.report(f"general weights  {scores_text(initial_scores)}")
    interrupted = _train(module, resumed, task)
    best = torch.load(_checkpoint_in(task, BEST), weights_only=True, map_location="cpu")
    module.load_state_dict(best["state_dict"])
    scores = dict(best["scores"])
    if start is not None and not _improves(scores, initial_scores):
        task.report("no update is better on the validation than the general weights: they are kept")
        network.load_state_dict(initial)
        scores = initial_scores
    reached = f"update {_updates_in(_checkpoint_in(task, LAST))} of {module.settings.updates}" if interrupted else ""
    return scores, reached


def _train(module: TrainingModule, resumed: Path | None, task: FitTask) -> bool:
    """Train from the checkpoint `resumed`, or from the start; returns whether it was interrupted.

    Raises KeyboardInterrupt if that was before the first validation.
    """
    devices, updates = module.devices, module.settings.updates
    with _without_warnings():
        trainer = _trainer(module.settings, devices, task)
    on_interrupt = signal.getsignal(signal.SIGINT)
    try:
        with (
            task.progress.stage("update", updates, module.done) as stage,
            devices.called_here(stage.advance, task.report) as (module.advance, module.report),
            _without_warnings(),
        ):
            trainer.fit(module, ckpt_path=str(resumed) if resumed else None, weights_only=True)
    except (KeyboardInterrupt, SystemExit):  # Lightning exits after an interrupt, and ignores further ones
        signal.signal(signal.SIGINT, on_interrupt)
        devices.end_processes()
        if not trainer.interrupted or not _checkpoint_in(task, BEST).is_file():
            raise KeyboardInterrupt from None
    return trainer.interrupted


@contextmanager
def _without_warnings() -> Iterator[None]:
    with warnings.catch_warnings():
        for pattern in IGNORED_WARNINGS:
            warnings.filterwarnings("ignore", pattern)
        yield


def _improves(scores: dict[str, float], before: dict[str, float]) -> bool:
    """Whether the `scores` are better: by the selection score, or by log loss where that is nearly the same."""
    gain = scores["score"] - before["score"]
    return gain > 0 if abs(gain) > NEAR_TIE else scores["log_loss"] < before["log_loss"]


def _trainer(settings: TrainingSettings, devices: Devices, task: FitTask) -> lightning.Trainer:
    """A trainer with its checkpoints, BEST and LAST, and logs in `task.log_dir`."""
    assert settings.precision != "auto"
    folder = task.log_dir / "checkpoints"
    best = ModelCheckpoint(folder, filename=BEST, monitor="score", mode="max", enable_version_counter=False)
    # after every epoch, at any score
    last = ModelCheckpoint(folder, filename=LAST, enable_version_counter=False)
    timed = ModelCheckpoint(
        folder,
        filename=LAST,
        train_time_interval=timedelta(seconds=CHECKPOINT_EVERY_S),
        save_on_train_epoch_end=False,
        enable_version_counter=False,
    )
    return lightning.Trainer(
        **devices.lightning,
        use_distributed_sampler=False,  # EpochSampler is one
        max_epochs=math.ceil(settings.updates / settings.validate_every),
        precision=settings.precision,
        gradient_clip_val=settings.gradient_clip,
        callbacks=[best, last, timed],
        logger=[CSVLogger(task.log_dir, name="csv"), TensorBoardLogger(task.log_dir, name="tensorboard")],
        log_every_n_steps=min(10, settings.validate_every, settings.updates),
        enable_progress_bar=False,
        enable_model_summary=False,
    )


def _checkpoint_in(task: FitTask, which: str) -> Path:
    """The checkpoint BEST or LAST of a training."""
    return task.log_dir / "checkpoints" / f"{which}.ckpt"


def _updates_in(checkpoint: Path) -> int:
    """The number of updates at a checkpoint."""
    return int(torch.load(checkpoint, weights_only=True, map_location="cpu")["global_step"])
