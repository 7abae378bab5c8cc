"""Confirmation: worse rows are judged a second time, on a second run of the same trials."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

from gridtrack.evaluation.regression.judging import TypicalUnit, VerdictRow, judged_on, judged_row
from gridtrack.evaluation.regression.measurement import Baseline, MeasuredTrial, Measurement, Unmeasured
from gridtrack.evaluation.regression.pairing import require_paired
from gridtrack.evaluation.regression.recoveries import RecoveryRow, compare_recoveries
from gridtrack.evaluation.regression.rerun import Trials
from gridtrack.evaluation.regression.rows import PairedRow, paired_rows, row_tests
from gridtrack.evaluation.regression.settings import GateSettings
from gridtrack.evaluation.regression.speed import SpeedRow, TurnsRow, compare_speed
from gridtrack.evaluation.regression.verdict import AnyRow, SecondLook, Verdict
from gridtrack.evaluation.scores.registry import scores

RunAgain = Callable[[Trials, bool], Sequence[Measurement]]
"""Runs trials again; the second argument says whether to measure times."""


def confirmed(
    verdict: Verdict, baseline: Baseline, run: Measurement, settings: GateSettings, run_again: RunAgain
) -> Verdict:
    """`verdict` on `run`, in which a row stays worse only if it is worse in a second run of its trials too.

    The second test is corrected for the worse rows alone. Without a worse row nothing runs. Raises Unmeasured if the
    second run cannot be measured or has other frames.
    """
    suspects = verdict.worse
    if not suspects:
        return verdict
    timed = any(isinstance(row, SpeedRow) for row in suspects)
    second = _with_second(run, run_again(_trials_of(suspects, baseline), timed))
    require_paired(baseline, second)
    again = paired_rows(baseline, second, scores(settings.scores))
    judged = judged_again(suspects, again, settings, verdict.significance)
    judged += [row for row in compare_recoveries(baseline, second) if _key(row) in map(_key, suspects)]
    if timed:
        judged += compare_speed(baseline, second, settings.speed_reference, settings.ratio_margin)[0]
    by_key = {_key(row): row for row in judged}
    looks = tuple(SecondLook(row, by_key.get(_key(row))) for row in suspects)
    return replace(verdict, second_looks=looks)


def judged_again(
    suspects: Sequence[AnyRow], rows: Sequence[PairedRow], settings: GateSettings, enough_units: bool
) -> list[AnyRow]:
    """The scores among `suspects`, judged on the `rows` of the second run. The correction is for the suspects over all
    units."""
    by_name = {row.key: row for row in rows}
    scores = [row for row in suspects if isinstance(row, VerdictRow)]
    names = [(row.label, row.score, row.stratum, row.band) for row in scores]
    pooled = [by_name[name] for row, name in zip(scores, names, strict=True) if not row.recording]
    judged: list[AnyRow] = [
        judged_row(row, test, settings) for row, test in zip(pooled, row_tests(pooled), strict=True)
    ]
    for suspect, name in zip(scores, names, strict=True):
        if suspect.recording:
            row = by_name[name]
            judged.append(judged_on(row, suspect.recording, suspect.margin, TypicalUnit.of(row)))
    return judged


def _key(row: AnyRow) -> tuple[str, ...]:
    """Equal for the same row of both runs."""
    if isinstance(row, VerdictRow):
        return (row.label, row.score, row.stratum, row.band, row.recording)
    if isinstance(row, RecoveryRow):
        return (row.label, "recoveries")
    return (row.label, "turns" if isinstance(row, TurnsRow) else "speed", row.call)


def _trials_of(suspects: Sequence[AnyRow], baseline: Baseline) -> Trials:
    """The trials behind the suspects. A collapse needs all stretches of its source, because they are divided into units
    together."""
    recordings = baseline.first.recordings
    needed: dict[str, frozenset[str]] = {}
    for label, name in _labels_and_recordings(suspects):
        source = recordings[name].source_sha256 if name else ""
        own = frozenset(n for n, split in recordings.items() if not name or split.source_sha256 == source)
        needed[label] = needed.get(label, frozenset()) | own
    return needed


def _labels_and_recordings(suspects: Sequence[AnyRow]) -> Iterator[tuple[str, str]]:
    for row in suspects:
        yield row.label, row.recording if isinstance(row, VerdictRow) else ""
        if isinstance(row, SpeedRow):
            yield row.reference, ""


def _with_second(run: Measurement, again: Sequence[Measurement]) -> Measurement:
    """`run` with the scores, recoveries and times of the trials that ran again."""
    trackers = dict(run.trackers)
    for part in again:
        for label, name, trial in part.trials():
            first = trackers[label]
            if name in first.recordings:
                counts = first.recordings | {name: _second_trial(first.recordings[name], trial)}
                trackers[label] = first.model_copy(update={"recordings": counts})
    return run.model_copy(update={"trackers": trackers})


def _second_trial(first: MeasuredTrial, second: MeasuredTrial) -> MeasuredTrial:
    if first.weights_sha256 != second.weights_sha256:
        raise Unmeasured(["weights changed since the run: compare again"])
    update = {"units": second.units, "recoveries": second.recoveries, "speed": second.speed or first.speed}
    return first.model_copy(update=update)
