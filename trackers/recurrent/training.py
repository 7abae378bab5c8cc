"""Unsupervised training of the recurrent networks with Lightning (Ondruska et al., 2016, section III).

The network observes some frames of a sequence and predicts the others from empty input; the loss is the binary
cross-entropy of every frame on its visible cells.
"""

from __future__ import annotations

import json
import logging
import math
import signal
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from copy import deepcopy
from datetime import timedelta
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple, Self

import lightning
import torch
from lightning.pytorch.callbacks import ModelCheckpoint
from lightning.pytorch.loggers import CSVLogger, TensorBoardLogger
from torch import Tensor, nn

from gridtrack.common.errors import ConfigurationError
from gridtrack.common.files import write_text
from gridtrack.common.grid import nearest_step
from gridtrack.trackers.contract import FitOutput, FrameSource, StretchScore
from gridtrack.trackers.excerpts import SELECTION_STRATA, mean_of_defined
from gridtrack.trackers.recurrent.devices import ONE_DEVICE, SEVERAL_DEVICES, called_here, check_devices, end_devices
from gridtrack.trackers.recurrent.network import RecurrentNetwork
from gridtrack.trackers.recurrent.precision import training_precision
from gridtrack.trackers.recurrent.sequences import SequenceDataset
from gridtrack.trackers.recurrent.settings import InferenceSettings, TrainingSettings, TransferSettings
from gridtrack.trackers.recurrent.training_module import TrainingModule, Validate, scores_text
from gridtrack.trackers.weights import Weights

BEST, LAST = "best", "last"
"""Names of the checkpoints with the best validation score, and of the last one."""
CHECKPOINT_EVERY_S = 60.0
"""Time between two checkpoints; there is one after every validation too."""
NEAR_TIE = 0.002
"""Differences of validation F1 up to this say nothing: trainings with other seeds differ by as much."""
NO_NEWS = (
    "You're resuming from a checkpoint that ended before the epoch ended",  # the next window is an unused one
    ".*does not have many workers",  # on a processor: see drawing_processes
    "The `srun` command is available",
    "Checkpoint directory .* exists and is not empty",
    ".*isinstance.treespec, LeafSpec",
    "It is recommended to use `self.log",  # on several devices: each has the scores of the first one
)
"""Warnings of Lightning, as patterns, that tell the user of a training nothing."""


class TrainedNetwork(NamedTuple):
    """The `scores` of the best weights; how far an interrupted training had `reached`, "" for one that finished."""

    scores: dict[str, float]
    reached: str


def train_network(
    network: nn.Module,
    in_training: RecurrentNetwork,
    dataset: SequenceDataset,
    settings: TrainingSettings,
    validate: Validate,
    out: FitOutput,
    start: Weights | None = None,
) -> TrainedNetwork:
    """Train `network` in place to the weights with the best validation score; those it begins with, of a `start`, too.

    The training computes with `in_training`, the same function of the same parameters. Logs (CSV,
    TensorBoard) and checkpoints are written to `out.log_dir`; checkpoints of the same training in it are resumed. An
    interrupt ends the training at the best weights so far. Raises ConfigurationError where the folder has checkpoints
    of another training or the devices are too few, and KeyboardInterrupt where it is interrupted before the first
    validation.
    """
    check_devices(settings.devices, settings.batch)
    for name in ("lightning.pytorch", "lightning.fabric"):  # they print advertisements
        logging.getLogger(name).setLevel(logging.WARNING)
    network_settings = settings.model_dump(exclude={*TransferSettings.model_fields, *InferenceSettings.model_fields})
    training = {"seed": out.seed, "train": dataset.sources, **network_settings}
    resumed = _resumable(out, training if start is None else {"start": start.card.arrays_sha256, **training})
    begun = None if start is None else _Begun.with_scores(network, validate, out)
    done = _updates_in(resumed) if resumed else 0
    module = TrainingModule(network, in_training, dataset, settings, validate, done)
    with _without_news():
        trainer = _trainer(settings, out)
    best = _checkpoint_in(out, BEST)
    on_interrupt = signal.getsignal(signal.SIGINT)
    try:
        with (
            out.progress.stage("update", settings.updates, done) as stage,
            called_here(settings.devices, stage.advance, out.report) as (module.advance, module.report),
            _without_news(),
        ):
            trainer.fit(module, ckpt_path=str(resumed) if resumed else None, weights_only=True)
    except (KeyboardInterrupt, SystemExit):  # Lightning exits after an interrupt, and ignores further ones
        signal.signal(signal.SIGINT, on_interrupt)
        end_devices(settings.devices)
        if not trainer.interrupted or not best.is_file():
            raise KeyboardInterrupt from None
    kept = torch.load(best, weights_only=True, map_location="cpu")
    module.load_state_dict(kept["state_dict"])
    scores = dict(kept["scores"])
    if begun is not None and not _improves(scores, begun.scores):
        scores = begun.kept_in(network, out)
    reached = f"update {_updates_in(_checkpoint_in(out, LAST))} of {settings.updates}" if trainer.interrupted else ""
    return TrainedNetwork(scores, reached)


@contextmanager
def _without_news() -> Iterator[None]:
    with warnings.catch_warnings():
        for pattern in NO_NEWS:
            warnings.filterwarnings("ignore", pattern)
        yield


class _Begun(NamedTuple):
    """A network from general weights before its first update, and its `scores`."""

    state: dict[str, Tensor]
    scores: dict[str, float]

    @classmethod
    def with_scores(cls, network: nn.Module, validate: Validate, out: FitOutput) -> Self:
        """The `network` as it is now."""
        begun = cls(deepcopy(network.state_dict()), validate(network))
        out.report(f"general weights  {scores_text(begun.scores)}")
        return begun

    def kept_in(self, network: nn.Module, out: FitOutput) -> dict[str, float]:
        """Load the network of the beginning into `network`; returns its scores."""
        out.report("no update is better on the validation than the general weights: they are kept")
        network.load_state_dict(self.state)
        return self.scores


def _improves(scores: dict[str, float], before: dict[str, float]) -> bool:
    """Whether the `scores` are better than those `before`: by F1, and by log loss where that is nearly the same."""
    gain = scores["score"] - before["score"]
    return gain > 0 if abs(gain) > NEAR_TIE else scores["log_loss"] < before["log_loss"]


def _checkpoint_in(out: FitOutput, which: str) -> Path:
    """The checkpoint BEST or LAST of a training."""
    return out.log_dir / "checkpoints" / f"{which}.ckpt"


def _trainer(settings: TrainingSettings, out: FitOutput) -> lightning.Trainer:
    """A trainer with its checkpoints, BEST and LAST, and logs in `out.log_dir`."""
    folder = out.log_dir / "checkpoints"
    best = ModelCheckpoint(folder, filename=BEST, monitor="score", mode="max", enable_version_counter=False)
    # after every epoch, whatever the score
    last = ModelCheckpoint(folder, filename=LAST, enable_version_counter=False)
    timed = ModelCheckpoint(
        folder,
        filename=LAST,
        train_time_interval=timedelta(seconds=CHECKPOINT_EVERY_S),
        save_on_train_epoch_end=False,
        enable_version_counter=False,
    )
    return lightning.Trainer(
        devices=settings.devices,
        strategy=ONE_DEVICE if settings.devices == 1 else SEVERAL_DEVICES,
        use_distributed_sampler=False,  # EpochSampler is one
        max_epochs=math.ceil(settings.updates / settings.validate_every),
        precision=training_precision(settings, out),
        gradient_clip_val=settings.gradient_clip,
        callbacks=[best, last, timed],
        logger=[CSVLogger(out.log_dir, name="csv"), TensorBoardLogger(out.log_dir, name="tensorboard")],
        log_every_n_steps=min(10, settings.validate_every, settings.updates),
        enable_progress_bar=False,
        enable_model_summary=False,
    )


def _updates_in(checkpoint: Path) -> int:
    """The number of updates at a checkpoint."""
    return int(torch.load(checkpoint, weights_only=True, map_location="cpu")["global_step"])


def _resumable(out: FitOutput, training: dict[str, Any]) -> Path | None:
    """The last checkpoint of this `training`, None without one; records `training` in the log folder."""
    described = json.dumps(training, sort_keys=True)
    record, last = out.log_dir / "settings.json", _checkpoint_in(out, LAST)
    out.log_dir.mkdir(parents=True, exist_ok=True)
    if record.exists() and last.exists():
        if record.read_text() != described:
            raise ConfigurationError(
                f"{out.log_dir}: checkpoints of a training with other settings, data or seed: delete the folder to"
                " train from the start"
            )
        return last
    write_text(record, described)
    return None


def validation_scores(
    score: Callable[[FrameSource], StretchScore], sources: Sequence[FrameSource], horizons_s: Sequence[float]
) -> dict[str, float]:
    """F1 of SELECTION_STRATA at the horizons, mean over the stretches; `score` is the mean of those that are defined.

    `log_loss` is that of the same cells, nats. A stretch in which nothing moves has no F1 of dynamic cells: it does not
    count there.
    """
    found: dict[str, list[float]] = {}
    losses: list[float] = []
    for source in sources:
        scores = score(source)
        for stratum, horizon in product(SELECTION_STRATA, horizons_s):
            at = nearest_step(horizon, source.period_s)
            found.setdefault(f"{stratum}_f1_{horizon:g}s", []).append(float(scores.f1[stratum][at]))
            losses.append(float(scores.log_loss[stratum][at]))
    results = {name: mean_of_defined(values) for name, values in found.items()}
    return {"score": mean_of_defined(list(results.values())), "log_loss": mean_of_defined(losses), **results}
