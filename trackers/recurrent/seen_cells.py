"""Classes of the cells that are occupied now, from the latent state alone or together with a classifier of the scan.

Memory and the current scan are different evidence. In the cells that are occupied in the current frame,

    P(class | h_t, x_t)  ~  P(class | h_t)^a  P(class | x_t)^b:

a logarithmic opinion pool (Genest and Zidek, 1986) of two classifiers of the same labelled scans. The powers a and b
have the least log loss on the validation stretch, so they calibrate the product as well. With b = 0 the power a
calibrates the latent state in these cells, where it is more certain than in others.
"""

from __future__ import annotations

from itertools import product

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from gridtrack.common.errors import WeightsError
from gridtrack.common.grid import GridFrame
from gridtrack.trackers.contract import StreamSpec
from gridtrack.trackers.recurrent.settings import EvidenceOption
from gridtrack.trackers.training.cell_classifier import CellClassifier, planes_of, scan_classifier
from gridtrack.trackers.training.cell_training import LabelledCells, logits_of
from gridtrack.trackers.training.labelled_scans import ClassifierSettings
from gridtrack.trackers.training.networks import restore_network
from gridtrack.trackers.training.weights import Weights

PREFIX = "seen_cells."
"""Prefix of the names of the arrays in a weights file."""
POWERS = tuple(round(0.1 * n, 1) for n in range(16))
"""Candidates of a power."""
SMALLEST = 1e-12
"""Smaller probabilities count as this one in logarithms."""


class SeenCells(nn.Module):
    """A classifier of scans, and the powers (a, b) of state and scan: for the state alone, and for both."""

    def __init__(self, classifier: CellClassifier, cell_m: float | None = None) -> None:
        """`cell_m`: cell size of the grids, for a classifier that reads it."""
        super().__init__()
        self.classifier, self.cell_m = classifier, cell_m
        self.state_alone: Tensor
        self.with_scan: Tensor
        self.register_buffer("state_alone", torch.tensor([1.0, 0.0]))
        self.register_buffer("with_scan", torch.tensor([1.0, 0.0]))

    @torch.no_grad()
    def fit_powers(self, state: Tensor, cells: LabelledCells) -> dict[EvidenceOption, float]:
        """Choose the powers on labelled cells of scans, with the logits (N, K) of the latent state.

        Returns the log loss of each kind of evidence, nats a cell.
        """
        state, scan = torch.log_softmax(state, dim=1), torch.log_softmax(logits_of(self.classifier, cells), dim=1)

        def log_loss(powers: tuple[float, float]) -> float:
            a, b = powers
            return float(functional.cross_entropy(a * state + b * scan, cells.targets))

        alone = min(((a, 0.0) for a in POWERS), key=log_loss)
        both = min(product(POWERS, POWERS), key=log_loss)
        self.state_alone.copy_(torch.tensor(alone))
        self.with_scan.copy_(torch.tensor(both))
        return {"state": log_loss(alone), "scan": log_loss(both)}

    def apply_to(self, semantics: NDArray[np.float32], frame: GridFrame, evidence: EvidenceOption) -> None:
        """Replace the latent state's classes (K, M, M) in the occupied cells of `frame`, in place."""
        cells = np.flatnonzero(frame.occupied)
        a, b = (self.with_scan if evidence == "scan" else self.state_alone).tolist()
        by_cell = semantics.reshape(len(semantics), -1)
        logits = a * torch.from_numpy(by_cell[:, cells]).T.clamp(min=SMALLEST).log()
        if b and cells.size:
            index = torch.from_numpy(cells)
            planes = planes_of(frame, self.cell_m).permute(1, 2, 0)[None]
            seen = LabelledCells(planes, torch.zeros_like(index), index, index)
            logits += b * torch.log_softmax(logits_of(self.classifier, seen), dim=1)
        by_cell[:, cells] = torch.softmax(logits, dim=1).T.numpy()


def seen_cells_of(weights: Weights, stream: StreamSpec) -> SeenCells | None:
    """The module in `weights`, for the grid of this stream; None if they have none. Raises WeightsError."""
    if not any(name.startswith(PREFIX) for name in weights.arrays):
        return None
    card = weights.card
    classifier = scan_classifier(ClassifierSettings().channels, len(card.classes), general=card.general)
    found = SeenCells(classifier, stream.grid.cell_m if card.general else None)
    restore_network(found, stream, weights, PREFIX)
    for name, powers in found.named_buffers():
        if not 0.0 <= powers.min() <= powers.max() <= max(POWERS):
            where = f"weights of {card.tracker}: array '{PREFIX}{name}'"
            raise WeightsError(f"{where} is not from 0 to {max(POWERS):g}: train again")
    return found.eval()
