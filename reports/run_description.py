"""The setup of a run as lines of text."""

from __future__ import annotations

import json
import shlex
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from gridtrack.reports.run import ReportedRun

MAX_PROVENANCE_LINES = 2000
"""Lines of run.json beyond this number are counted and not shown."""
OF_CARDS = "of the card of the weights, 0.5 without one"
"""The thresholds of a recording without a validation stretch."""


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


def facts_of(run: ReportedRun, recordings: Collection[str]) -> tuple[Fact, ...]:
    """The run's own of `recordings`, its command, machine and versions, as far as its folder holds them."""
    facts = [Fact(f"recording {name}", _recording(run, name)) for name in run.recordings if name in recordings]
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
        f"thresholds {f'chosen on {recording.validation}' if recording.validation else OF_CARDS}",
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
