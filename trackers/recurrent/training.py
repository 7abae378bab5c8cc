"""Unsupervised training of the recurrent networks with Lightning (Ondruska et al., 2016, section III).

The network observes some frames of a sequence and predicts the others from empty input; the loss is the binary
cross-entropy of every frame on its visible cells.
"""

from __future__ import annotations

import json
import logging
import math
import os
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from copy import deepcopy
from datetime import timedelta
from pathlib import Path
from typing import Any, NamedTuple, Self

import lightning
import torch
from lightning.pytorch.callbacks import ModelCheckpoint
from lightning.pytorch.loggers import CSVLogger, TensorBoardLogger
from torch import Tensor, nn
from torch.utils.data import DataLoader

from gridtrack.common.errors import ConfigurationError
from gridtrack.common.files import write_text
from gridtrack.common.horizons import nearest_step
from gridtrack.trackers.contract import FitOutput, FrameSource
from gridtrack.trackers.excerpts import SELECTION_STRATA, mean_of_defined
from gridtrack.trackers.progress import Stage
from gridtrack.trackers.recurrent.accelerated_convgru import AcceleratedConvGRU
from gridtrack.trackers.recurrent.network import RecurrentNetwork, channels_last
from gridtrack.trackers.recurrent.precision import training_device, training_precision
from gridtrack.trackers.recurrent.resolution_input import set_resolution
from gridtrack.trackers.recurrent.sequence_loss import SequenceLoss, sequence_loss
from gridtrack.trackers.recurrent.sequences import EpochSampler, Item, SequenceDataset
from gridtrack.trackers.recurrent.settings import InferenceSettings, TrainingSettings, TransferSettings
from gridtrack.trackers.weights import Weights

CHECKPOINT_EVERY_S = 60.0
"""Time between two checkpoints; there is one after every validation too."""
NO_NEWS = (
    "You're resuming from a checkpoint that ended before the epoch ended",  # the next window is an unused one
    ".*does not have many workers",  # on a processor: see _workers
    "The `srun` command is available",
    "Checkpoint directory .* exists and is not empty",
    ".*isinstance.treespec, LeafSpec",
)
"""Warnings of Lightning, as patterns, that tell the user of a training nothing."""

Validate = Callable[[nn.Module], dict[str, float]]
"""Scores the network as a tracker on the validation stretch; the network with the highest `score` is kept."""


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
    of another training, KeyboardInterrupt where it is interrupted before the first validation.
    """
    logging.getLogger("lightning.pytorch").setLevel(logging.WARNING)  # it prints advertisements
    network_settings = settings.model_dump(exclude={*TransferSettings.model_fields, *InferenceSettings.model_fields})
    training = {"seed": out.seed, "train": dataset.sources, **network_settings}
    resumed = _resumable(out, training if start is None else {"start": start.card.arrays_sha256, **training})
    begun = None if start is None else _Begun.with_scores(network, validate, out)
    module = TrainingModule(network, in_training, settings, dataset.occupied_rate, validate, out)
    with _without_news():
        trainer, best = _trainer(settings, out)
    done = _updates_in(resumed) if resumed else 0
    batch = settings.batch
    sampler = EpochSampler(settings.validate_every * batch, settings.updates * batch, done * batch)
    loader = DataLoader(dataset, batch, sampler=sampler, num_workers=_workers())
    try:
        with out.progress.stage("update", settings.updates, done) as module.stage, _without_news():
            trainer.fit(module, loader, ckpt_path=str(resumed) if resumed else None, weights_only=True)
    except (KeyboardInterrupt, SystemExit):  # Lightning exits after an interrupt
        if not trainer.interrupted or not Path(best.best_model_path).is_file():
            raise KeyboardInterrupt from None
    kept = torch.load(best.best_model_path, weights_only=True, map_location="cpu")
    module.load_state_dict(kept["state_dict"])
    scores = dict(kept["scores"])
    if begun is not None and not begun.scores["score"] < scores["score"]:
        scores = begun.kept_in(network, out)
    reached = f"update {trainer.global_step} of {settings.updates}" if trainer.interrupted else ""
    return TrainedNetwork(scores, reached)


def _workers() -> int:
    """Processes that draw windows: none where the processor trains, which they would hold up."""
    return 0 if training_device() == "cpu" else max(1, len(os.sched_getaffinity(0)) - 1)


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
        out.report(f"general weights  {_text(begun.scores)}")
        return begun

    def kept_in(self, network: nn.Module, out: FitOutput) -> dict[str, float]:
        """Load the network of the beginning into `network`; returns its scores."""
        out.report("no update at this site is better on its validation than the general weights: they are kept")
        network.load_state_dict(self.state)
        return self.scores


def _text(scores: dict[str, float]) -> str:
    return "  ".join(f"{name} {value:.3f}" for name, value in scores.items())


def _trainer(settings: TrainingSettings, out: FitOutput) -> tuple[lightning.Trainer, ModelCheckpoint]:
    """A trainer with its checkpoints and logs in `out.log_dir`, and its checkpoint of the best weights."""
    folder = out.log_dir / "checkpoints"
    best = ModelCheckpoint(folder, filename="best", monitor="score", mode="max", enable_version_counter=False)
    # after every epoch, whatever the score
    last = ModelCheckpoint(folder, filename="last", enable_version_counter=False)
    timed = ModelCheckpoint(
        folder,
        filename="last",
        train_time_interval=timedelta(seconds=CHECKPOINT_EVERY_S),
        save_on_train_epoch_end=False,
        enable_version_counter=False,
    )
    trainer = lightning.Trainer(
        max_epochs=math.ceil(settings.updates / settings.validate_every),
        precision=training_precision(settings, out),
        gradient_clip_val=settings.gradient_clip,
        callbacks=[best, last, timed],
        logger=[CSVLogger(out.log_dir, name="csv"), TensorBoardLogger(out.log_dir, name="tensorboard")],
        log_every_n_steps=min(10, settings.validate_every, settings.updates),
        enable_progress_bar=False,
        enable_model_summary=False,
    )
    return trainer, best


def _updates_in(checkpoint: Path) -> int:
    """The number of updates at a checkpoint."""
    return int(torch.load(checkpoint, weights_only=True, map_location="cpu")["global_step"])


def _resumable(out: FitOutput, training: dict[str, Any]) -> Path | None:
    """The last checkpoint of this `training`, None without one; records `training` in the log folder."""
    described = json.dumps(training, sort_keys=True)
    record, last = out.log_dir / "settings.json", out.log_dir / "checkpoints" / "last.ckpt"
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


class TrainingModule(lightning.LightningModule):
    """Loss, optimiser and validation of one network."""

    def __init__(
        self,
        network: nn.Module,
        in_training: RecurrentNetwork,
        settings: TrainingSettings,
        rate: float,
        validate: Validate,
        out: FitOutput,
    ) -> None:
        """`rate`: the occupied rate of the recordings."""
        super().__init__()
        self.network, self._in_training = channels_last(network), in_training
        self.settings, self.rate, self.validate, self.report = settings, rate, validate, out.report
        self.stage: Stage | None = None
        self.scores: dict[str, float] = {}

    def training_step(self, batch: Item) -> Tensor:
        """The loss of a batch."""
        loss = self.loss_of(batch)
        self.log("loss", loss, batch_size=len(batch.window))
        return loss

    def loss_of(self, batch: Item) -> Tensor:
        """Mean loss of the cells of a batch of windows (B, T, 2, M, M) uint8.

        Windows of one resolution are computed together, and all at once by a network that takes unlike ones.
        """
        together = isinstance(self._in_training, AcceleratedConvGRU)
        losses = []
        for resolution in [batch.resolution] if together else torch.unique(batch.resolution, dim=0):
            set_resolution(self.network, resolution)
            windows = batch.window[(batch.resolution == resolution).all(dim=1)].float()
            losses.append(sequence_loss(self._in_training, windows, self.settings, self.rate, self.motion_weight))
        return SequenceLoss.of_all(losses).mean

    @property
    def motion_weight(self) -> float:
        """The additional weight of cells near an entered one; it falls to zero over the training."""
        return self.settings.motion_weight * (1.0 - self.global_step / self.settings.updates)

    def on_train_batch_end(self, outputs: Any, batch: Any, batch_idx: int) -> None:
        """Count the update."""
        if self.stage is not None:
            self.stage.advance(f"loss {float(outputs['loss']):.4f}")

    def configure_optimizers(self) -> Any:
        """AdamW; the learning rate rises linearly over `warm_up` updates and then falls along a cosine."""
        s = self.settings
        optimizer = torch.optim.AdamW(self.parameters(), lr=s.learning_rate, weight_decay=s.weight_decay)

        def factor(update: int) -> float:
            if update < s.warm_up:
                return (update + 1) / s.warm_up
            return 0.5 * (1.0 + math.cos(math.pi * (update - s.warm_up) / max(1, s.updates - s.warm_up)))

        schedule = torch.optim.lr_scheduler.LambdaLR(optimizer, factor)
        return {"optimizer": optimizer, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}

    def on_train_epoch_end(self) -> None:
        """Score the network on the validation stretch."""
        self.scores = self.validate(self.network)
        self.log_dict(self.scores)
        loss = float(self.trainer.callback_metrics["loss"])
        self.report(f"update {self.global_step}  loss {loss:.4f}  {_text(self.scores)}")

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Store the scores of the weights in their checkpoint."""
        checkpoint["scores"] = self.scores


def validation_scores(
    score: Callable[[FrameSource], Any], sources: Sequence[FrameSource], horizons_s: Sequence[float]
) -> dict[str, float]:
    """F1 of SELECTION_STRATA at the horizons, mean over the stretches; `score` is the mean of those that are defined.

    A stretch in which nothing moves has no F1 of dynamic cells: it does not count there.
    """
    found: dict[str, list[float]] = {}
    for source in sources:
        f1 = score(source).f1
        for stratum in SELECTION_STRATA:
            for horizon in horizons_s:
                at = nearest_step(horizon, source.period_s)
                found.setdefault(f"{stratum}_f1_{horizon:g}s", []).append(float(f1[stratum][at]))
    results = {name: mean_of_defined(values) for name, values in found.items()}
    return {"score": mean_of_defined(list(results.values())), **results}
