"""The leaderboard of a suite: as rows for a terminal, and as a page without scripts that opens from disk."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from markupsafe import Markup

from gridtrack.common.files import write_text
from gridtrack.evaluation.regression.measurement import BANDS
from gridtrack.evaluation.suites.leaderboard import BAND, BoardRow, BoardValue, Leaderboard
from gridtrack.evaluation.suites.suite import Suite
from gridtrack.reports.page import page_environment
from gridtrack.reports.run import UNDEFINED
from gridtrack.reports.scripts import policy_of
from gridtrack.reports.styles import page_css
from gridtrack.reports.table import RECORDED
from gridtrack.trackers.contract import Role

BAR = 150
"""Width of the drawing of an interval, pixels, from 0 to 1."""
VERDICT_MARKS = {"better": " ▲", "worse": " ▼"}
"""Marks of rows that are better and worse than the reference."""
MARKS: Mapping[Role, str] = {"tracker": "", "floor": "floor", "recorded": RECORDED}
"""The mark of a row by its role."""


def printed_rows(board: Leaderboard) -> list[Mapping[str, str]]:
    """The rows of the leaderboard as texts by heading."""
    return [
        {
            "rank": str(row.rank),
            "tracker": f"{row.label} ({MARKS[row.role]})" if MARKS[row.role] else row.label,
            **{heading(value): estimate_text(value) for value in row.values},
            f"difference from {board.reference}": difference_text(row),
        }
        for row in board.rows
    ]


def sentences(suite: Suite, board: Leaderboard) -> Iterator[str]:
    """The result for the reference in sentences, and the rows that do not pair."""
    own = next(row for row in board.rows if row.label == board.reference)
    of = {verdict: [row.label for row in board.rows if row.verdict == verdict] for verdict in ("better", "worse")}
    value = own.values[0]
    yield (
        f"{own.label} on {suite.name}: {value.output.title.lower()} {estimate_text(value)}, rank {own.rank} of"
        f" {len(board.rows)} over {board.units} units."
    )
    if of["worse"]:
        yield f"It is better than {', '.join(of['worse'])}."
    if of["better"]:
        yield f"It is worse than {', '.join(of['better'])}."
    if same := [row.label for row in board.rows if row.verdict == "no difference shown"]:
        yield f"No difference is shown from {', '.join(same)}."
    yield from (f"left out: {line}" for line in board.left_out)


def heading(value: BoardValue) -> str:
    """The heading of a column: the output, its stratum and the time ahead that it is of."""
    low, high = BANDS[BAND]
    counted = [f"{horizon:g}" for horizon in value.score.horizons_s if low < horizon <= high]
    ahead = f"{low:g} to {high:g}" if value.score.counts_every_step else " and ".join(counted)
    return f"{value.output.title}, {value.score.stratum}, {ahead} s"


def estimate_text(value: BoardValue) -> str:
    """A value with its interval, if it has one."""
    estimate, decimals = value.estimate, value.output.decimals
    if np.isnan(estimate.value):
        return UNDEFINED
    text = f"{float(estimate.value):.{decimals}f}"
    if np.isnan(estimate.low):
        return text
    return f"{text} [{float(estimate.low):.{decimals}f}, {float(estimate.high):.{decimals}f}]"


def difference_text(row: BoardRow) -> str:
    """The difference from the reference with its interval, and a mark if its test shows one."""
    if not row.verdict:
        return ""
    found, decimals = row.difference, row.values[0].output.decimals
    if np.isnan(found.low):
        return f"{float(found.value):+.{decimals}f}"
    ends = f"[{float(found.low):+.{decimals}f}, {float(found.high):+.{decimals}f}]"
    return f"{float(found.value):+.{decimals}f} {ends}{VERDICT_MARKS.get(row.verdict, '')}"


@dataclass(frozen=True)
class DrawnInterval:
    """An interval of values from 0 to 1 in a drawing BAR pixels wide."""

    low: float
    at: float
    high: float

    @classmethod
    def of(cls, value: BoardValue) -> DrawnInterval | None:
        """The interval of a value; None if it is undefined."""
        if np.isnan(value.estimate.value):
            return None
        at = float(value.estimate.value)
        low, high = (at if np.isnan(end) else float(end) for end in (value.estimate.low, value.estimate.high))
        return cls(round(low * BAR, 1), round(at * BAR, 1), round(high * BAR, 1))


def render_leaderboard(suite: Suite, board: Leaderboard, out: Path) -> Path:
    """Write the page of a leaderboard as index.html in the folder `out`. Returns its path."""
    content = (
        page_environment()
        .get_template("leaderboard.html.j2")
        .render(
            suite=suite,
            board=board,
            bar=BAR,
            marks=MARKS,
            heading=heading,
            estimate_text=estimate_text,
            difference_text=difference_text,
            drawn=DrawnInterval.of,
            css=Markup(page_css()),  # a file of this package, no text of a row
            policy=Markup(policy_of([], [page_css()])),
        )
    )
    out.mkdir(parents=True, exist_ok=True)
    write_text(out / "index.html", content)
    return out / "index.html"
