"""The loss of a recurrent network on windows of frames (Ondruska et al., 2016, section III)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Self

import torch
from torch import Tensor
from torch.nn import functional

from gridtrack.trackers.recurrent.entered_cells import near_entered_cells
from gridtrack.trackers.recurrent.network import RecurrentNetwork
from gridtrack.trackers.recurrent.settings import TrainingSettings


class SequenceLoss(NamedTuple):
    """The sum of the weighted losses of cells, nats, and of the weights of those that are visible."""

    total: Tensor
    visible_weight: Tensor

    @property
    def mean(self) -> Tensor:
        """The loss of a visible cell, nats."""
        return self.total / self.visible_weight.clamp(min=1.0)

    @classmethod
    def of_all(cls, losses: Sequence[Self]) -> Self:
        """The loss of all windows together: a window in which hardly anything is visible counts as little."""
        totals, weights = zip(*losses, strict=True)
        return cls(torch.stack(totals).sum(), torch.stack(weights).sum())


def sequence_loss(
    network: RecurrentNetwork, windows: Tensor, settings: TrainingSettings, rate: float, motion_weight: float = 0.0
) -> SequenceLoss:
    """Binary cross-entropy of the forecast of each frame on its visible cells.

    `windows` (B, T, 2, M, M) of 0 and 1: visible and occupied. The burn-in has neither loss nor gradient. A visible
    cell near an entered one has the weight 1 + `motion_weight`. A cell that no frame sees has the weight
    `unseen_weight`, and as its target `rate`, that of the recordings: windows with more in them than a recording, such
    as moving shapes, say nothing of what is there.
    """
    frames = windows.transpose(0, 1)
    state = network.initial(windows.shape[0])
    features = []
    for t, x in enumerate(frames):
        observed = x.contiguous(memory_format=torch.channels_last) if settings.is_observed(t) else None
        with torch.set_grad_enabled(t >= settings.burn_in):
            state = network.step(observed, state)
        if t >= settings.burn_in:
            features.append(network.features(state))
    logits = network.occupancy(torch.cat(features)).float()
    visible, occupied = frames[settings.burn_in :].flatten(0, 1).unbind(dim=1)
    weight = visible
    if motion_weight:
        near = near_entered_cells(windows.bool()).transpose(0, 1)[settings.burn_in :].flatten(0, 1)
        weight = visible * (1.0 + motion_weight * near)
    visible_weight = weight.sum()
    if settings.unseen_weight:
        unseen = ~windows[:, :, 0].bool().any(dim=1).repeat(len(features), 1, 1)
        weight = weight + settings.unseen_weight * unseen
        occupied = torch.where(unseen, rate, occupied)
    total = functional.binary_cross_entropy_with_logits(logits, occupied, weight=weight, reduction="sum")
    return SequenceLoss(total, visible_weight)
