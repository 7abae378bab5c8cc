"""What was hidden, and how far to trust a probability: truth and calibration on the page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from gridtrack.evaluation.scoring.counting import Tally
from gridtrack.evaluation.scoring.scores import ScoresError, read_tally
from gridtrack.reports.figures import Axis
from gridtrack.reports.run import Run
from gridtrack.reports.table import HeadlineTable, TableRow

HIDDEN = "occluded"
SIDE, LEAST_CELLS = 170.0, 50
"""Side of a calibration drawing; bins of fewer cells are noise and not drawn."""
Value = float | None


@dataclass(frozen=True)
class HiddenRow:
    """One tracker where nothing is seen: F1 of each stratum, the gap to what is seen, and the share of the oracle."""

    row: TableRow
    f1: tuple[Value, ...]
    gap: Value
    shares: tuple[Value, ...]


@dataclass(frozen=True)
class Hidden:
    """F1 on occluded cells at one step, by how long they have been hidden."""

    horizon: str
    strata: tuple[str, ...]
    rows: tuple[HiddenRow, ...]


@dataclass(frozen=True)
class ReliabilityDiagram:
    """One tracker's reliability diagram: of the cells given about p, how many were occupied."""

    row: TableRow
    points: tuple[tuple[float, float], ...]
    line: str
    parts: tuple[Value, Value, Value]
    """Reliability, resolution and uncertainty: the parts of its Brier score."""
    words: str


def hidden_of(table: HeadlineTable) -> Hidden | None:
    """The rows of a recording with truth; None without."""
    rows = [row for row in table.rows if HIDDEN in row.trial.strata]
    if not rows:
        return None
    step = table.decisive.step
    names = tuple(dict.fromkeys(n for row in rows for n in row.trial.strata if n.startswith(HIDDEN)))
    return Hidden(table.decisive.heading, names, tuple(_hidden_row(row, names, step) for row in rows))


def _hidden_row(row: TableRow, names: Sequence[str], step: int) -> HiddenRow:
    strata, gap = row.trial.strata, row.trial.gap_to_truth
    shares = (strata[n].share_of_oracle if n in strata else None for n in ("moving", HIDDEN))
    return HiddenRow(
        row,
        tuple(strata[name].f1[step] if name in strata else None for name in names),
        None if gap is None else gap[step],
        tuple(None if share is None else share[step] for share in shares),
    )


def reliability_diagrams(
    runs: Sequence[Run], table: HeadlineTable
) -> tuple[tuple[ReliabilityDiagram, ...], tuple[str, ...]]:
    """Reliability diagrams of the ranked rows at the decisive step, on the page of one run.

    And notices of files that could not be read.
    """
    if len(runs) > 1 or table.pooled:
        return (), ()
    drawn, notices = [], []
    steps = len(runs[0].summary.recordings[table.recording].horizons_s) - 1
    for row in table.rows_in("ranked"):
        folder = runs[0].trial_folder(row.label, table.recording)
        try:
            tally = read_tally(folder, steps, (table.decisive.stratum,))
        except ScoresError as error:
            notices.append(f"{row.name}: no calibration drawn: {error}")
            continue
        drawn.append(_reliability_diagram(row, tally, table.decisive.step, table.decisive.stratum))
    return tuple(drawn), tuple(notices)


def _reliability_diagram(row: TableRow, tally: Tally, step: int, stratum: str) -> ReliabilityDiagram:
    cells, positives, p_sum = (counts[step, 0] for counts in (tally.cells, tally.positives, tally.p_sum))
    enough = cells >= LEAST_CELLS
    x, y = Axis(0.0, 1.0, 0.0, SIDE), Axis(0.0, 1.0, SIDE, 0.0)
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
        f"{row.name}: share occupied against forecast probability, {len(points)} bins",
    )
