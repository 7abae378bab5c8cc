"""The setup of runs as lines of text, and the differences between the setups of several runs."""

from __future__ import annotations

import json
import shlex
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from gridtrack.reports.run import UNDEFINED, ReportedRun

MAX_PROVENANCE_LINES = 2000
"""Limit of the lines of run.json; the number of further lines is shown."""
OF_CARDS = "of the card of the weights, 0.5 without one"
"""The thresholds of a recording without a validation stretch."""
MAX_CHANGES = 200
"""Limit of the lines; the number of further lines is shown."""
DEFAULT = "default"
"""The value of an option that was not given."""
CODE_DIGITS = 12
"""Digits of a hash of a tracker's code."""
_OPTION = "options."
_OF_EVERY_RUN = ("started", "finished", "status", "settings.out")
_FIELDS_OF_TRACKERS = ("configuration.trials.", "weights.", "settings.trackers", "settings.recordings")
"""Fields that are compared by tracker and by recording."""


@dataclass(frozen=True)
class Fact:
    """One line of the setup or of run.json."""

    name: str
    value: str


def title_of(runs: Sequence[ReportedRun]) -> str:
    """The title of the page: the numbers of trackers and floors and the recording, or the names of the runs."""
    if len(runs) > 1:
        return " and ".join(run.name for run in runs) + " side by side"
    recordings = runs[0].recordings
    rows = [entry for entry in runs[0].summary.trackers.values() if not entry.ceiling]
    floors = sum(entry.floor for entry in rows)
    counts = ((len(rows) - floors, "tracker"), (floors, "floor"))
    named = " and ".join(f"{number} {name}{'s' * (number != 1)}" for number, name in counts if number)
    return f"{named} on {recordings[0] if len(recordings) == 1 else f'{len(recordings)} recordings'}"


def run_facts(run: ReportedRun, recordings: Collection[str]) -> tuple[Fact, ...]:
    """The run's share of `recordings`, its command, machine and versions, as far as its folder has them."""
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
    """JSON as lines, each named by its path below `prefix`; a list of words is a line in shell quoting."""
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


FieldTexts = Mapping[str, str]


@dataclass(frozen=True)
class Change:
    """One line that differs between runs, with its value in each run: DEFAULT for an option that was not given, a dash
    for another missing field."""

    name: str
    values: tuple[str, ...]


def changes_of(runs: Sequence[ReportedRun]) -> tuple[Change, ...]:
    """The differences between runs: missing rows and recordings, code and fields of trackers, other fields of run.json
    without times, and last the command. Raises RunError."""
    recordings = [run.recordings for run in runs]
    changes = [
        *_missing("trackers not in every run", [tuple(run.summary.trackers) for run in runs]),
        *_missing("recordings not in every run", recordings),
        *_of_code(runs),
        *_of_trackers(runs),
        *_differing([_other_fields(run, recordings) for run in runs]),
    ]
    changes.sort(key=lambda change: change.name == "command")
    if len(changes) > MAX_CHANGES:
        more = Change(f"{len(changes) - MAX_CHANGES} more lines", ("run.json",) * len(runs))
        changes[MAX_CHANGES:] = [more]
    return tuple(changes)


def _missing(name: str, of_runs: Sequence[Sequence[str]]) -> Iterator[Change]:
    """The names that are not in every run; nothing if all runs have the same."""
    in_every = set.intersection(*map(set, of_runs))
    values = tuple(", ".join(one for one in names if one not in in_every) or UNDEFINED for names in of_runs)
    if set(values) != {UNDEFINED}:
        yield Change(name, values)


def _of_code(runs: Sequence[ReportedRun]) -> Iterator[Change]:
    """A line for each tracker of every run, if its known code differs."""
    for label in _in_every(runs):
        of_runs = [run.code_of(label) for run in runs]
        if len({frozenset(codes) for codes in of_runs if codes}) > 1:
            shown = (", ".join(code[:CODE_DIGITS] for code in codes) or UNDEFINED for codes in of_runs)
            yield Change(f"code of {label}", tuple(shown))


def _in_every(runs: Sequence[ReportedRun]) -> Iterator[str]:
    """The labels in every run."""
    return (label for label in runs[0].summary.trackers if all(label in run.summary.trackers for run in runs))


def _differing(records: Sequence[FieldTexts]) -> Iterator[Change]:
    for name in dict.fromkeys(name for record in records for name in record):
        values = tuple(record.get(name, UNDEFINED) for record in records)
        if len(set(values)) > 1:
            yield Change(name, values)


def _of_trackers(runs: Sequence[ReportedRun]) -> list[Change]:
    """The fields of the trackers in every run, options first; trackers with equal differences share a line."""
    alike: dict[Change, list[str]] = {}
    for label in _in_every(runs):
        records = [_of_tracker(run, label) for run in runs]
        for change in _differing(records):
            alike.setdefault(_with_defaults(change, records), []).append(label)
    lines = sorted(alike.items(), key=lambda line: not line[0].name.startswith(_OPTION))
    return [Change(f"{', '.join(labels)}: {change.name}", change.values) for change, labels in lines]


def _with_defaults(change: Change, records: Sequence[FieldTexts]) -> Change:
    """A change of an option, with DEFAULT for runs without the option."""
    trackers = {record.get("tracker") for record in records}
    if not change.name.startswith(_OPTION) or len(trackers) > 1 or None in trackers:
        return change
    return Change(change.name, tuple(DEFAULT if value == UNDEFINED else value for value in change.values))


def _of_tracker(run: ReportedRun, label: str) -> FieldTexts:
    """The fields of a tracker's trials and weights; all values if they differ between recordings."""
    found: dict[str, dict[str, None]] = {}
    for trial in (f"{label}@{name}" for name in run.recordings):
        identity, weights = run.record.configuration.trials.get(trial), run.record.weights.get(trial)
        fields = {} if identity is None else identity.model_dump(mode="json")
        if weights is not None:
            fields["weights"] = weights.model_dump(mode="json")
        for fact in flattened("", fields):
            if fact.value != "{}":  # no options
                found.setdefault(fact.name, {})[fact.value] = None
    return {name: ", ".join(values) for name, values in found.items()}


def _other_fields(run: ReportedRun, recordings: Sequence[Sequence[str]]) -> FieldTexts:
    """The other lines of run.json, without recordings that another run lacks."""
    missing = {name for names in recordings for name in names if not all(name in other for other in recordings)}
    left_out = (*_FIELDS_OF_TRACKERS, *(f"configuration.recordings.{name}." for name in missing))
    lines = flattened("", run.record.model_dump(mode="json", by_alias=True))
    return {one.name: one.value for one in lines if one.name not in _OF_EVERY_RUN and not one.name.startswith(left_out)}
