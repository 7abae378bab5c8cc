"""A training of a recurrent network by Lightning: checkpoints, resumption, interrupts, and the best weights."""

from __future__ import annotations

import json
import logging
import math
import signal
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from copy import deepcopy
from datetime import timedelta
from pathlib import Path
from typing import Any, NamedTuple

import lightning
import torch
from lightning.pytorch.callbacks import ModelCheckpoint
from lightning.pytorch.loggers import CSVLogger, TensorBoardLogger

from gridtrack.common.errors import ConfigurationError
from gridtrack.common.files import write_text
from gridtrack.trackers.contract import FitTask
from gridtrack.trackers.recurrent.devices import Devices
from gridtrack.trackers.recurrent.network import Recurrence, RecurrentNetwork
from gridtrack.trackers.recurrent.sequences import SequenceDataset
from gridtrack.trackers.recurrent.settings import InferenceSettings, TrainingSettings, TransferSettings
from gridtrack.trackers.recurrent.training_module import TrainingModule, Validate, scores_text
from gridtrack.trackers.training.weights import Weights

BEST, LAST = "best", "last"
"""Names of the checkpoints with the best validation score, and of the last one."""
CHECKPOINT_EVERY_S = 60.0
"""Time between two checkpoints; there is one after every validation too."""
NEAR_TIE = 0.002
"""Smaller differences of validation F1 count as zero: trainings with other seeds differ by as much."""
IGNORED_WARNINGS = (
    "You're resuming from a checkpoint that ended before the epoch ended",  # the next window is an unused one
    ".*does not have many workers",  # see Devices.loading_processes
    "The `srun` command is available",
    "Checkpoint directory .* exists and is not empty",
    ".*isinstance.treespec, LeafSpec",
    "It is recommended to use `self.log",  # on several devices: each has the scores of the first one
)
"""Warnings of Lightning, as patterns, that are of no use to the user of a training."""


class TrainedNetwork(NamedTuple):
    """The `scores` of the best weights; the progress that a training `reached` when interrupted, or ""."""

    scores: dict[str, float]
    reached: str


def train_network(
    network: RecurrentNetwork,
    in_training: Recurrence,
    dataset: SequenceDataset,
    settings: TrainingSettings,
    devices: Devices,
    validate: Validate,
    task: FitTask,
    start: Weights | None = None,
) -> TrainedNetwork:
    """Train `network` in place to the weights with the best validation score; a `start` is a candidate too.

    The training computes with `in_training`, the same function of the same parameters. Logs (CSV, TensorBoard) and
    checkpoints are written to `task.log_dir`; checkpoints of the same training in it are resumed. An interrupt ends the
    training at the best weights so far. Raises ConfigurationError if the folder has checkpoints of another training,
    and KeyboardInterrupt if it is interrupted before the first validation.
    """
    for name in ("lightning.pytorch", "lightning.fabric"):  # they print advertisements
        logging.getLogger(name).setLevel(logging.WARNING)
    resumed = _resumable(task, _description(dataset, settings, task, start))
    done = _updates_in(resumed) if resumed else 0
    initial, initial_scores = deepcopy(network.state_dict()), {}
    if start is not None:
        initial_scores = validate(network)
        task.report(f"general weights  {scores_text(initial_scores)}")
    module = TrainingModule(network, in_training, dataset, settings, devices, validate, done)
    interrupted = _train(module, resumed, task)
    best = torch.load(_checkpoint_in(task, BEST), weights_only=True, map_location="cpu")
    module.load_state_dict(best["state_dict"])
    scores = dict(best["scores"])
    if start is not None and not _improves(scores, initial_scores):
        task.report("no update is better on the validation than the general weights: they are kept")
        network.load_state_dict(initial)
        scores = initial_scores
    reached = f"update {_updates_in(_checkpoint_in(task, LAST))} of {settings.updates}" if interrupted else ""
    return TrainedNetwork(scores, reached)


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
    """Whether the `scores` are better than those `before`: by F1, and by log loss if the F1 is nearly the same."""
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


def _description(
    dataset: SequenceDataset, settings: TrainingSettings, task: FitTask, start: Weights | None
) -> dict[str, Any]:
    """Everything that a training depends on: its data, seed and settings, and the weights that it starts from."""
    started = {} if start is None else {"start": start.card.arrays_sha256}
    used = settings.model_dump(exclude={*TransferSettings.model_fields, *InferenceSettings.model_fields})
    return {**started, "seed": task.seed, "train": dataset.sources, **used}


def _resumable(task: FitTask, training: dict[str, Any]) -> Path | None:
    """The last checkpoint of this `training`, None without one; records `training` in the log folder."""
    described = json.dumps(training, sort_keys=True)
    record, last = task.log_dir / "settings.json", _checkpoint_in(task, LAST)
    task.log_dir.mkdir(parents=True, exist_ok=True)
    if record.exists() and last.exists():
        if record.read_text() != described:
            raise ConfigurationError(
                f"{task.log_dir}: checkpoints of a training with other settings, data or seed: delete the folder to"
                " train from the start"
            )
        return last
    write_text(record, described)
    return None
