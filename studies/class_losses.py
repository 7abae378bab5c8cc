"""Classes of the shipped weights: log loss per scan from one scan, from the latent state, and from both.

`python -m studies.class_losses --recordings 20` (ten minutes on one core; 5 recordings: three). `one-shot` and
`dilated-convgru` with their weights for the junction, scored by the referee's counts on test recordings, with a
forecast every 2 s: mean over the labelled cells of a scan, then over scans, in nats, and the range over recordings.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable, Mapping, Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from gridtrack.common.grid import GridFrame
from gridtrack.evaluation.referee.kinds import KindsOfWindow, Regions
from gridtrack.evaluation.referee.referee import Delivery, Schedule
from gridtrack.evaluation.referee.targets import Target
from gridtrack.evaluation.scores.class_log_loss import VISIBILITIES, Matching, count_classes, match_classes
from gridtrack.recordings.stream import GridStream, open_stream
from gridtrack.trackers import registry
from gridtrack.trackers.contract import Tracker

from studies.label_curve import COLUMNS
from studies.support.results_file import ResultSection, measured_table, study_parser, write_section
from studies.support.shipped import STEPS, junction_tests, shipped_stream

SECTION = "shipped weights"
AHEAD, EVERY = 8, 16
"""The later scored step (1 s), and frames from one scored forecast to the next (2 s)."""
ROWS = {
    "one-shot": ("one-shot", {}),
    "latent": ("dilated-convgru", {"evidence": "state"}),
    "latent and scan": ("dilated-convgru", {"evidence": "scan"}),
}
"""The tracker and the options of each row."""

Losses = dict[str, list[float]]
"""Log loss of each scan, nats, by column."""


def deliver(stream: GridStream, update: Callable[[GridFrame, bool], None]) -> list[list[Target]]:
    """Deliver each frame to `update`, with whether a forecast is due; the targets (now, AHEAD) of each forecast.

    Forecasts are due when `compare --every 2s` scores them.
    """
    schedule, targets = Schedule(len(stream), STEPS, EVERY), []
    regions = Regions(stream.grid, KindsOfWindow(np.zeros(stream.grid.shape, np.uint8)))
    for index, moment in enumerate(Delivery(stream, lambda: None, regions)):
        targets.append(moment.target)
        update(moment.frame, schedule.due(index))
    return [[targets[index], targets[index + AHEAD]] for index in range(len(targets)) if schedule.due(index)]


def add_losses(losses: Losses, semantics: NDArray[np.float32], targets: Sequence[Target], matching: Matching) -> None:
    """Add the log loss of one scan to each of COLUMNS that has labelled cells.

    semantics: (2, K, M, M), the class probabilities now and AHEAD.
    """
    confusion, log_loss = count_classes(semantics, targets, matching)
    cells, loss = confusion.sum(axis=(-2, -1)), log_loss.sum(axis=(-2, -1))
    for column, (step, kind) in COLUMNS.items():
        entry = step, VISIBILITIES.index(kind)
        if cells[entry]:
            losses[column].append(float(loss[entry] / cells[entry]))


def no_losses() -> Losses:
    """Before the first scan."""
    return {column: [] for column in COLUMNS}


def trackers_of(stream: GridStream) -> dict[str, Tracker]:
    """The trackers of ROWS with their shipped weights."""
    made = {}
    for row, (name, options) in ROWS.items():
        kind = registry.load(name)
        made[row] = kind(shipped_stream(name, stream), kind.Options(**options))
        made[row].reset(0)
    return made


def losses_of(recording: str) -> dict[str, Losses]:
    """The losses of ROWS on a recording or a stretch of it."""
    stream = open_stream(recording)
    trackers = trackers_of(stream)
    forecasts: dict[str, list[NDArray[np.float32]]] = {row: [] for row in ROWS}

    def update(frame: GridFrame, due: bool) -> None:
        for row, tracker in trackers.items():
            tracker.update(frame)
            if due:
                semantics = tracker.predict(AHEAD).semantics
                assert semantics is not None
                forecasts[row].append(semantics[[0, AHEAD]])

    targets = deliver(stream, update)
    found = {}
    for row, tracker in trackers.items():
        found[row] = no_losses()
        matching = match_classes(tracker.classes, stream.classes)
        for semantics, of_forecast in zip(forecasts[row], targets, strict=True):
            add_losses(found[row], semantics, of_forecast, matching)
    return found


def section_of(by_recording: Mapping[str, Mapping[str, Losses]], command: str) -> ResultSection:
    """The table, and the mean of each row as a share of one-shot's."""
    means = {
        row: {c: statistics.fmean(x for found in by_recording.values() for x in found[row][c]) for c in COLUMNS}
        for row in ROWS
    }
    rows = []
    for row in ROWS:
        ranges = {c: [statistics.fmean(found[row][c]) for found in by_recording.values()] for c in COLUMNS}
        rows.append((row, *(f"{means[row][c]:.3f} [{min(own):.3f}, {max(own):.3f}]" for c, own in ranges.items())))
    values = {
        f"{row} / one-shot, {c}": f"{means[row][c] / means['one-shot'][c]:.2f}"
        for row in ROWS
        for c in COLUMNS
        if row != "one-shot"
    }
    values["recordings"] = str(len(by_recording))
    values["scans"] = str(sum(len(found["one-shot"]["visible now"]) for found in by_recording.values()))
    return ResultSection(
        command=command, tables={"table": measured_table(("classes from", *COLUMNS), rows)}, values=values
    )


def main(arguments: Sequence[str] | None = None) -> None:
    parser = study_parser(__doc__, "docs/results/trackers/one-shot.json")
    parser.add_argument("--recordings", type=int, default=20, help="number of test recordings, of twenty")
    parser.add_argument("--stretch", help="of each recording, such as 0s-20s; default: all of it")
    given = parser.parse_args(arguments)
    torch.set_num_threads(1)
    stretch = f"@{given.stretch}" if given.stretch else ""
    every = junction_tests()
    chosen = every[:: -(-len(every) // given.recordings)]
    section = section_of(
        {path.stem: losses_of(f"{path}{stretch}") for path in chosen},
        f"python -m studies.class_losses --recordings {len(chosen)}",
    )
    print(section.text())
    write_section(given.out, SECTION, section)


if __name__ == "__main__":
    main()
