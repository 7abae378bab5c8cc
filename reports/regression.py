"""What a verdict says: lines for a terminal, Markdown for a pull request, plain data for a script."""

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
from gridtrack.evaluation.statistics.uncertainty import LEAST_UNITS
from gridtrack.reports.run import UNDEFINED

MAX_ROWS = 40
"""So many rows are shown of a table; the rest is counted."""
MAX_FALLEN = 3
"""So many lines a terminal gives to single recordings."""
UNKNOWN_SPREAD = "what separates trainings is unknown from one run, and not counted as chance"


def text_of(verdict: Verdict) -> str:
    """The verdict for a terminal: what is worse, what was judged and how, and what else to know."""
    lines = [f"worse: {sentence_of(row)}" for row in verdict.worse]
    lines += [f"fell on one recording, not judged: {sentence_of(row)}" for row in verdict.fallen[:MAX_FALLEN]]
    if len(verdict.fallen) > MAX_FALLEN:
        lines.append(f"fell on one recording, not judged: {len(verdict.fallen) - MAX_FALLEN} more, see --markdown")
    lines += [f"note: {note}" for note in verdict.notes]
    lines += [f"{label}: every count is as in the baseline" for label in _equal(verdict)]
    return "\n".join(map(printable, [*lines, rule_of(verdict), _conclusion(verdict)]))


def markdown_of(verdict: Verdict) -> str:
    """The verdict as a Markdown page, names escaped."""
    parts = [f"## gridtrack regress: {'worse' if verdict.worse else 'no worse'}", _escaped(rule_of(verdict))]
    moved = [row for row in verdict.rows if row.verdict in {"worse", "no worse"}]
    moved.sort(key=lambda row: (row.verdict != "worse", -row.fall))
    parts += _table(
        "Over all units", ["verdict", *_HEADINGS, "p"], moved, lambda row: [row.verdict, *_cells(row), _p(row)]
    )
    parts += _table("Fell on one recording (not judged)", ["recording", *_HEADINGS], verdict.fallen, _cells_of_one)
    parts += _table(
        "Speed", ["verdict", "tracker", "call", "times as long as", "baseline", "run"], verdict.speed, _times
    )
    parts += ["\n".join(f"- {_escaped(note)}" for note in verdict.notes)] if verdict.notes else []
    parts += (
        [f"Every count is as in the baseline: {', '.join(map(_escaped, _equal(verdict)))}."] if _equal(verdict) else []
    )
    return "\n\n".join(parts) + "\n"


def markdown_of_unmeasured(reasons: Sequence[str]) -> str:
    """A page that says why nothing was measured."""
    return "## gridtrack regress: not measured\n\n" + "\n".join(f"- {_escaped(reason)}" for reason in reasons) + "\n"


def data_of(verdict: Verdict) -> dict[str, Any]:
    """The verdict as plain data."""
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
    return {**values, "standing": values.pop("verdict"), "fall": row.fall}


def text_of_update(path: Path, baseline: Baseline) -> str:
    """What `--update` left for a terminal: of how many runs, and how far apart each tracker's trainings lie in them."""
    if len(baseline.runs) == 1:
        return printable(f"baseline: {path}; {UNKNOWN_SPREAD}")
    lines = [f"baseline: {path}, of {len(baseline.runs)} runs"]
    rows = pair(baseline, baseline.first)
    for label in baseline.first.trackers:
        apart = {np.ptp(np.nan_to_num(f1_score(r.trainings.sum(axis=1)))): r for r in rows if r.label == label}
        widest = max(apart)
        where = f"{apart[widest].stratum}, {band_text(apart[widest].band)}"
        lines.append(
            f"{label}: F1 lies up to {widest:.4f} apart ({where})" if widest else f"{label}: F1 is the same in all"
        )
    return "\n".join(map(printable, lines))


def sentence_of(row: VerdictRow | SpeedRow) -> str:
    """One row in words."""
    if isinstance(row, SpeedRow):
        return (
            f"{row.label}: {row.call} takes {row.ratio_run:.3g} times as long as {row.reference}'s, in the baseline"
            f" {row.ratio_baseline:.3g}: {row.growth:+.0%}, margin {row.margin:.0%}"
        )
    where = f" on {row.recording}" if row.recording else ""
    sure = "" if row.p is None else f", p {row.p:.4f}"
    spread = "" if row.spread is None else f", spread between trainings {row.spread:.4f}"
    return (
        f"{row.label}{where}, {row.stratum}, {band_text(row.band)}: F1 {_number(row.f1_baseline)} to"
        f" {_number(row.f1_run)}, a fall of {row.fall:.4f}{sure}{spread}, margin {row.margin:g}"
    )


def band_text(band: str) -> str:
    """A step band with its horizons."""
    if band not in BANDS:
        return band
    low, high = BANDS[band]
    return f"{band} (over {low:g} s)" if high >= 60.0 else f"{band} ({low:g}-{high:g} s)"


def rule_of(verdict: Verdict) -> str:
    """How it was judged, in one line."""
    judged = sum(row.verdict != "nothing to find" for row in verdict.rows)
    over = f"{judged} comparisons over {verdict.units} paired unit{'s' if verdict.units != 1 else ''}"
    if verdict.significance:
        trainings = (
            UNKNOWN_SPREAD if verdict.trainings == 1 else f"{verdict.trainings} trainings tell what separates two"
        )
        return (
            f"{over}: worse is a fall in F1 beyond the margin that"
            f" comes by chance in less than {FAMILY_LEVEL:.0%} of runs anywhere among them; {trainings}"
        )
    return (
        f"{over}, of which significance wants {LEAST_UNITS}: worse is"
        f" a fall in F1 beyond the tracker's stated tolerance, and any fall where none is stated; {UNKNOWN_SPREAD}"
    )


_HEADINGS = ("tracker", "stratum", "steps", "F1 then", "F1 now", "fall", "spread", "margin", "log loss then", "now")


def _conclusion(verdict: Verdict) -> str:
    if not verdict.worse:
        return "no worse than the baseline"
    labels = sorted({row.label for row in verdict.worse})
    return f"worse than the baseline: {', '.join(labels)}"


def _equal(verdict: Verdict) -> list[str]:
    """Trackers of which every count is as it was."""
    moved = {row.label for row in verdict.rows if row.verdict in {"worse", "no worse"}}
    return [label for label in dict.fromkeys(row.label for row in verdict.rows) if label not in moved]


def _table(title: str, headings: Sequence[str], rows: Sequence[Any], cells: Any) -> Iterator[str]:
    """A heading and a table, or nothing where there are no rows."""
    if not rows:
        return
    yield f"### {title}"
    lines = [headings, ["---"] * len(headings), *(list(map(_escaped, cells(row))) for row in rows[:MAX_ROWS])]
    yield "\n".join("| " + " | ".join(line) + " |" for line in lines)
    if len(rows) > MAX_ROWS:
        yield f"and {len(rows) - MAX_ROWS} more"


def _cells(row: VerdictRow) -> list[str]:
    losses = [_number(row.log_loss_baseline), _number(row.log_loss_run)]
    scores = [_number(row.f1_baseline), _number(row.f1_run), f"{row.fall:+.4f}", _number(row.spread), f"{row.margin:g}"]
    return [row.label, row.stratum, band_text(row.band), *scores, *losses]


def _cells_of_one(row: VerdictRow) -> list[str]:
    return [row.recording, *_cells(row)]


def _times(row: SpeedRow) -> list[str]:
    return [row.verdict, row.label, row.call, row.reference, f"{row.ratio_baseline:.3g}", f"{row.ratio_run:.3g}"]


def _p(row: VerdictRow) -> str:
    return UNDEFINED if row.p is None else f"{row.p:.4f}"


def _number(value: float | None) -> str:
    return UNDEFINED if value is None else f"{value:.4f}"


def _escaped(text: str) -> str:
    """Text that Markdown and the HTML in it leave as it is."""
    text = printable(text).replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    return "".join(f"\\{sign}" if sign in "\\`*_[]|#!~@" else sign for sign in text)
