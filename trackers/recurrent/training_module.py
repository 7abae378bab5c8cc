"""One network in a training by Lightning: the loss of its windows, its optimiser and validation.

The loss is from Ondruska et al. (2016), section III: the binary cross-entropy of every frame that the network forecasts
on its visible cells.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Self

import lightning
import torch
from torch import Tensor
from torch.nn import functional
from torch.utils.data import DataLoader

from gridtrack.trackers.recurrent.devices import Devices
from gridtrack.trackers.recurrent.motion import near_entered_cells
from gridtrack.trackers.recurrent.network import Network, TrainedNetwork, channels_last, set_resolution
from gridtrack.trackers.recurrent.sequences import EpochSampler, Item, SequenceDataset
from gridtrack.trackers.recurrent.settings import TrainingSettings

Validate = Callable[[Network], dict[str, float]]
"""Scores the network as a tracker on the validation stretches; the network with the highest `score` is kept."""


class SequenceLoss(NamedTuple):
    """The sum of the weighted losses of cells, nats, and the sum of the weights of visible cells."""

    total: Tensor
    visible_weight: Tensor

    @property
    def mean(self) -> Tensor:
        """The loss of a visible cell, nats."""
        return self.total / self.visible_weight.clamp(min=1.0)

    @classmethod
    def of_all(cls, losses: Sequence[Self]) -> Self:
        """The loss of all windows together: each visible cell counts alike."""
        totals, weights = zip(*losses, strict=True)
        return cls(torch.stack(totals).sum(), torch.stack(weights).sum())


def sequence_loss(
    network: TrainedNetwork,
    windows: Tensor,
    settings: TrainingSettings,
    rate: float | Tensor,
    motion_weight: float = 0.0,
) -> SequenceLoss:
    """Binary cross-entropy of each forecast frame on its visible cells, and the penalty of the network.

    `windows` (B, T, 2, M, M) of 0 and 1: visible and occupied. A visible cell near an entered one has the weight 1 +
    `motion_weight`. A cell that no frame sees has the weight `unseen_weight`, and as its target the occupied `rate`, of
    all cells () or of each one (M, M), of the recordings: windows with moving shapes have more in them.
    """
    forecast = network.forecast_windows(windows, settings)
    frames = list(forecast.frames)
    visible, occupied = windows.transpose(0, 1)[frames].flatten(0, 1).unbind(dim=1)
    weight = visible
    if motion_weight:
        near = near_entered_cells(windows.bool()).transpose(0, 1)[frames].flatten(0, 1)
        weight = visible * (1.0 + motion_weight * near)
    visible_weight = weight.sum()
    if settings.unseen_weight:
        unseen = ~windows[:, :, 0].bool().any(dim=1).repeat(len(frames), 1, 1)
        weight = weight + settings.unseen_weight * unseen
        occupied = torch.where(unseen, rate, occupied)
    total = functional.binary_cross_entropy_with_logits(
        forecast.logits.float(), occupied, weight=weight, reduction="sum"
    )
    return SequenceLoss(total + forecast.penalty, visible_weight)


class TrainingModule(lightning.LightningModule):
    """Loss, optimiser and validation of one network."""

    def __init__(
        self,
        network: Network,
        in_training: TrainedNetwork,
        dataset: SequenceDataset,
        settings: TrainingSettings,
        devices: Devices,
        validate: Validate,
    ) -> None:
        """The training computes with `in_training`, the same function of the same parameters as `network`.

        `done`: updates of the training that is resumed. `advance` and `report` are called with lines of progress.
        """
        super().__init__()
        self.rate: Tensor
        self.network, self._in_training = channels_last(network), in_training
        self.dataset, self.done = dataset, 0
        self.register_buffer("rate", torch.from_numpy(dataset.unseen_target), persistent=False)
        self.settings, self.devices, self.validate = settings, devices, validate
        self.advance: Callable[[str], None] = _ignore
        self.report: Callable[[str], None] = _ignore
        self.scores: dict[str, float] = {}

    def train_dataloader(self) -> DataLoader[Item]:
        """The windows of this device: its share of each batch."""
        s, number = self.settings, self.devices.number
        sizes = (s.validate_every * s.batch, s.updates * s.batch, self.done * s.batch)
        sampler = EpochSampler(*sizes, rank=self.trainer.global_rank, devices=number)
        processes = self.devices.loading_processes
        return DataLoader(self.dataset, s.batch // number, sampler=sampler, num_workers=processes)

    def on_fit_start(self) -> None:
        """In the process of this device, before its first update."""
        self.devices.start_process()

    def training_step(self, batch: Item) -> Tensor:
        """The loss of a batch: the mean over devices, which DDP takes, is the loss of the cells of all of them."""
        found = self.loss_of(batch)
        of_a_device = self.trainer.strategy.reduce(found.visible_weight, reduce_op="mean")
        loss = found._replace(visible_weight=of_a_device).mean
        self.log("loss", loss, batch_size=len(batch.window))
        return loss

    def loss_of(self, batch: Item) -> SequenceLoss:
        """The loss of a batch of windows (B, T, 2, M, M) uint8, by resolution unless the network mixes them."""
        together = self._in_training.mixed_resolutions
        losses = []
        for resolution in [batch.resolution] if together else torch.unique(batch.resolution, dim=0):
            set_resolution(self.network, resolution)
            windows = batch.window[(batch.resolution == resolution).all(dim=1)].float()
            losses.append(sequence_loss(self._in_training, windows, self.settings, self.rate, self.motion_weight))
        return SequenceLoss.of_all(losses)

    @property
    def motion_weight(self) -> float:
        """The additional weight of cells near an entered one; it falls to zero over the training."""
        return self.settings.motion_weight * (1.0 - self.global_step / self.settings.updates)

    def on_train_batch_end(self, outputs: Any, batch: Any, batch_idx: int) -> None:
        """Count the update."""
        if self.trainer.is_global_zero:
            self.advance(f"loss {float(outputs['loss']):.4f}")

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
        """Score the network on the validation stretches, on one device for all."""
        first = self.trainer.is_global_zero
        self.scores = self.trainer.strategy.broadcast(self.validate(self.network) if first else {})
        self.log_dict(self.scores)
        if first:
            loss = float(self.trainer.callback_metrics["loss"])
            self.report(f"update {self.global_step}  loss {loss:.4f}  {scores_text(self.scores)}")

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Store the scores of the weights in their checkpoint."""
        checkpoint["scores"] = self.scores


def scores_text(scores: dict[str, float]) -> str:
    """The `scores` by name, for a line of progress."""
    return "  ".join(f"{name} {value:.4f}" for name, value in scores.items())


def _ignore(text: str) -> None:
    """Ignore progress."""
