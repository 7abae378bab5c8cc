"""The setup of a run as lines of text, and its main result in one sentence."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from gridtrack.reports.run import ReportedRun
from gridtrack.reports.table import HeadlineTable, TableRow

MAX_PROVENANCE_LINES = 2000
"""Lines of run.json beyond this number are counted and not shown."""


@dataclass(frozen=True)
class Fact:
    """One line of the setup or of run.json."""

    name: str
    value: str


def title_of(runs: Sequence[ReportedRun]) -> str:
    """The title of the page: the number of trackers and the recording, or the names of the runs."""
    if len(runs) > 1:
        return " and ".join(run.name for run in runs) + " side by side"
    recordings = runs[0].recordings
    rows = sum(not entry.ceiling for entry in runs[0].summary.trackers.values())
    trackers = f"{rows} tracker{'s' * (rows != 1)}"
    return f"{trackers} on {recordings[0] if len(recordings) == 1 else f'{len(recordings)} recordings'}"


def lead_of(table: HeadlineTable) -> str:
    """The main result in a sentence: the highest score in the decisive column, and the floor's; empty if rows do not
    compare.

    No tracker is called the best: the paired differences decide whether a difference is significant.
    """
    if not table.comparable:
        return ""
    at = table.columns.index(table.decisive)
    ranked, floor = (_highest(table.rows_in(group), at) for group in ("ranked", "floor"))
    ahead = f"{table.decisive.stratum} cells {table.decisive.heading} ahead"
    if not ranked:
        return _why_no_result(table)
    a_score = _with_article(table.decisive.score_name)
    value, of_floor = ranked[0].cells[at].text, floor[0].cells[at].text if floor else ""
    if not max(float(value), float(of_floor or 0.0)):
        return f"On {ahead} every tracker has {a_score} of {value}."
    alone = len(table.rows_in("ranked")) == 1
    if floor and float(value) <= float(of_floor):
        highest = _names(ranked) if alone else f"the highest of the trackers, {_names(ranked)},"
        best = f"{_names(floor)} at {a_score} of {of_floor}, {highest} at {value}"
        return f"No tracker beats the floor on {ahead}: {best}."
    against = f"the floor, {_names(floor)}, reaches {of_floor}" if floor else "no tracker of the floor was run"
    if alone:
        return f"{ranked[0].name} has {a_score} of {value} on {ahead}; {against}."
    have, each = ("have", " each") if len(ranked) > 1 else ("has", "")
    return f"{_names(ranked)} {have} the highest {table.decisive.score_name} on {ahead}, {value}{each}; {against}."


def _with_article(score: str) -> str:
    return f"{'an' if score == 'F1' else 'a'} {score}"


def _why_no_result(table: HeadlineTable) -> str:
    """The result where no tracker has a score to be ranked by."""
    if table.rows_in("ranked"):
        return (
            f"No tracker has {_with_article(table.decisive.score_name)} on {table.decisive.stratum} cells"
            f" {table.decisive.heading} ahead on {table.recording}: no such cell was occupied in the observed frames."
        )
    if any(row.trial.complete for row in table.rows_in("unranked")):
        return f"No tracker is ranked on {table.recording}: each learned from its frames, or did not complete it."
    if table.rows_in("unranked"):
        return f"No tracker completed {table.recording}."
    return f"Only trackers of the floor were run on {table.recording}."


def _highest(rows: Sequence[TableRow], at: int) -> tuple[TableRow, ...]:
    """The rows with the highest score in the column `at`, to the digits shown; none where no row has one."""
    defined = [row for row in rows if row.cells[at].value is not None]
    top = max((row.cells[at].text for row in defined), key=float, default="")
    return tuple(row for row in defined if row.cells[at].text == top)


def _names(rows: Sequence[TableRow]) -> str:
    names = [row.name for row in rows]
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def facts_of(run: ReportedRun) -> tuple[Fact, ...]:
    """The recordings, command, machine and versions of a run, as far as its folder holds them."""
    facts = [Fact(f"recording {name}", _recording(run, name)) for name in run.recordings]
    record = run.record
    if record.command:
        facts.append(Fact("command", shlex.join(record.command)))
    if (machine := record.machine) is not None:
        cores = f"{machine.cores} core{'s' if machine.cores != 1 else ''}"
        size = f"{cores}, {machine.memory_gb:g} GB memory"
        facts.append(Fact("machine", f"{machine.cpu}, {size}, {machine.system}"))
    if record.versions:
        facts.append(Fact("versions", ", ".join(f"{name} {version}" for name, version in record.versions.items())))
    return tuple(facts)


def _recording(run: ReportedRun, name: str) -> str:
    recording = run.summary.recordings[name]
    items = (
        recording.stretch,
        f"site {recording.site}" if recording.site else "",
        f"{recording.frames} frames at {1 / recording.period_s:.3g} Hz",
        f"the first {recording.warm_up_frames} are warm-up",
        f"forecasts {recording.horizons_s[-1]:.3g} s ahead"
        + (f", every {n} frames" if (n := recording.forecast_every_frames) > 1 else ", every frame"),
        f"grid {recording.grid}",
        f"thresholds chosen on {recording.validation}" if recording.validation else "thresholds of the cards, else 0.5",
    )
    return "; ".join(filter(None, items))


def provenance_of(run: ReportedRun) -> tuple[Fact, ...]:
    """run.json as lines of key and value."""
    lines = list(flattened("", run.record.model_dump(mode="json", by_alias=True)))
    if len(lines) > MAX_PROVENANCE_LINES:
        lines[MAX_PROVENANCE_LINES:] = [Fact("…", f"{len(lines) - MAX_PROVENANCE_LINES} more lines in run.json")]
    return tuple(lines)


def flattened(prefix: str, value: Any) -> Iterator[Fact]:
    """JSON as lines, each named by its path below `prefix`; a list of words is a line as a shell reads it."""
    if isinstance(value, Mapping) and value:
        for key, inner in value.items():
            yield from flattened(f"{prefix}.{key}" if prefix else str(key), inner)
    elif isinstance(value, list) and any(isinstance(inner, dict | list) for inner in value):
        for i, inner in enumerate(value):
            yield from flattened(f"{prefix}[{i}]", inner)
    elif isinstance(value, list) and value and all(isinstance(inner, str) for inner in value):
        yield Fact(prefix, shlex.join(value))
    else:
        yield Fact(prefix, value if isinstance(value, str) else json.dumps(value, ensure_ascii=False))
