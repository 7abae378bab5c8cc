"""Reliability diagrams: the share of occupied cells against the forecast probability."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from gridtrack.evaluation.scoring.counting import Tally, for_calibration
from gridtrack.evaluation.scoring.score_store import ScoresError, read_tally
from gridtrack.reports.figures import Axis
from gridtrack.reports.run import ReportedRun
from gridtrack.reports.table import HeadlineTable, TableRow

DIAGRAM_SIDE = 170.0
"""Side of a diagram, in SVG user units."""
LEAST_CELLS = 50
"""A bin of fewer cells is not drawn: its share is mostly noise."""


@dataclass(frozen=True)
class ReliabilityDiagram:
    """The diagram of one tracker: a point for each bin of forecast probability, at the share of its cells that were
    occupied."""

    row: TableRow
    points: tuple[tuple[float, float], ...]
    line: str
    parts: tuple[float | None, float | None, float | None]
    """Reliability, resolution and uncertainty: the parts of the Brier score."""
    words: str


def reliability_diagrams(
    runs: Sequence[ReportedRun], table: HeadlineTable
) -> tuple[tuple[ReliabilityDiagram, ...], tuple[str, ...]]:
    """The diagrams of the ranked rows at the decisive step, and notices of files that cannot be read.

    There are none on the page of several runs, and none of pooled recordings.
    """
    if len(runs) > 1 or table.pooled:
        return (), ()
    diagrams, notices = [], []
    steps = len(runs[0].summary.recordings[table.recording].horizons_s) - 1
    for row in table.rows_in("ranked"):
        folder = runs[0].trial_folder(row.label, table.recording)
        try:
            tally = read_tally(folder, steps, (table.decisive.stratum,))
        except ScoresError as error:
            notices.append(f"{row.name}: no reliability diagram: {error}")
            continue
        diagrams.append(_reliability_diagram(row, tally, table.decisive.step, table.decisive.stratum))
    return tuple(diagrams), tuple(notices)


def _reliability_diagram(row: TableRow, tally: Tally, step: int, stratum: str) -> ReliabilityDiagram:
    cells, positives = (for_calibration(counts[step, 0]) for counts in (tally.cells, tally.positives))
    p_sum = tally.p_sum[step, 0]
    enough = cells >= LEAST_CELLS
    x, y = Axis(0.0, 1.0, 0.0, DIAGRAM_SIDE), Axis(0.0, 1.0, DIAGRAM_SIDE, 0.0)
    means = zip(p_sum[enough] / cells[enough], positives[enough] / cells[enough], strict=True)
    points = tuple((x(float(p)), y(float(rate))) for p, rate in means)
    scores = row.trial.strata[stratum]
    parts = (scores.brier_reliability, scores.brier_resolution, scores.brier_uncertainty)
    reliability, resolution, uncertainty = (None if part is None else part[step] for part in parts)
    return ReliabilityDiagram(
        row,
        points,
        " ".join(f"{px},{py}" for px, py in points),
        (reliability, resolution, uncertainty),
        f"{row.name}: share of occupied cells against forecast probability, {len(points)} bins",
    )
