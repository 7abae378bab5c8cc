"""The verdict of the regression gate in rows: Markdown tables for a pull request, data for a script, and JUnit XML."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import Any
from xml.etree import ElementTree

import numpy as np

from gridtrack.common.errors import printable
from gridtrack.evaluation.regression.judging import VerdictRow
from gridtrack.evaluation.regression.recoveries import RecoveryRow
from gridtrack.evaluation.regression.speed import SpeedRow, TurnsRow
from gridtrack.evaluation.regression.verdict import AnyRow, SecondLook, Standing, Verdict
from gridtrack.reports.junit import junit_case, junit_suite, xml_of
from gridtrack.reports.markdown import escaped, markdown_table
from gridtrack.reports.run import UNDEFINED
from gridtrack.reports.verdict_text import (
    NO_COLLAPSE,
    amount_text,
    band_text,
    number_text,
    p_digits,
    place_of,
    rule_of,
    score_texts,
    second_lines,
    second_text,
    sentence_of,
    turns_texts,
    unchanged_labels,
)

SUITE = "gridtrack regress"
MAX_TABLE_ROWS = 40
"""Limit of the rows of a table; the number of further rows is shown."""
_HEADINGS = (
    "tracker",
    "score",
    "stratum",
    "steps",
    "baseline",
    "run",
    "worse by",
    "found from",
    "margin",
    "spread",
)


def markdown_of(verdict: Verdict) -> str:
    """The verdict as a Markdown page, with names escaped."""
    parts = [f"## gridtrack regress: {'worse' if verdict.worse else 'no worse'}", escaped(rule_of(verdict))]
    parts += ["\n".join(f"- {escaped(line)}" for line in second_lines(verdict))] if verdict.second_looks else []
    changed = [row for row in verdict.rows if row.verdict in {"worse", "no worse"}]
    changed.sort(key=lambda row: (row.verdict != "worse", -row.severity))
    parts += _section(
        "Over all units",
        ["verdict", *_HEADINGS, "p"],
        changed,
        lambda row: [_verdict_text(verdict, row), *_row_cells(row), UNDEFINED if row.p is None else p_digits(row.p)],
    )
    parts += _section(
        "Since the best entry of the history",
        ["verdict", *_HEADINGS, "entry"],
        verdict.below_best,
        lambda row: [_verdict_text(verdict, row), *_row_cells(row), row.since],
    )
    parts += _section(
        "On one recording",
        ["verdict", "recording", *_HEADINGS],
        verdict.on_recordings,
        lambda row: [_verdict_text(verdict, row), row.recording, *_row_cells(row)],
    )
    parts += _section(
        "Recoveries",
        ["verdict", "tracker", "baseline", "run"],
        verdict.recoveries,
        lambda row: [verdict.standing_of(row), row.label, f"{row.baseline}", f"{row.run}"],
    )
    parts += _section(
        "Speed",
        ["verdict", "tracker", "call", "times as long as", "baseline", "run"],
        verdict.speed,
        lambda row: [verdict.standing_of(row), *_speed_cells(row)],
    )
    parts += _section(
        "Speed in turns",
        ["verdict", "tracker", "call", "base", "times as long", "95 % interval", "rounds"],
        verdict.turns,
        lambda row: [verdict.standing_of(row), row.label, row.call, row.base, *turns_texts(row)],
    )
    parts += ["\n".join(f"- {escaped(note)}" for note in verdict.notes)] if verdict.notes else []
    if unchanged := unchanged_labels(verdict):
        parts.append(f"Every count is as in the baseline: {', '.join(map(escaped, unchanged))}.")
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
        **{
            name: [_row_data(row, verdict.standing_of(row)) for row in getattr(verdict, name)]
            for name in ("rows", "below_best", "on_recordings", "recoveries", "speed", "turns")
        },
        "second_looks": [_second_data(look) for look in verdict.second_looks],
        "notes": list(verdict.notes),
    }


def _second_data(look: SecondLook) -> dict[str, Any]:
    """A worse row in both runs."""
    second = look.second and _row_data(look.second, look.second.verdict)
    return {"confirmed": look.confirmed, "first": _row_data(look.first, look.first.verdict), "second": second}


def _row_data(row: AnyRow, standing: Standing) -> dict[str, Any]:
    """The fields of a row; an infinite smallest fall is null."""
    values = {key: None if value == np.inf else value for key, value in asdict(row).items() if key != "verdict"}
    return {**values, "standing": standing}


def _section(title: str, headings: Sequence[str], rows: Sequence[Any], cells: Any) -> Iterator[str]:
    """A heading and a table; nothing if there are no rows."""
    if not rows:
        return
    yield f"### {title}"
    yield markdown_table(headings, [list(map(escaped, cells(row))) for row in rows[:MAX_TABLE_ROWS]]).rstrip("\n")
    if len(rows) > MAX_TABLE_ROWS:
        yield f"and {len(rows) - MAX_TABLE_ROWS} more"


def _row_cells(row: VerdictRow) -> list[str]:
    sizes = [amount_text(row, value) for value in (row.fall, row.smallest, row.margin)]
    values = [*score_texts(row), *sizes, number_text(row.spread)]
    return [row.label, row.name, row.stratum, band_text(row.band), *values]


def _speed_cells(row: SpeedRow) -> list[str]:
    return [row.label, row.call, row.reference, f"{row.ratio_baseline:.3g}", f"{row.ratio_run:.3g}"]


def _verdict_text(verdict: Verdict, row: VerdictRow) -> str:
    standing = verdict.standing_of(row)
    if row.criterion == "collapse":
        return f"{standing} (collapse)"
    return standing if row.verdict == "worse" or not row.recording else NO_COLLAPSE


def junit_of(verdict: Verdict) -> str:
    """A test case for each tracker, score, stratum and step band, for each collapse, each tracker with recoveries, and
    each speed. A worse row is a failure; the output has the smallest fall that would have been one."""
    rows, failures = verdict.decisive, len(verdict.worse)
    skipped = sum(row.verdict == "nothing to find" for row in rows)
    suite = junit_suite(SUITE, tests=len(rows), failures=failures, errors=0, skipped=skipped)
    for row in rows:
        case = junit_case(suite, row.label, _case_name(row))
        sentence = printable(f"{sentence_of(row)}{second_text(verdict, row)}")
        if verdict.standing_of(row) == "worse":
            ElementTree.SubElement(case, "failure", message=sentence)
        elif row.verdict == "nothing to find":
            ElementTree.SubElement(case, "skipped", message="no cell was occupied")
        if row.verdict != "nothing to find":
            ElementTree.SubElement(case, "system-out").text = sentence
    ElementTree.SubElement(suite, "system-out").text = printable("; ".join([rule_of(verdict), *verdict.notes]))
    return xml_of(suite)


def junit_of_unmeasured(reasons: Sequence[str]) -> str:
    """A test case with an error for each reason why nothing was measured."""
    suite = junit_suite(SUITE, tests=len(reasons), failures=0, errors=len(reasons), skipped=0)
    for number, reason in enumerate(reasons, 1):
        ElementTree.SubElement(junit_case(suite, "run", f"measured {number}"), "error", message=printable(reason))
    return xml_of(suite)


def _case_name(row: AnyRow) -> str:
    if isinstance(row, SpeedRow):
        return f"speed of {row.call}"
    if isinstance(row, TurnsRow):
        return f"speed of {row.call} in turns with {row.base}"
    if isinstance(row, RecoveryRow):
        return "recoveries"
    since = f" since {row.since}" if row.since else ""
    return f"{f'{row.recording}: ' if row.recording else ''}{row.name}, {place_of(row)}{since}"
