"""Class log loss at the junction with car and bus as one class, as in the paper, beside all five classes.

`python -m studies.merged_classes [ROW...]` (half an hour) streams the test recordings through the trackers with
classes, scores a forecast a second, and writes the table of docs/results/junction/measurements.json. A probability of
the merged class is the sum of both. The paper's decoder reads the latent state alone: the row `evidence=state`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.grid import nearest_step
from gridtrack.evaluation.referee.kinds import Regions
from gridtrack.evaluation.referee.referee import Schedule, ScoredForecast, moments, scored_forecasts
from gridtrack.evaluation.runs.fit_regions import cell_kinds_for
from gridtrack.evaluation.scores.class_log_loss import VISIBILITIES, count_classes, match_classes
from gridtrack.evaluation.scores.definition import Floats, Ratio, divided
from gridtrack.evaluation.statistics.jackknife import interval, ratio_replicates
from gridtrack.recordings.stream import GridStream, open_stream
from gridtrack.trackers import registry

from studies.support.results_file import ResultTable, measured_table, score_text, study_parser, write_table
from studies.support.shipped import junction_tests, shipped_stream

OUT = Path("docs/results/junction/measurements.json")
ROWS: dict[str, dict[str, str]] = {
    "kalman": {},
    "factor-graph": {},
    "one-shot": {},
    "dilated-convgru": {},
    "dilated-convgru, evidence=state": {"evidence": "state"},
}
"""The options of each row; its tracker is the first word."""
ALL, MERGED = "five classes", "car and bus as one"
ONE_CLASS, MEMBERS = "vehicle", ("car", "bus")
AHEAD_S = (0.0, 1.0)
SHOWN = (("visible", 0.0), ("visible", 1.0), ("occluded", 0.0))


class Classes(NamedTuple):
    """The names of merged classes, and the number (K,) among them of each class before."""

    names: tuple[str, ...]
    number: NDArray[np.int64]

    @classmethod
    def of(cls, classes: Sequence[str]) -> Classes:
        """The classes with MEMBERS as one."""
        merged = [ONE_CLASS if name in MEMBERS else name for name in classes]
        names = tuple(dict.fromkeys(merged))
        return cls(names, np.array([names.index(name) for name in merged]))

    def summed(self, semantics: NDArray[np.float32]) -> NDArray[np.float32]:
        """P(class) of the merged classes (S, C, M, M) from `semantics` (S, K, M, M): sums of the probabilities."""
        total = np.zeros((len(semantics), len(self.names), *semantics.shape[2:]), np.float32)
        for plane, own in enumerate(self.number):
            total[:, own] += semantics[:, plane]
        return total


def losses_of(forecast: ScoredForecast, trackers: Sequence[str], recordings: Sequence[str]) -> dict[str, Floats]:
    """The mean log loss (S, visibility) of one forecast's labelled cells by ALL and MERGED classes; NaN without any."""
    semantics = forecast.forecast.semantics
    assert semantics is not None
    own, known = Classes.of(trackers), Classes.of(recordings)
    targets = [replace(target, labels=known.number[target.labels].astype(np.uint8)) for target in forecast.targets]
    counted = {
        ALL: count_classes(semantics, forecast.targets, match_classes(trackers, recordings)),
        MERGED: count_classes(own.summed(semantics), targets, match_classes(own.names, known.names)),
    }
    return {name: divided(loss.sum(axis=(2, 3)), cells.sum(axis=(2, 3))) for name, (cells, loss) in counted.items()}


def each_scored(row: str, stream: GridStream) -> Iterator[dict[str, Floats]]:
    """The losses (S, visibility) of each scored forecast of `stream`, a second apart, at AHEAD_S."""
    name, steps = row.partition(",")[0], [nearest_step(ahead_s, stream.period_s) for ahead_s in AHEAD_S]
    kind = registry.load(name)
    tracker = kind(shipped_stream(name, stream), kind.Options(**ROWS[row]))
    schedule = Schedule(len(stream), max(steps), nearest_step(1.0, stream.period_s))
    delivered = moments(stream, Regions(stream.grid, cell_kinds_for(stream, [stream])))
    for forecast in scored_forecasts(tracker, delivered, schedule, seed=0):
        found = losses_of(forecast, tracker.classes, stream.classes)
        yield {classes: values[steps] for classes, values in found.items()}


def row_of(row: str, streams: Sequence[GridStream]) -> list[str]:
    """Loss per scan with its interval over recordings, by ALL and MERGED and by SHOWN."""
    by_recording = [list(each_scored(row, stream)) for stream in streams]
    cells = [row]
    for classes in (ALL, MERGED):
        of_scans = [np.stack([found[classes] for found in scans]) for scans in by_recording]
        part = np.stack([np.nan_to_num(values).sum(axis=0) for values in of_scans])
        scans = np.stack([(~np.isnan(values)).sum(axis=0) for values in of_scans]).astype(np.float64)
        estimate = interval(ratio_replicates(Ratio(part, scans)), "log")
        for visibility, ahead_s in SHOWN:
            at = estimate.at(AHEAD_S.index(ahead_s)).at(VISIBILITIES.index(visibility))
            cells.append(score_text(float(at.value), float(at.low), float(at.high)))
    return cells


def table(rows: Sequence[str], streams: Sequence[GridStream]) -> ResultTable:
    """A row for each tracker."""
    when = [f"{visibility} {'now' if not ahead_s else f'{ahead_s:g} s'}" for visibility, ahead_s in SHOWN]
    columns = [f"{classes}, {shown}" for classes in (ALL, MERGED) for shown in when]
    return measured_table(("class log loss", *columns), [row_of(row, streams) for row in rows])


def main(arguments: Sequence[str] | None = None) -> None:
    parser = study_parser(__doc__, str(OUT))
    parser.add_argument("rows", nargs="*", default=list(ROWS), help="rows of the table; default: all")
    parser.add_argument("--recordings", type=int, help="the first ones; default: all")
    parser.add_argument("--stretch", default="", help="a part of each, such as 0s-8s; default: all of it")
    given = parser.parse_args(arguments)
    part = f"@{given.stretch}" if given.stretch else ""
    streams = [open_stream(f"{path}{part}") for path in junction_tests()[: given.recordings]]
    found = table(given.rows, streams)
    print(found.markdown())
    write_table(given.out, "merged classes", found, "python -m studies.merged_classes")


if __name__ == "__main__":
    main()
