"""Label budget: log loss of the classes of a scan, by the number of labelled scans and how they are drawn.

`python -m studies.label_budget` (hours on one core). From the junction's training recording 50, 100, 200, 400 and 800
scans are labelled, spread over it or consecutive, with three seeds. The network ships and is not trained. The
classifiers have the shipped settings, which were chosen with 800 scans; the state of a training is chosen on the
validation recording. Scores are the referee's counts on test recordings, with a forecast every 2 s. Rows that the file
`--out` has are not measured again.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from gridtrack.common.config import validated
from gridtrack.common.grid import GridFrame
from gridtrack.evaluation.referee.targets import Target
from gridtrack.evaluation.scores.class_log_loss import Matching, match_classes
from gridtrack.recordings.stream import GridStream, open_stream
from gridtrack.trackers.contract import FitTask
from gridtrack.trackers.one_shot import OneShotSettings
from gridtrack.trackers.recurrent.convgru_tracker import DilatedConvGRUTracker
from gridtrack.trackers.recurrent.settings import DilatedConvGRUOptions, EvidenceOption
from gridtrack.trackers.recurrent.transfer import fit_decoder, fit_seen_cells, latent_cells
from gridtrack.trackers.training.cell_classifier import planes_of, scan_classifier
from gridtrack.trackers.training.cell_training import best_classifier
from gridtrack.trackers.training.labelled_scans import VALIDATE_ON, LabelSettings, draw_labelled
from gridtrack.trackers.training.weights import read_card

from studies.class_losses import AHEAD, add_losses, deliver, no_losses
from studies.label_curve import BUDGETS, DASHES, append_row, read_rows, summary
from studies.support.results_file import study_parser
from studies.support.shipped import JUNCTION, WEIGHTS, junction_tests, shipped_tracker

SEEDS = (1, 2, 3)

Classify = Callable[["Reading"], NDArray[np.float32]]
"""The class probabilities (2, K, M, M) of a reading."""


@dataclass(frozen=True)
class Reading:
    """A scored frame, the input of the decoder (2, C, M, M) float16 now and AHEAD, and the targets of both."""

    frame: GridFrame
    state: Tensor
    targets: list[Target]


@dataclass(frozen=True)
class Budget:
    """One set of labelled scans."""

    drawing: str
    seed: int
    scans: int


def shipped_options() -> tuple[OneShotSettings, DilatedConvGRUOptions]:
    """The settings of the shipped classifiers."""
    shot, state = (read_card(WEIGHTS / name / "junction.toml").settings for name in ("one-shot", "dilated-convgru"))
    return validated(OneShotSettings, shot, "card"), validated(DilatedConvGRUOptions, state, "card")


def latent_tracker(source: GridStream) -> DilatedConvGRUTracker:
    """The shipped network on a stream."""
    tracker = shipped_tracker("dilated-convgru", source)
    assert isinstance(tracker, DilatedConvGRUTracker)
    return tracker


def readings(recording: Path, options: DilatedConvGRUOptions) -> Iterator[Reading]:
    """The scored frames of a test recording."""
    stream = open_stream(recording)
    tracker = latent_tracker(stream)
    inputs = []

    def update(frame: GridFrame, due: bool) -> None:
        tracker.update(frame)
        if due:
            inputs.append((frame, states(tracker, options)))

    targets = deliver(stream, update)
    for (frame, state), of_forecast in zip(inputs, targets, strict=True):
        yield Reading(frame, state, of_forecast)


@torch.no_grad()
def states(tracker: DilatedConvGRUTracker, options: DilatedConvGRUOptions) -> Tensor:
    """(2, C, M, M) float16, now and AHEAD."""
    network, state = tracker.network, tracker.state
    now = network.class_planes(state, options.decoded_layers)
    for _ in range(AHEAD):
        state = network.step(None, state)
    return torch.cat([now, network.class_planes(state, options.decoded_layers)]).half()


def losses(classify: Classify, test: Sequence[Reading], matching: Matching) -> dict[str, float]:
    """Mean log loss per scan by column, nats."""
    found = no_losses()
    for reading in test:
        add_losses(found, classify(reading), reading.targets, matching)
    return {column: statistics.fmean(values) for column, values in found.items()}


def no_objective(*_: Any) -> NoReturn:
    """Classes are chosen by their own log loss."""
    raise NotImplementedError


def trained(whole: GridStream, budget: Budget) -> tuple[tuple[str, ...], dict[str, Classify]]:
    """The classes in the labelled scans of a budget, and a classifier for each method."""
    shot, options = shipped_options()
    drawing = validated(LabelSettings, {"labelled_scans": budget.scans, "label_drawing": budget.drawing}, "study")
    labelled, tracker, held_out_on = draw_labelled([whole], drawing, budget.seed), latent_tracker(whole), validation()
    classes, layers = labelled.classes, options.decoded_layers
    task = FitTask([whole], [held_out_on], no_objective, Path(), options, Path(), budget.seed)
    training = latent_cells(lambda _: tracker, labelled.runs(), classes, layers)
    held_out = latent_cells(lambda _: tracker, [(whole, held_out_on.labelled())], classes, layers, VALIDATE_ON)
    scan = best_classifier(
        lambda settings: scan_classifier(settings.channels, len(classes)),
        shot.model_dump(exclude=set(LabelSettings.model_fields)),
        training.scan.cells(),
        [held_out.scan.cells()],
        task,
    ).classifier
    decoder = fit_decoder(options, training.now.cells(training.ahead), held_out, task)
    seen, _ = fit_seen_cells(decoder, training, held_out, len(classes), task)

    @torch.no_grad()
    def of_scan(reading: Reading) -> NDArray[np.float32]:
        probabilities = torch.softmax(scan(planes_of(reading.frame)[None].float()), dim=1).numpy()
        return np.repeat(probabilities, 2, axis=0)

    def decoded(evidence: EvidenceOption) -> Classify:
        @torch.no_grad()
        def classify(reading: Reading) -> NDArray[np.float32]:
            semantics: NDArray[np.float32] = torch.softmax(decoder.classifier(reading.state.float()), dim=1).numpy()
            seen.apply_to(semantics[0], reading.frame, evidence)
            return semantics

        return classify

    return classes, {"one-shot": of_scan, "latent": decoded("state"), "latent and scan": decoded("scan")}


def validation() -> GridStream:
    """The validation recording."""
    return open_stream(JUNCTION / "validation.tracks")


def main(arguments: Sequence[str] | None = None) -> None:
    parser = study_parser(__doc__)
    parser.add_argument("--out", type=Path, default=Path("runs/label_budget.csv"), help="default: %(default)s")
    parser.add_argument("--seeds", type=int, nargs="+", default=SEEDS, help="of the draws")
    parser.add_argument("--budgets", type=int, nargs="+", default=BUDGETS, help="numbers of labelled scans")
    parser.add_argument("--recordings", type=int, default=20, help="number of test recordings, of twenty")
    given = parser.parse_args(arguments)
    torch.set_num_threads(1)
    done = {(row["drawing"], int(row["draw"]), int(row["scans"])) for row in read_rows(given.out)}
    wanted = [Budget(*one) for one in product(DASHES, given.seeds, given.budgets) if one not in done]
    if wanted:
        every, options = junction_tests(), shipped_options()[1]
        some = every[:: -(-len(every) // given.recordings)]
        test = [reading for path in some for reading in readings(path, options)]
        whole = open_stream(JUNCTION / "train.tracks")
    for budget in wanted:
        classes, methods = trained(whole, budget)
        matching = match_classes(classes, whole.classes)
        for method, classify in methods.items():
            row = {"method": method, "drawing": budget.drawing, "scans": budget.scans, "draw": budget.seed}
            append_row(given.out, row | {"classes": len(classes)} | losses(classify, test, matching))
    print(summary(read_rows(given.out)).text())


if __name__ == "__main__":
    main()
