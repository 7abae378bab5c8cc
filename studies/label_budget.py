"""Label budget: the log loss of a scan's classes by the number of labelled scans and by how they are drawn.

`python -m studies.label_budget` (hours on one core); rows that are in the file `--out` are not measured again. Of the
junction's training recording 50, 100, 200, 400 and 800 scans are labelled, spread over it or in a row, with three
seeds. The network is the shipped one and is not trained. The settings of the shipped classifiers are kept (chosen once,
with 800 scans), the best state of each training is chosen on the validation recording, and the referee's own counts are
taken on test recordings, a forecast every 2 s.
"""

from __future__ import annotations

import argparse
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
from gridtrack.evaluation.referee.kinds import KindsOfWindow, Regions
from gridtrack.evaluation.referee.referee import Delivery, Schedule
from gridtrack.evaluation.referee.targets import Target
from gridtrack.evaluation.scores.class_log_loss import VISIBILITIES, Matching, count_classes, match_classes
from gridtrack.recordings.stream import GridStream, open_stream
from gridtrack.trackers.contract import FitTask
from gridtrack.trackers.one_shot import OneShotSettings
from gridtrack.trackers.recurrent.convgru_tracker import DilatedConvGRUTracker
from gridtrack.trackers.recurrent.settings import DilatedConvGRUOptions
from gridtrack.trackers.recurrent.transfer import fit_decoder, fit_seen_cells, latent_cells
from gridtrack.trackers.training.cell_classifier import planes_of, scan_classifier
from gridtrack.trackers.training.cell_training import best_classifier
from gridtrack.trackers.training.labelled_scans import VALIDATE_ON, LabelSettings, draw_labelled
from gridtrack.trackers.training.weights import read_card

from studies.support.label_table import BUDGETS, COLUMNS, DRAWINGS, append_row, budget_table, read_rows
from studies.support.shipped import JUNCTION, STEPS, WEIGHTS, junction_tests, shipped_tracker

SEEDS = (1, 2, 3)
AHEAD, EVERY = 8, 16
"""The later step that is scored (1 s), and frames from one scored forecast to the next (2 s)."""

Classify = Callable[["Reading"], NDArray[np.float32]]
"""The class probabilities (2, K, M, M) of a reading."""


@dataclass(frozen=True)
class Reading:
    """A scored frame, the decoder's input (2, C, M, M) float16 now and AHEAD, and the targets of both."""

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
    """The settings of the classifiers that ship, so that they are not searched again."""
    shot, state = (read_card(WEIGHTS / name / "junction.toml").settings for name in ("one-shot", "dilated-convgru"))
    return validated(OneShotSettings, shot, "card"), validated(DilatedConvGRUOptions, state, "card")


def latent_tracker(source: GridStream) -> DilatedConvGRUTracker:
    """The shipped network on a stream."""
    tracker = shipped_tracker("dilated-convgru", source)
    assert isinstance(tracker, DilatedConvGRUTracker)
    return tracker


def readings(name: str, options: DilatedConvGRUOptions) -> Iterator[Reading]:
    """Of one test recording, at the frames that a comparison `--every 2s` scores."""
    stream = open_stream(JUNCTION / f"{name}.tracks")
    schedule, tracker = Schedule(len(stream), STEPS, EVERY), latent_tracker(stream)
    no_kinds = Regions(stream.grid, KindsOfWindow(np.zeros(stream.grid.shape, np.uint8)))
    frames: list[Target] = []
    pending: list[tuple[int, Tensor]] = []
    tracker.reset(0)
    for index, moment in enumerate(Delivery(stream, lambda: None, no_kinds)):
        frames.append(moment.target)
        tracker.update(moment.frame)
        if schedule.due(index):
            pending.append((index, states(tracker, options)))
    for index, state in pending:
        yield Reading(frames[index].frame, state, [frames[index], frames[index + AHEAD]])


@torch.no_grad()
def states(tracker: DilatedConvGRUTracker, options: DilatedConvGRUOptions) -> Tensor:
    """(2, C, M, M) float16, now and AHEAD."""
    network, state = tracker.network, tracker.state
    now = network.class_planes(state, options.decoded_layers)
    for _ in range(AHEAD):
        state = network.step(None, state)
    return torch.cat([now, network.class_planes(state, options.decoded_layers)]).half()


def losses(classify: Classify, test: Sequence[Reading], matching: Matching) -> dict[str, float]:
    """Mean log loss of a scan in each of COLUMNS, nats: the referee's counts."""
    per_scan: dict[str, list[float]] = {column: [] for column in COLUMNS}
    for reading in test:
        confusion, log_loss = count_classes(classify(reading), reading.targets, matching)
        cells, loss = confusion.sum(axis=(-2, -1)), log_loss.sum(axis=(-2, -1))
        for column, (step, kind) in COLUMNS.items():
            entry = step, VISIBILITIES.index(kind)
            if cells[entry]:
                per_scan[column].append(float(loss[entry] / cells[entry]))
    return {column: statistics.fmean(values) for column, values in per_scan.items()}


def no_objective(*_: Any) -> NoReturn:
    """Classes are chosen by their own log loss."""
    raise NotImplementedError


def trained(whole: GridStream, budget: Budget) -> tuple[tuple[str, ...], dict[str, Classify]]:
    """The classes learned from the labelled scans of a budget, and the classifiers of each method."""
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

    @torch.no_grad()
    def of_state(reading: Reading) -> NDArray[np.float32]:
        semantics: NDArray[np.float32] = torch.softmax(decoder.classifier(reading.state.float()), dim=1).numpy()
        seen.apply_to(semantics[0], reading.frame, "state")
        return semantics

    @torch.no_grad()
    def of_both(reading: Reading) -> NDArray[np.float32]:
        semantics: NDArray[np.float32] = torch.softmax(decoder.classifier(reading.state.float()), dim=1).numpy()
        seen.apply_to(semantics[0], reading.frame, "scan")
        return semantics

    return classes, {"one-shot": of_scan, "latent": of_state, "latent and scan": of_both}


def validation() -> GridStream:
    """The validation recording."""
    return open_stream(JUNCTION / "validation.tracks")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("runs/label_budget.csv"))
    parser.add_argument("--seeds", type=int, nargs="+", default=SEEDS, help="seeds of the draws to measure now")
    parser.add_argument("--budgets", type=int, nargs="+", default=BUDGETS, help="numbers of labelled scans")
    parser.add_argument("--recordings", type=int, default=20, help="test recordings to score on, out of twenty")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    done = {(row["drawing"], int(row["draw"]), int(row["scans"])) for row in read_rows(arguments.out)}
    wanted = [Budget(*one) for one in product(DRAWINGS, arguments.seeds, arguments.budgets) if one not in done]
    if wanted:
        names = [path.stem for path in junction_tests()]
        options = shipped_options()[1]
        some = names[:: -(-len(names) // arguments.recordings)]
        test = [reading for name in some for reading in readings(name, options)]
        whole = open_stream(JUNCTION / "train.tracks")
    for budget in wanted:
        classes, methods = trained(whole, budget)
        matching = match_classes(classes, whole.classes)
        for method, classify in methods.items():
            row = {"method": method, "drawing": budget.drawing, "scans": budget.scans, "draw": budget.seed}
            append_row(arguments.out, row | {"classes": len(classes)} | losses(classify, test, matching))
    print(budget_table(arguments.out).markdown())


if __name__ == "__main__":
    main()
