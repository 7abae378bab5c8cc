"""One network in a training by Lightning: its windows, loss, optimiser and validation."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import lightning
import torch
from torch import Tensor, nn
from torch.utils.data import DataLoader

from gridtrack.trackers.recurrent.accelerated_convgru import AcceleratedConvGRU
from gridtrack.trackers.recurrent.devices import begin_on_device, drawing_processes
from gridtrack.trackers.recurrent.network import RecurrentNetwork, channels_last
from gridtrack.trackers.recurrent.resolution_input import set_resolution
from gridtrack.trackers.recurrent.sequence_loss import SequenceLoss, sequence_loss
from gridtrack.trackers.recurrent.sequences import EpochSampler, Item, SequenceDataset
from gridtrack.trackers.recurrent.settings import TrainingSettings

Validate = Callable[[nn.Module], dict[str, float]]
"""Scores the network as a tracker on the validation stretch; the network with the highest `score` is kept."""


def scores_text(scores: dict[str, float]) -> str:
    """The `scores` by name, for a line of progress."""
    return "  ".join(f"{name} {value:.4f}" for name, value in scores.items())


def _untold(text: str) -> None:
    """Nobody asked how far the training is."""


class TrainingModule(lightning.LightningModule):
    """Loss, optimiser and validation of one network."""

    def __init__(
        self,
        network: nn.Module,
        in_training: RecurrentNetwork,
        dataset: SequenceDataset,
        settings: TrainingSettings,
        validate: Validate,
        done: int = 0,
    ) -> None:
        """`done`: updates of the training that is resumed. `advance` and `report`, when set, are told how far it is."""
        super().__init__()
        self.network, self._in_training = channels_last(network), in_training
        self.dataset, self.rate, self.done = dataset, dataset.occupied_rate, done
        self.settings, self.validate = settings, validate
        self.advance: Callable[[str], None] = _untold
        self.report: Callable[[str], None] = _untold
        self.scores: dict[str, float] = {}

    def train_dataloader(self) -> DataLoader[Item]:
        """The windows of this device: its share of each batch."""
        s = self.settings
        sizes = (s.validate_every * s.batch, s.updates * s.batch, self.done * s.batch)
        sampler = EpochSampler(*sizes, rank=self.trainer.global_rank, devices=s.devices)
        processes = drawing_processes(s.devices)
        return DataLoader(self.dataset, s.batch // s.devices, sampler=sampler, num_workers=processes)

    def on_fit_start(self) -> None:
        """In the process of this device, before its first update."""
        begin_on_device(self.settings.devices)

    def training_step(self, batch: Item) -> Tensor:
        """The loss of a batch: the mean over devices, which DDP takes, is that of the cells of all of them."""
        found = self.loss_of(batch)
        of_a_device = self.trainer.strategy.reduce(found.visible_weight, reduce_op="mean")
        loss = found._replace(visible_weight=of_a_device).mean
        self.log("loss", loss, batch_size=len(batch.window))
        return loss

    def loss_of(self, batch: Item) -> SequenceLoss:
        """The loss of the cells of a batch of windows (B, T, 2, M, M) uint8.

        Windows of one resolution are computed together, and all at once by a network that takes unlike ones.
        """
        together = isinstance(self._in_training, AcceleratedConvGRU)
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
        """Score the network on the validation stretch, on one device for all."""
        first = self.trainer.is_global_zero
        self.scores = self.trainer.strategy.broadcast(self.validate(self.network) if first else {})
        self.log_dict(self.scores)
        if first:
            loss = float(self.trainer.callback_metrics["loss"])
            self.report(f"update {self.global_step}  loss {loss:.4f}  {scores_text(self.scores)}")

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Store the scores of the weights in their checkpoint."""
        checkpoint["scores"] = self.scores
