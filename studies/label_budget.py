"""Label budget: the log loss of a scan's classes by the number of labelled scans, from the latent state and one scan.

`python -m studies.label_budget` (a quarter of an hour and more); rows that are in the file `--out` are not measured
again. Three stretches of the junction's training recording are drawn; of each the first 50, 100, 200, 400 and 800
scans are labelled. The network is the shipped one and is not trained. The settings of the shipped classifiers are kept
(chosen once, with 800 scans), the best state of each training is chosen on the first 90 s of the validation recording,
and the referee's own counts are taken on test recordings, a forecast every 2 s.
"""

from __future__ import annotations

import argparse
import statistics
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import groupby, product
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from gridtrack.common.config import validated
from gridtrack.evaluation.scoring.motion import ObservedMotion
from gridtrack.evaluation.scoring.referee import Delivery, Schedule
from gridtrack.evaluation.scoring.semantics import VISIBILITIES, Matching, count_classes, match_classes
from gridtrack.evaluation.scoring.target import Target
from gridtrack.recordings.stream import GridStream, open_stream
from gridtrack.trackers.cell_classifier import CellClassifier
from gridtrack.trackers.cell_training import LabelledCells, calibrated, train_classifier
from gridtrack.trackers.label_settings import ClassifierSettings
from gridtrack.trackers.labelled_stretch import LEAD_IN, VALIDATE_ON, learned_classes
from gridtrack.trackers.one_shot.settings import OneShotSettings
from gridtrack.trackers.one_shot.tracker import PLANES, planes_of
from gridtrack.trackers.one_shot.training import scan_cells
from gridtrack.trackers.recurrent.convgru_tracker import DilatedConvGRUTracker
from gridtrack.trackers.recurrent.transfer import latent_cells
from gridtrack.trackers.weights import read_card

from studies.support.label_table import BUDGETS, COLUMNS, append_row, budget_table, read_rows
from studies.support.shipped import JUNCTION, STEPS, WEIGHTS, junction_tests, shipped_tracker

DRAWS, SCANS = (1, 2, 3), 800
AHEAD, EVERY = 8, 16
"""The later step that is scored (1 s), and frames from one scored forecast to the next (2 s)."""
LINEAR = ClassifierSettings(learning_rate=0.0172, weight_decay=0.000377)
"""Best of the ten trials of `dilated-convgru:stage=classes,class_layers=1` with all SCANS of draw 1."""


@dataclass(frozen=True)
class Reading:
    """Inputs of the classifiers at a scored frame and in its forecast, and their targets.

    `planes` by source, each (2, C, M, M), now and AHEAD: `state`, and `scan`, which is the same twice.
    """

    planes: dict[str, Tensor]
    targets: list[Target]


@dataclass(frozen=True)
class Method:
    """A classifier of the planes of `source`: how it is built for a number of classes, and its training settings."""

    name: str
    source: str
    build: Callable[[int], CellClassifier]
    settings: ClassifierSettings


@dataclass(frozen=True)
class Measurement:
    """One missing row of a draw: a method and its number of labelled scans."""

    scans: int
    method: Method


def methods() -> list[Method]:
    """One-shot and the latent state's decoder as they ship, and the paper's linear decoder."""
    shot = read_card(WEIGHTS / "one-shot/junction.toml").settings
    card = read_card(WEIGHTS / "dilated-convgru/junction.toml")
    of_shot = OneShotSettings(**shot)
    of_state = validated(DilatedConvGRUTracker.Options, card.settings, "card")
    tuned = {key: card.results["classes"][key] for key in ("learning_rate", "weight_decay")}
    channels = of_state.channels
    return [
        Method("one-shot", "scan", lambda k: CellClassifier(PLANES, of_shot.hidden, k), of_shot),
        Method("latent, linear", "state", lambda k: CellClassifier(channels, (), k), LINEAR),
        Method(
            "latent", "state", lambda k: CellClassifier(channels, of_state.class_hidden, k), ClassifierSettings(**tuned)
        ),
    ]


def latent_tracker(source: GridStream) -> DilatedConvGRUTracker:
    """The shipped network on a stream."""
    tracker = shipped_tracker("dilated-convgru", source)
    assert isinstance(tracker, DilatedConvGRUTracker)
    return tracker


def drawn(whole: GridStream, seed: int) -> tuple[GridStream, int]:
    """The stretch of SCANS scans that a training with this seed is given, with its lead-in of so many frames.

    All scans of the simulated junction are labelled: every start is possible.
    """
    first = int(np.random.default_rng(seed).integers(len(whole) - SCANS + 1))
    lead_in = min(LEAD_IN, first)
    stretch = (first - lead_in) * whole.period_s, (first + SCANS) * whole.period_s
    return GridStream(whole.recording, stretch), lead_in


def readings(name: str) -> Iterator[Reading]:
    """Of one test recording, at the frames that a comparison `--every 2s` scores."""
    stream = open_stream(JUNCTION / f"{name}.tracks")
    schedule, tracker = Schedule(len(stream), STEPS, EVERY), latent_tracker(stream)
    frames: list[Target] = []
    pending: list[tuple[int, dict[str, Tensor]]] = []
    tracker.reset(0)
    no_parts = ObservedMotion(stream, np.zeros(stream.grid.shape, np.bool_))
    for index, target in enumerate(Delivery(stream, lambda: None, no_parts)):
        frames.append(target)
        tracker.update(target.frame)
        if schedule.due(index):
            pending.append((index, {"state": states(tracker), "scan": planes_of(target.frame).expand(2, -1, -1, -1)}))
    for index, planes in pending:
        yield Reading(planes, [frames[index], frames[index + AHEAD]])


@torch.no_grad()
def states(tracker: DilatedConvGRUTracker) -> Tensor:
    """(2, C, M, M) float16, now and AHEAD."""
    network, state = tracker.network, tracker.state
    now = network.features(state)
    for _ in range(AHEAD):
        state = network.step(None, state)
    return torch.cat([now, network.features(state)]).half()


@torch.no_grad()
def losses(classifier: CellClassifier, source: str, test: Sequence[Reading], matching: Matching) -> dict[str, float]:
    """Mean log loss of a scan in each of COLUMNS, nats: the referee's counts."""
    per_scan: dict[str, list[float]] = {column: [] for column in COLUMNS}
    for reading in test:
        semantics = torch.softmax(classifier(reading.planes[source].float()), dim=1).numpy()
        confusion, log_loss = count_classes(semantics, reading.targets, matching)
        cells, loss = confusion.sum(axis=(-2, -1)), log_loss.sum(axis=(-2, -1))
        for column, (step, kind) in COLUMNS.items():
            if cells[step, VISIBILITIES.index(kind)]:
                per_scan[column].append(
                    float(loss[step, VISIBILITIES.index(kind)] / cells[step, VISIBILITIES.index(kind)])
                )
    return {column: statistics.fmean(values) for column, values in per_scan.items()}


@cache
def validation_cells(classes: tuple[str, ...]) -> dict[str, LabelledCells]:
    """The validation cells, by source."""
    stream = open_stream(f"{JUNCTION / 'validation.tracks'}@0s-90s")
    frames = list(stream.labelled())
    return {
        "scan": scan_cells([(stream.classes, frames[::VALIDATE_ON])], classes),
        "state": latent_cells(latent_tracker(stream), [(stream.classes, frames)], classes, VALIDATE_ON),
    }


def measure_draw(
    whole: GridStream, seed: int, missing: Sequence[Measurement], test: Sequence[Reading], out: Path
) -> None:
    """Train the `missing` classifiers on the first scans of one draw, and append their scores to `out`."""
    stream, lead_in = drawn(whole, seed)
    names, frames = stream.classes, list(stream.labelled())
    frames[:lead_in] = [item._replace(cells=item.cells[:0], labels=item.labels[:0]) for item in frames[:lead_in]]
    tracker = latent_tracker(stream)
    for budget, of_budget in groupby(missing, key=lambda one: one.scans):
        labelled = frames[: lead_in + budget]
        classes = learned_classes(names, (item.labels for item in labelled))
        learned = {
            "scan": scan_cells([(names, labelled)], classes),
            "state": latent_cells(tracker, [(names, labelled)], classes, every=1),
        }
        for method in (one.method for one in of_budget):
            torch.manual_seed(seed)
            validation = validation_cells(classes)[method.source]
            trained = train_classifier(method.build(len(classes)), method.settings, learned[method.source], validation)
            classifier = calibrated(trained, validation).classifier
            found = losses(classifier, method.source, test, match_classes(classes, names))
            append_row(out, {"method": method.name, "scans": budget, "draw": seed, "classes": len(classes), **found})
            print(f"draw {seed}, {budget} scans, {method.name}: {found}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("runs/label_budget.csv"))
    parser.add_argument("--draws", type=int, nargs="+", default=DRAWS, help="seeds of the stretches to measure now")
    parser.add_argument("--recordings", type=int, default=20, help="test recordings to score on, out of twenty")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    done = {(row["method"], int(row["scans"]), int(row["draw"])) for row in read_rows(arguments.out)}
    missing = {
        seed: [
            Measurement(n, method) for n, method in product(BUDGETS, methods()) if (method.name, n, seed) not in done
        ]
        for seed in arguments.draws
    }
    if any(missing.values()):
        names = [path.stem for path in junction_tests()]
        test = [reading for name in names[:: -(-len(names) // arguments.recordings)] for reading in readings(name)]
        whole = open_stream(JUNCTION / "train.tracks")
        for seed, of_draw in missing.items():
            measure_draw(whole, seed, of_draw, test, arguments.out)
    print(budget_table(arguments.out).markdown())


if __name__ == "__main__":
    main()
