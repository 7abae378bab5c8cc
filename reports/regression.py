"""The verdict of the regression gate as text for a terminal, Markdown for a pull request, and data for a script."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from gridtrack.common.errors import printable
from gridtrack.evaluation.regression.measurement import BANDS, Baseline
from gridtrack.evaluation.regression.pairing import pair
from gridtrack.evaluation.regression.significance import FAMILY_LEVEL
from gridtrack.evaluation.regression.speed import SpeedRow
from gridtrack.evaluation.regression.verdict import Verdict, VerdictRow
from gridtrack.evaluation.scoring.metrics import f1_score
from gridtrack.evaluation.statistics.jackknife import LEAST_UNITS
from gridtrack.reports.markdown import escaped, markdown_table
from gridtrack.reports.run import UNDEFINED

MAX_TABLE_ROWS = 40
"""Further rows of a table are counted and not shown."""
MAX_FALLEN = 3
"""Largest number of lines on single recordings in the text."""
UNKNOWN_SPREAD = "the baseline has one run: the spread between trainings is unknown and not taken into account"


def text_of(verdict: Verdict) -> str:
    """The verdict for a terminal: what is worse, notes, the rule and the conclusion."""
    lines = [f"worse: {sentence_of(row)}" for row in verdict.worse]
    lines += [f"fall on one recording, not judged: {sentence_of(row)}" for row in verdict.fallen[:MAX_FALLEN]]
    if len(verdict.fallen) > MAX_FALLEN:
        lines.append(f"fall on one recording, not judged: {len(verdict.fallen) - MAX_FALLEN} more, see --markdown")
    lines += [f"note: {note}" for note in verdict.notes]
    lines += [f"{label}: every count is as in the baseline" for label in _unchanged(verdict)]
    return "\n".join(map(printable, [*lines, rule_of(verdict), _conclusion(verdict)]))


def markdown_of(verdict: Verdict) -> str:
    """The verdict as a Markdown page, with names escaped."""
    parts = [f"## gridtrack regress: {'worse' if verdict.worse else 'no worse'}", escaped(rule_of(verdict))]
    changed = [row for row in verdict.rows if row.verdict in {"worse", "no worse"}]
    changed.sort(key=lambda row: (row.verdict != "worse", -row.fall))
    parts += _section(
        "Over all units",
        ["verdict", *_HEADINGS, "p"],
        changed,
        lambda row: [row.verdict, *_row_cells(row), _p_value_text(row)],
    )
    parts += _section(
        "Falls on one recording (not judged)", ["recording", *_HEADINGS], verdict.fallen, _recording_cells
    )
    parts += _section(
        "Speed", ["verdict", "tracker", "call", "times as long as", "baseline", "run"], verdict.speed, _speed_cells
    )
    parts += ["\n".join(f"- {escaped(note)}" for note in verdict.notes)] if verdict.notes else []
    parts += (
        [f"Every count is as in the baseline: {', '.join(map(escaped, _unchanged(verdict)))}."]
        if _unchanged(verdict)
        else []
    )
    return "\n\n".join(parts) + "\n"


def markdown_of_unmeasured(reasons: Sequence[str]) -> str:
    """The Markdown page of a comparison that could not be made."""
    return "## gridtrack regress: not measured\n\n" + "\n".join(f"- {escaped(reason)}" for reason in reasons) + "\n"


def data_of(verdict: Verdict) -> dict[str, Any]:
    """The verdict as data for JSON."""
    return {
        "verdict": "worse" if verdict.worse else "no worse",
        "units": verdict.units,
        "trainings": verdict.trainings,
        "significance": verdict.significance,
        "rows": [_row_data(row) for row in verdict.rows],
        "fallen": [_row_data(row) for row in verdict.fallen],
        "speed": [asdict(row) | {"standing": row.verdict} for row in verdict.speed],
        "notes": list(verdict.notes),
    }


def _row_data(row: VerdictRow) -> dict[str, Any]:
    values = asdict(row)
    verdict = values.pop("verdict")
    return {**values, "standing": verdict, "fall": row.fall}


def text_of_update(path: Path, baseline: Baseline) -> str:
    """The baseline that `--update` wrote, for a terminal: its runs, and the range of F1 of each tracker over them."""
    if len(baseline.runs) == 1:
        return printable(f"baseline: {path}; {UNKNOWN_SPREAD}")
    lines = [f"baseline: {path}, of {len(baseline.runs)} runs"]
    rows = pair(baseline, baseline.first)
    for label in baseline.first.trackers:
        ranges = {np.ptp(np.nan_to_num(f1_score(r.trainings.sum(axis=1)))): r for r in rows if r.label == label}
        widest = max(ranges)
        where = f"{ranges[widest].stratum}, {band_text(ranges[widest].band)}"
        lines.append(
            f"{label}: F1 differs by up to {widest:.4f} ({where})" if widest else f"{label}: F1 is the same in all runs"
        )
    return "\n".join(map(printable, lines))


def sentence_of(row: VerdictRow | SpeedRow) -> str:
    """One row as a sentence."""
    if isinstance(row, SpeedRow):
        return (
            f"{row.label}: {row.call} takes {row.ratio_run:.3g} times as long as {row.reference}'s, in the baseline"
            f" {row.ratio_baseline:.3g}: {row.growth:+.0%}, margin {row.margin:.0%}"
        )
    where = f" on {row.recording}" if row.recording else ""
    significance = "" if row.p is None else f", p {row.p:.4f}"
    spread = "" if row.spread is None else f", spread between trainings {row.spread:.4f}"
    return (
        f"{row.label}{where}, {row.stratum}, {band_text(row.band)}: F1 {_number(row.f1_baseline)} to"
        f" {_number(row.f1_run)}, a fall of {row.fall:.4f}{significance}{spread}, margin {row.margin:g}"
    )


def band_text(band: str) -> str:
    """A step band and its horizons."""
    if band not in BANDS:
        return band
    low, high = BANDS[band]
    return f"{band} (over {low:g} s)" if high >= 60.0 else f"{band} ({low:g}-{high:g} s)"


def rule_of(verdict: Verdict) -> str:
    """The rule of the verdict, in one line."""
    judged = sum(row.verdict != "nothing to find" for row in verdict.rows)
    over = f"{judged} comparisons over {verdict.units} paired unit{'s' if verdict.units != 1 else ''}"
    if verdict.significance:
        trainings = (
            UNKNOWN_SPREAD
            if verdict.trainings == 1
            else f"the spread between trainings is that of the {verdict.trainings} runs of the baseline"
        )
        return (
            f"{over}: worse is a fall in F1 beyond the margin with p of at most {FAMILY_LEVEL:g}, corrected for all"
            f" comparisons; {trainings}"
        )
    return (
        f"{over}, too few for significance, which needs {LEAST_UNITS}: worse is a fall in F1 beyond the tolerance of"
        f" the tracker, and any fall of a tracker without one; {UNKNOWN_SPREAD}"
    )


_HEADINGS = (
    "tracker",
    "stratum",
    "steps",
    "F1 baseline",
    "F1 run",
    "fall",
    "spread",
    "margin",
    "log loss baseline",
    "run",
)


def _conclusion(verdict: Verdict) -> str:
    if not verdict.worse:
        return "no worse than the baseline"
    labels = sorted({row.label for row in verdict.worse})
    return f"worse than the baseline: {', '.join(labels)}"


def _unchanged(verdict: Verdict) -> list[str]:
    """The trackers whose every count is as in the baseline."""
    changed = {row.label for row in verdict.rows if row.verdict in {"worse", "no worse"}}
    return [label for label in dict.fromkeys(row.label for row in verdict.rows) if label not in changed]


def _section(title: str, headings: Sequence[str], rows: Sequence[Any], cells: Any) -> Iterator[str]:
    """A heading and a table; nothing where there are no rows."""
    if not rows:
        return
    yield f"### {title}"
    yield markdown_table(headings, [list(map(escaped, cells(row))) for row in rows[:MAX_TABLE_ROWS]]).rstrip("\n")
    if len(rows) > MAX_TABLE_ROWS:
        yield f"and {len(rows) - MAX_TABLE_ROWS} more"


def _row_cells(row: VerdictRow) -> list[str]:
    losses = [_number(row.log_loss_baseline), _number(row.log_loss_run)]
    scores = [_number(row.f1_baseline), _number(row.f1_run), f"{row.fall:+.4f}", _number(row.spread), f"{row.margin:g}"]
    return [row.label, row.stratum, band_text(row.band), *scores, *losses]


def _recording_cells(row: VerdictRow) -> list[str]:
    return [row.recording, *_row_cells(row)]


def _speed_cells(row: SpeedRow) -> list[str]:
    return [row.verdict, row.label, row.call, row.reference, f"{row.ratio_baseline:.3g}", f"{row.ratio_run:.3g}"]


def _p_value_text(row: VerdictRow) -> str:
    return UNDEFINED if row.p is None else f"{row.p:.4f}"


def _number(value: float | None) -> str:
    return UNDEFINED if value is None else f"{value:.4f}"
