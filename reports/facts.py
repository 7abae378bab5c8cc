"""What was compared, and what came of it in one sentence: the words at the top of the page."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from gridtrack.reports.run import Run
from gridtrack.reports.table import Cell, HeadlineTable, Row

MAX_LINES = 2000
"""Of provenance; what is beyond is counted, and stands in run.json."""


@dataclass(frozen=True)
class Fact:
    """One line of what was compared."""

    name: str
    value: str


def title_of(runs: Sequence[Run]) -> str:
    """What the page is of: how many trackers on which recording, or which runs."""
    if len(runs) > 1:
        return " and ".join(run.name for run in runs) + " side by side"
    summary = runs[0].summary
    recordings = [name for name, recording in summary.recordings.items() if not recording.pooled]
    rows = sum(not entry.ceiling for entry in summary.trackers.values())
    trackers = f"{rows} tracker{'s' * (rows != 1)}"
    return f"{trackers} on {recordings[0] if len(recordings) == 1 else f'{len(recordings)} recordings'}"


def lead_of(table: HeadlineTable) -> str:
    """The finding in a sentence: the best tracker on moving cells against the best of the floor; empty without one."""
    if not table.comparable:
        return ""
    at = table.columns.index(table.decisive)
    best, floor = (_best(table.standing(standing), at) for standing in ("ranked", "floor"))
    heading = table.decisive.heading
    if best is None:
        return _why_no_best(table)
    if floor is not None and _value(best[1]) <= _value(floor[1]):
        return (
            f"No tracker beats the floor on moving cells {heading} ahead: {floor[0].name} has an F1 of {floor[1].text},"
            f" the best tracker, {best[0].name}, {best[1].text}."
        )
    lead = f"{best[0].name} forecasts moving cells {heading} ahead best, with an F1 of {best[1].text}"
    if floor is None:
        return lead + "; no floor was run with it."
    return f"{lead}; the best of the floor, {floor[0].name}, has {floor[1].text}."


def _why_no_best(table: HeadlineTable) -> str:
    """What is true where no tracker has a score to be ranked by."""
    if table.standing("ranked"):
        return (
            f"No tracker has an F1 on moving cells {table.decisive.heading} ahead on {table.recording}: none of"
            " them was occupied in the frames that came."
        )
    if table.standing("apart"):
        return f"No tracker finished on {table.recording}."
    return f"Only the floor was run on {table.recording}."


def _best(rows: Sequence[Row], at: int) -> tuple[Row, Cell] | None:
    defined = [(row, row.cells[at]) for row in rows if row.cells[at].value is not None]
    return max(defined, key=lambda pair: _value(pair[1]), default=None)


def _value(cell: Cell) -> float:
    return -1.0 if cell.value is None else cell.value


def facts_of(run: Run) -> tuple[Fact, ...]:
    """What was compared, on what, by which command, as far as the run's folder tells."""
    recordings = [name for name, recording in run.summary.recordings.items() if not recording.pooled]
    facts = [Fact(f"recording {name}", _recording(run, name)) for name in recordings]
    command = run.provenance.get("command")
    if command:
        facts.append(Fact("command", shlex.join(map(str, command)) if isinstance(command, list) else str(command)))
    machine, versions = (run.provenance.get(name) for name in ("machine", "versions"))
    if isinstance(machine, Mapping):
        units = {"cores": " cores", "memory_gb": " GB memory"}
        facts.append(Fact("machine", ", ".join(f"{value}{units.get(key, '')}" for key, value in machine.items())))
    if isinstance(versions, Mapping):
        facts.append(Fact("versions", ", ".join(f"{name} {version}" for name, version in versions.items())))
    return tuple(facts)


def _recording(run: Run, name: str) -> str:
    recording = run.summary.recordings[name]
    parts = (
        recording.stretch,
        f"site {recording.site}" if recording.site else "",
        f"{recording.frames} frames at {1 / recording.period_s:.3g} Hz",
        f"the first {recording.warm_up_frames} to warm up",
        f"forecasts {recording.horizons_s[-1]:.3g} s ahead"
        + (f" at every {n} frames" if (n := recording.forecast_every_frames) > 1 else " at every frame"),
        f"grid {recording.grid}",
        f"thresholds chosen on {recording.validation}" if recording.validation else "thresholds 0.5, chosen on nothing",
    )
    return "; ".join(filter(None, parts))


def provenance_of(run: Run) -> tuple[Fact, ...]:
    """run.json line by line."""
    lines = list(_flat("", run.provenance))
    if len(lines) > MAX_LINES:
        lines[MAX_LINES:] = [Fact("…", f"{len(lines) - MAX_LINES} more lines stand in run.json")]
    return tuple(lines)


def _flat(prefix: str, value: Any) -> Iterator[Fact]:
    if isinstance(value, Mapping) and value:
        for key, inner in value.items():
            yield from _flat(f"{prefix}.{key}" if prefix else str(key), inner)
    elif isinstance(value, list) and any(isinstance(inner, dict | list) for inner in value):
        for i, inner in enumerate(value):
            yield from _flat(f"{prefix}[{i}]", inner)
    else:
        yield Fact(prefix, value if isinstance(value, str) else json.dumps(value, ensure_ascii=False))
