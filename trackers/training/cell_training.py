"""Training of a cell classifier: a seeded search of its settings, each kept at its best validation log loss."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from gridtrack.common.grid import LabelledFrame
from gridtrack.trackers.contract import FitTask, FrameSource
from gridtrack.trackers.training.cell_classifier import CellClassifier, planes_of
from gridtrack.trackers.training.labelled_scans import ClassifierSettings, class_indices, inverse_frequency

SETTINGS_TRIED = 10
"""Iterations of the search."""
CHANNELS = (16, 32)
LEARNING_RATES = (3e-3, 2e-2)
WEIGHT_DECAYS = (1e-3, 5.0)
CLASS_WEIGHTS = ("inverse-frequency", "none")
"""Ranges of the search: channels and class weights are drawn from these, the others log-uniformly."""
TUNED = frozenset({"channels", "learning_rate", "weight_decay", "class_weights"})
"""The settings that are searched."""
TEMPERATURES = tuple(round(1.05**n, 2) for n in range(-15, 30))
"""Candidates for the calibration, about 0.5 to 4."""
VALIDATIONS = 5
"""Validations during one training."""


@dataclass(frozen=True, slots=True)
class LabelledCells:
    """Input planes of T frames, and their labelled cells.

    `planes` (T, M, M, C). For each cell, (N,) int64: its frame (`at`), its index row * M + column (`cells`) and its
    class (`targets`).
    """

    planes: Tensor
    at: Tensor
    cells: Tensor
    targets: Tensor

    def patches(self, index: Tensor, reach: int) -> Tensor:
        """Patches (n, C, P, P) float32 around the cells `index`, P = 2 `reach` + 1; 0 outside the grid."""
        size = self.planes.shape[1]
        around = torch.arange(-reach, reach + 1)
        row = (self.cells[index] // size)[:, None, None] + around[:, None]
        column = (self.cells[index] % size)[:, None, None] + around
        inside = (row >= 0) & (row < size) & (column >= 0) & (column < size)
        found = self.planes[self.at[index][:, None, None], row.clamp(0, size - 1), column.clamp(0, size - 1)]
        return (found.float() * inside[..., None]).permute(0, 3, 1, 2)


class CellCollector:
    """Collects the labelled cells of frames; cells of a class that is not in `classes` are left out."""

    def __init__(self, classes: Sequence[str]) -> None:
        self.classes = classes
        self._planes: list[Tensor] = []
        self._cells: list[NDArray[np.int64]] = []
        self._targets: list[NDArray[np.int64]] = []

    def add(self, planes: Tensor, labelled: LabelledFrame, names: Sequence[str]) -> None:
        """Add the `planes` (C, M, M) of a frame and its labelled cells; labels index `names`."""
        target = class_indices(labelled.labels, names, self.classes)
        self._planes.append(planes.permute(1, 2, 0))
        self._cells.append(labelled.cells[target >= 0])
        self._targets.append(target[target >= 0])

    def cells(self, *others: CellCollector) -> LabelledCells:
        """All cells added so far, here and to the `others`; smaller grids are padded to the size of the largest one."""
        collectors = (self, *others)
        found = [each for one in collectors for each in one._planes]
        sizes = [len(each) for each in found]
        size = max(sizes)
        planes = torch.stack([functional.pad(each, (0, 0, *2 * (0, size - len(each)))) for each in found])
        own = zip((each for one in collectors for each in one._cells), sizes, strict=True)
        cells = [each // m * size + each % m for each, m in own]
        targets = np.concatenate([each for one in collectors for each in one._targets])
        at = np.repeat(np.arange(len(cells)), [each.size for each in cells])
        return LabelledCells(planes, *map(torch.from_numpy, (at, np.concatenate(cells), targets)))


def scan_cells(
    labelled: Iterable[tuple[FrameSource, Iterable[LabelledFrame]]], classes: Sequence[str], *, general: bool = False
) -> LabelledCells:
    """The planes of frames and their cells of one of `classes`; `labelled`: pairs of sources and frames of them."""
    collector = CellCollector(classes)
    for source, frames in labelled:
        for item in frames:
            collector.add(planes_of(item.frame, source.grid.cell_m if general else None), item, source.classes)
    return collector.cells()


@dataclass(frozen=True, slots=True)
class TrainedClassifier:
    """A classifier with the weights after `update` updates, and its `log_loss` on the validation cells, nats a cell.

    `temperature`: the divisor of its logits, contained in the weights of the last layer.
    """

    settings: ClassifierSettings
    classifier: CellClassifier
    update: int
    log_loss: float
    temperature: float = 1.0
    reached: str = ""
    """The last step of an interrupted search, with this as its best classifier; "" if it finished."""


def best_classifier(
    build: Callable[[ClassifierSettings], CellClassifier],
    given: Mapping[str, Any],
    training: LabelledCells,
    validation: Sequence[LabelledCells],
    task: FitTask,
) -> TrainedClassifier:
    """The classifier with the least log loss on `validation` of SETTINGS_TRIED settings; `given` settings are fixed.

    `validation`: sets of cells with equal weight. `build` returns an untrained classifier. An interrupt ends the search
    at the best so far. Raises KeyboardInterrupt if there is none yet.
    """
    candidates, best = tuple(candidate_settings(given, task.seed)), None
    with task.progress.stage("classifier", len(candidates)) as stage:
        for settings in candidates:
            torch.manual_seed(task.seed)
            try:
                with task.progress.stage("update", settings.updates) as updates:
                    trained = train_classifier(build(settings), settings, training, validation, updates.advance)
                tried = calibrated(trained, validation)
            except KeyboardInterrupt:
                if best is None:
                    raise
                return replace(best, reached=f"classifier {stage.done} of {len(candidates)}")
            best = tried if best is None or tried.log_loss < best.log_loss else best
            stage.advance()
            task.report(
                f"channels {settings.channels}, learning rate {settings.learning_rate:g}, weight decay"
                f" {settings.weight_decay:g}, class weights {settings.class_weights}: validation log loss"
                f" {tried.log_loss:.4f} nats a cell"
            )
    assert best is not None
    return best


def candidate_settings(given: Mapping[str, Any], seed: int) -> Iterator[ClassifierSettings]:
    """The defaults, then a Latin hypercube sample of the settings that are not `given`; equal for equal seeds."""
    yield ClassifierSettings(**given)
    if not TUNED - given.keys():
        return
    draw, number = np.random.default_rng(seed), SETTINGS_TRIED - 1
    drawn: dict[str, list[Any]] = {
        "channels": [CHANNELS[n % len(CHANNELS)] for n in draw.permutation(number)],
        "learning_rate": _log_uniform(draw, *LEARNING_RATES, number),
        "weight_decay": _log_uniform(draw, *WEIGHT_DECAYS, number),
        "class_weights": [CLASS_WEIGHTS[n % len(CLASS_WEIGHTS)] for n in draw.permutation(number)],
    }
    for n in range(number):
        yield ClassifierSettings(**({name: values[n] for name, values in drawn.items()} | dict(given)))


def _log_uniform(draw: np.random.Generator, low: float, high: float, number: int) -> list[float]:
    """One value in each of `number` equal parts of the range, in random order.

    Three significant digits: the value on the card is exactly the value that was used.
    """
    parts = (draw.permutation(number) + draw.random(number)) / number
    return [float(f"{value:.3g}") for value in np.exp(math.log(low) + parts * math.log(high / low))]


def train_classifier(
    classifier: CellClassifier,
    settings: ClassifierSettings,
    training: LabelledCells,
    validation: Sequence[LabelledCells],
    on_update: Callable[[], None] = lambda: None,
) -> TrainedClassifier:
    """AdamW on batches of `training`; the weights with the least mean log loss over the sets of `validation`.

    Batches are drawn by PyTorch's global generator: seed it before the classifier is built.
    """
    class_weights = None
    if settings.class_weights == "inverse-frequency":
        classes: Any = classifier.layers[-1].out_channels
        class_weights = torch.from_numpy(inverse_frequency(training.targets.numpy(), classes))
    optimizer = torch.optim.AdamW(classifier.parameters(), settings.learning_rate, weight_decay=settings.weight_decay)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, settings.updates)
    every = -(-settings.updates // VALIDATIONS)
    best: tuple[float, int, dict[str, Tensor]] | None = None
    for update in range(1, settings.updates + 1):
        batch = torch.randint(len(training.targets), (settings.batch,))
        logits = classifier.of_patches(training.patches(batch, classifier.reach))
        loss = functional.cross_entropy(logits, training.targets[batch], class_weights)
        optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimizer.step()
        schedule.step()
        on_update()
        if update % every == 0 or update == settings.updates:
            log_loss = mean_log_loss([logits_of(classifier, cells) for cells in validation], validation)
            if best is None or log_loss < best[0]:
                best = log_loss, update, {name: value.clone() for name, value in classifier.state_dict().items()}
    assert best is not None
    classifier.load_state_dict(best[2])
    return TrainedClassifier(settings, classifier, best[1], best[0])


@torch.no_grad()
def calibrated(trained: TrainedClassifier, validation: Sequence[LabelledCells]) -> TrainedClassifier:
    """`trained` with its last layer divided by the temperature that is best on `validation` (Guo et al., 2017).

    Trained on few labels, a classifier is overconfident. The most probable class of a cell does not change.
    """
    logits = [logits_of(trained.classifier, cells) for cells in validation]

    def log_loss(temperature: float) -> float:
        return mean_log_loss([each / temperature for each in logits], validation)

    temperature = min(TEMPERATURES, key=log_loss)
    for parameter in trained.classifier.layers[-1].parameters():
        parameter.div_(temperature)
    return replace(trained, temperature=trained.temperature * temperature, log_loss=log_loss(temperature))


def mean_log_loss(logits: Sequence[Tensor], validation: Sequence[LabelledCells]) -> float:
    """Mean of -log P(class) over the cells of each set, nats, classes unweighted; the mean over the sets."""
    pairs = zip(logits, validation, strict=True)
    return sum(float(functional.cross_entropy(each, cells.targets)) for each, cells in pairs) / len(validation)


@torch.no_grad()
def logits_of(classifier: CellClassifier, cells: LabelledCells) -> Tensor:
    """Logits (N, K) of labelled cells."""
    index, at_once = torch.arange(len(cells.targets)), 4096
    some = (index[start : start + at_once] for start in range(0, len(index), at_once))
    return torch.cat([classifier.of_patches(cells.patches(each, classifier.reach)) for each in some])
