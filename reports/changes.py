"""What differs between the records of several runs, a line for each difference: trackers and their options first."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from gridtrack.reports.run import UNDEFINED, ReportedRun
from gridtrack.reports.run_description import flattened

MAX_CHANGES = 200
"""Lines beyond this number are counted and not shown."""
DEFAULT = "default"
"""The value of an option that was not given: a run's folder does not have it."""
CODE_DIGITS = 12
"""Of a hash of a tracker's code."""
_OPTION = "options."
_OF_EVERY_RUN = ("started", "finished", "status", "settings.out")
_TOLD_OF_TRACKERS = ("configuration.trials.", "weights.", "settings.trackers", "settings.recordings")
"""What is compared by tracker and by recording."""

FieldTexts = Mapping[str, str]


@dataclass(frozen=True)
class Change:
    """One line in which runs differ: its value in each run, DEFAULT for an option that a run leaves out, a dash for
    what else it does not have."""

    name: str
    values: tuple[str, ...]


def changes_of(runs: Sequence[ReportedRun]) -> tuple[Change, ...]:
    """What differs and nothing else: rows and recordings that a run lacks, code and fields of trackers, then all
    else of run.json but the command, and the command; times of the runs are left out. Raises RunError."""
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
    """The names that not every run has; none where all have the same."""
    in_every = set.intersection(*map(set, of_runs))
    values = tuple(", ".join(one for one in names if one not in in_every) or UNDEFINED for names in of_runs)
    if set(values) != {UNDEFINED}:
        yield Change(name, values)


def _of_code(runs: Sequence[ReportedRun]) -> Iterator[Change]:
    """The trackers that every run has and whose known code is not the same in all; a line for each."""
    for label in _in_every(runs):
        of_runs = [run.code_of(label) for run in runs]
        if len({frozenset(codes) for codes in of_runs if codes}) > 1:
            shown = (", ".join(code[:CODE_DIGITS] for code in codes) or UNDEFINED for codes in of_runs)
            yield Change(f"code of {label}", tuple(shown))


def _in_every(runs: Sequence[ReportedRun]) -> Iterator[str]:
    """The labels that every run has."""
    return (label for label in runs[0].summary.trackers if all(label in run.summary.trackers for run in runs))


def _differing(records: Sequence[FieldTexts]) -> Iterator[Change]:
    for name in dict.fromkeys(name for record in records for name in record):
        values = tuple(record.get(name, UNDEFINED) for record in records)
        if len(set(values)) > 1:
            yield Change(name, values)


def _of_trackers(runs: Sequence[ReportedRun]) -> list[Change]:
    """The fields of the trackers that every run has, options first; trackers that differ alike share a line."""
    alike: dict[Change, list[str]] = {}
    for label in _in_every(runs):
        records = [_of_tracker(run, label) for run in runs]
        for change in _differing(records):
            alike.setdefault(_with_defaults(change, records), []).append(label)
    lines = sorted(alike.items(), key=lambda line: not line[0].name.startswith(_OPTION))
    return [Change(f"{', '.join(labels)}: {change.name}", change.values) for change, labels in lines]


def _with_defaults(change: Change, records: Sequence[FieldTexts]) -> Change:
    """A change of an option, which has its default in a run that did not give it to the same tracker."""
    trackers = {record.get("tracker") for record in records}
    if not change.name.startswith(_OPTION) or len(trackers) > 1 or None in trackers:
        return change
    return Change(change.name, tuple(DEFAULT if value == UNDEFINED else value for value in change.values))


def _of_tracker(run: ReportedRun, label: str) -> FieldTexts:
    """The fields of a tracker's trials and weights; where they differ between recordings, all values."""
    found: dict[str, dict[str, None]] = {}
    for trial in (f"{label}@{name}" for name in run.recordings):
        identity, weights = run.record.configuration.trials.get(trial), run.record.weights.get(trial)
        fields = {} if identity is None else identity.model_dump(mode="json")
        if weights is not None:
            fields["weights"] = weights.model_dump(mode="json")
        for fact in flattened("", fields):
            if fact.value != "{}":  # no options: the same as none that are told
                found.setdefault(fact.name, {})[fact.value] = None
    return {name: ", ".join(values) for name, values in found.items()}


def _other_fields(run: ReportedRun, recordings: Sequence[Sequence[str]]) -> FieldTexts:
    """The other lines of run.json; of recordings that every run has."""
    missing = {name for names in recordings for name in names if not all(name in other for other in recordings)}
    left_out = (*_TOLD_OF_TRACKERS, *(f"configuration.recordings.{name}." for name in missing))
    lines = flattened("", run.record.model_dump(mode="json", by_alias=True))
    return {one.name: one.value for one in lines if one.name not in _OF_EVERY_RUN and not one.name.startswith(left_out)}
