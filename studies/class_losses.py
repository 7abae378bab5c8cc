"""Classes of the shipped weights: log loss of a scan from one scan, from the latent state, and from both.

`python -m studies.class_losses --recordings 20` (ten minutes on one core; 5: three). `one-shot` and `dilated-convgru`
with their weights for the junction are scored by the referee's own counts on test recordings, a forecast every 2 s: in
nats, the mean over scans of the mean over the labelled cells of a scan, and the range of the recordings' means.
"""

from __future__ import annotations

import argparse
import statistics
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from gridtrack.evaluation.referee.kinds import KindsOfWindow, Regions
from gridtrack.evaluation.referee.referee import Delivery, Schedule
from gridtrack.evaluation.referee.targets import Target
from gridtrack.evaluation.scores.class_log_loss import VISIBILITIES, count_classes, match_classes
from gridtrack.recordings.stream import GridStream, open_stream
from gridtrack.trackers import registry
from gridtrack.trackers.contract import Tracker

from studies.support.label_table import COLUMNS
from studies.support.results_file import ResultSection, measured_table, write_section
from studies.support.shipped import STEPS, junction_tests, shipped_stream

FILE, SECTION = Path("trackers/one-shot.json"), "shipped weights"
AHEAD, EVERY = 8, 16
"""The later step that is scored (1 s), and frames from one scored forecast to the next (2 s)."""
ROWS = {
    "one-shot": ("one-shot", {}),
    "latent": ("dilated-convgru", {"evidence": "state"}),
    "latent and scan": ("dilated-convgru", {"evidence": "scan"}),
}

Losses = dict[str, dict[str, list[float]]]
"""Log loss of each scan, nats, by row and column."""


def trackers_of(stream: GridStream) -> dict[str, Tracker]:
    """The trackers of ROWS with their shipped weights, reset."""
    made = {}
    for row, (name, options) in ROWS.items():
        kind = registry.load(name)
        made[row] = kind(shipped_stream(name, stream), kind.Options(**options))
        made[row].reset(0)
    return made


def losses_of(recording: str) -> Losses:
    """Of a recording or a stretch of it, at the frames that a comparison `--every 2s` scores."""
    stream = open_stream(recording)
    schedule, trackers = Schedule(len(stream), STEPS, EVERY), trackers_of(stream)
    no_kinds = Regions(stream.grid, KindsOfWindow(np.zeros(stream.grid.shape, np.uint8)))
    frames: list[Target] = []
    pending: list[tuple[int, str, NDArray[np.float32]]] = []
    for index, moment in enumerate(Delivery(stream, lambda: None, no_kinds)):
        frames.append(moment.target)
        for row, tracker in trackers.items():
            tracker.update(moment.frame)
            if schedule.due(index):
                semantics = tracker.predict(AHEAD).semantics
                assert semantics is not None
                pending.append((index, row, semantics[[0, AHEAD]]))
    found: Losses = {row: {column: [] for column in COLUMNS} for row in ROWS}
    for index, row, semantics in pending:
        matching = match_classes(trackers[row].classes, stream.classes)
        confusion, log_loss = count_classes(semantics, [frames[index], frames[index + AHEAD]], matching)
        cells, loss = confusion.sum(axis=(-2, -1)), log_loss.sum(axis=(-2, -1))
        for column, (step, kind) in COLUMNS.items():
            entry = step, VISIBILITIES.index(kind)
            if cells[entry]:
                found[row][column].append(float(loss[entry] / cells[entry]))
    return found


def section_of(by_recording: dict[str, Losses], command: str) -> ResultSection:
    """The table, and each row's mean as a share of one-shot's."""
    means = {
        row: {c: statistics.fmean(x for found in by_recording.values() for x in found[row][c]) for c in COLUMNS}
        for row in ROWS
    }
    rows = []
    for row in ROWS:
        ranges = [[statistics.fmean(found[row][c]) for found in by_recording.values()] for c in COLUMNS]
        texts = [
            f"{means[row][c]:.3f} [{min(own):.3f}, {max(own):.3f}]" for c, own in zip(COLUMNS, ranges, strict=True)
        ]
        rows.append((row, *texts))
    values = {
        f"{row} / one-shot, {c}": f"{means[row][c] / means['one-shot'][c]:.2f}"
        for row in ROWS
        for c in COLUMNS
        if row != "one-shot"
    }
    values["recordings"] = str(len(by_recording))
    values["scans"] = str(sum(len(found["one-shot"]["visible now"]) for found in by_recording.values()))
    table = measured_table(("classes from", *COLUMNS), rows)
    return ResultSection(command=command, tables={"table": table}, values=values)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, help="folder of results to write a section of, such as docs/results")
    parser.add_argument("--recordings", type=int, default=20, help="test recordings to score on, out of twenty")
    parser.add_argument("--stretch", help="of each recording, such as 0s-20s; default: all of it")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    every, stretch = junction_tests(), f"@{arguments.stretch}" if arguments.stretch else ""
    some = every[:: -(-len(every) // arguments.recordings)]
    section = section_of(
        {path.stem: losses_of(f"{path}{stretch}") for path in some},
        f"python -m studies.class_losses --recordings {len(some)}",
    )
    print(section.tables["table"].markdown(), *(f"{name} {value}" for name, value in section.values.items()), sep="\n")
    if arguments.out:
        write_section(arguments.out / FILE, SECTION, section)


if __name__ == "__main__":
    main()
