"""Cells in motion without ground truth: how often does the rule agree with the true speeds?

`python -m studies.motion_rule` (two minutes) applies the rule for recordings without ground truth, and
the rule for those with it, to the same frames: the test recordings of the junction, the drives, and the test worlds.
`own cell` is the rule without the neighbours: the return's own cell was seen free one second before. Counted are
dynamic returns, and dynamic cells within 0.5 m of a return in motion.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.grid import GridSpec, Mask
from gridtrack.evaluation.referee.kinds import regions_of
from gridtrack.evaluation.referee.motion import LOOKBACK_S, ObservedMotion, OnceFree, parts_of
from gridtrack.evaluation.referee.strata import PARTS, STRATA
from gridtrack.recordings.observation import Observation
from gridtrack.recordings.stream import GridStream, open_stream

from studies.support.results_file import NONE, measured_table, study_parser, write_table

PLACES = {
    "junction": ("data/junction", "test-1*.tracks"),
    "drives of a robot": ("data/drives", "robot-[0-9][0-9][0-9].tracks"),
    "drives of a car": ("data/drives", "car-[0-9][0-9][0-9].tracks"),
    "worlds": ("data/worlds/test", "*.tracks"),
}
"""Folder and pattern of the recordings of each place."""
EVERY_S = 1.0
RULES = "own cell", "own cell and neighbours"
COLUMNS = ("rule", "returns: precision", "returns: recall", "cells: precision", "cells: recall")
Counts = NDArray[np.int64]
"""Called and true, called, true (rules, returns or cells, 3)."""


def own_cell_free(then: Observation, now: Observation, grid: GridSpec) -> Mask:
    """The returns (M, M) in cells that were seen free `then`."""
    earlier = then.seen_in(now.reference_T_grid, grid).frame
    return now.frame.occupied & earlier.visible & ~earlier.occupied


def counted(stream: GridStream) -> Counts:
    """The counts of one recording with ground truth. Raises RecordingError."""
    grid, counts = stream.grid, np.zeros((len(RULES), 2, 3), np.int64)
    regions, truth = regions_of(stream, STRATA), ObservedMotion(stream)
    recent: deque[Observation] = deque(maxlen=max(1, round(LOOKBACK_S / stream.period_s)) + 1)
    every = max(1, round(EVERY_S / stream.period_s))
    for number, now in enumerate(stream.observations()):
        recent.append(now)
        known = truth.of(now)
        if len(recent) < (recent.maxlen or 0) or number % every:
            continue
        then, dynamic = recent[0], regions.of(now).dynamic
        expected = known.among(now, grid)
        for rule, called in enumerate((own_cell_free(then, now, grid), OnceFree(then).among(now, grid))):
            counts[rule] += [_compared(*pair) for pair in _pairs(called, expected, now.frame.occupied, dynamic, grid)]
    return counts


def _pairs(called: Mask, expected: Mask, returns: Mask, dynamic: Mask, grid: GridSpec) -> Iterator[tuple[Mask, Mask]]:
    """Called and true motion: of dynamic returns, then of dynamic cells near them."""
    yield called & dynamic, expected & dynamic
    near = PARTS.index("in-motion")
    yield parts_of(called, returns, dynamic, grid) == near, parts_of(expected, returns, dynamic, grid) == near


def _compared(called: Mask, expected: Mask) -> tuple[int, int, int]:
    return int((called & expected).sum()), int(called.sum()), int(expected.sum())


def row_of(name: str, counts: NDArray[np.int64]) -> list[str]:
    """A row of the table from counts (2, 3): precision and recall of returns, then of cells."""
    shares = [(both, whole) for both, *wholes in counts.tolist() for whole in wholes]
    return [name, *(f"{both / whole:.2f}" if whole else NONE for both, whole in shares)]


def main(arguments: Sequence[str] | None = None) -> None:
    parser = study_parser(__doc__, "docs/results/motion.json")
    parser.add_argument("--recordings", type=int, help="of each place, at most; default: all")
    given = parser.parse_args(arguments)
    rows = []
    for place, (folder, pattern) in PLACES.items():
        paths = sorted(Path(folder).glob(pattern))[: given.recordings]
        counts = sum((counted(open_stream(path)) for path in paths), np.zeros((len(RULES), 2, 3), np.int64))
        rows += [row_of(f"{place}: {rule}", counts[n]) for n, rule in enumerate(RULES)]
        print("\n".join(" ".join(row) for row in rows[-len(RULES) :]))
    write_table(given.out, "rule", measured_table(COLUMNS, rows), "python -m studies.motion_rule")


if __name__ == "__main__":
    main()
