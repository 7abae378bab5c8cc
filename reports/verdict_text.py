"""The verdict of the regression gate in sentences, for a terminal, and its rows for other outputs."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from gridtrack.common.errors import printable
from gridtrack.evaluation.regression.judging import COLLAPSE, VerdictRow
from gridtrack.evaluation.regression.measurement import BANDS, Baseline
from gridtrack.evaluation.regression.recoveries import RecoveryRow
from gridtrack.evaluation.regression.rows import paired_rows
from gridtrack.evaluation.regression.speed import SpeedRow, TurnsRow
from gridtrack.evaluation.regression.verdict import AnyRow, Verdict
from gridtrack.evaluation.scores.registry import built_in
from gridtrack.evaluation.statistics.jackknife import ALPHA, LEAST_UNITS
from gridtrack.reports.run import UNDEFINED

MAX_FALLEN = 3
"""Largest number of lines on single recordings in the text."""
LEAST_DECIMALS, MOST_DECIMALS, LEAST_P = 4, 9, 0.0001
NO_COLLAPSE = "no collapse"
"""The standing of a change on one recording that does not decide."""
UNKNOWN_SPREAD = "the baseline has one run: the spread between trainings is unknown and not taken into account"


def text_of(verdict: Verdict) -> str:
    """The verdict for a terminal: worse rows, notes, the rule and the conclusion."""
    looked_at = [look.first for look in verdict.second_looks]
    lines = second_lines(verdict)
    lines += [f"worse: {sentence_of(row)}" for row in verdict.worse if row not in looked_at]
    fallen = [row for row in verdict.on_recordings if row.verdict != "worse"]
    lines += [f"change on one recording, {NO_COLLAPSE}: {sentence_of(row)}" for row in fallen[:MAX_FALLEN]]
    if len(fallen) > MAX_FALLEN:
        lines.append(f"change on one recording, {NO_COLLAPSE}: {len(fallen) - MAX_FALLEN} more, see --markdown")
    lines += [f"timed in turns: {sentence_of(row)}" for row in verdict.turns if row.verdict != "worse"]
    lines += [f"note: {note}" for note in verdict.notes]
    lines += [f"{label}: every count is as in the baseline" for label in unchanged_labels(verdict)]
    lines += _smallest_found(verdict)
    return "\n".join(map(printable, [*lines, rule_of(verdict), _conclusion(verdict)]))


def text_of_update(
    path: Path, baseline: Baseline, replaced: Verdict | str | None, since: Mapping[str, Sequence[VerdictRow]]
) -> str:
    """The new baseline of `--update`, for a terminal: its runs, and the range of F1 of each tracker over them.

    `replaced`: the verdict of the replaced baseline, if any, on the first run, or why there is none. `since`: scores
    against the `first` and the `best` entries of the history.
    """
    if len(baseline.runs) == 1:
        lines = [f"baseline: {path}; {UNKNOWN_SPREAD}"]
    else:
        lines = [f"baseline: {path}, of {len(baseline.runs)} runs", *_ranges_of(baseline)]
    return "\n".join(map(printable, [*_replaced_lines(replaced), *_lines_since(since), *lines]))


def _lines_since(since: Mapping[str, Sequence[VerdictRow]]) -> Iterator[str]:
    """The largest fall of each tracker since the first entry of a history, and since the best one."""
    for which, rows in since.items():
        for label in dict.fromkeys(row.label for row in rows):
            worst = max((row for row in rows if row.label == label), key=lambda row: row.severity)
            if worst.fall > 0:
                yield f"{label}, {place_of(worst)}: {_change_text(worst)}, its largest change to the worse"
            else:
                yield f"{label}: no score is worse than in the {which} entry of the history"


def _replaced_lines(replaced: Verdict | str | None) -> list[str]:
    if replaced is None:
        return []
    if isinstance(replaced, str):
        return [f"not compared with the baseline that it replaces: {replaced}"]
    worse = [f"worse than in the baseline that it replaces: {sentence_of(row)}" for row in replaced.worse]
    return worse or ["no worse than the baseline that it replaces"]


def _ranges_of(baseline: Baseline) -> Iterator[str]:
    """The largest difference in F1 between the runs of a baseline, by tracker."""
    rows = [row for row in paired_rows(baseline, baseline.first, built_in()) if row.key[1] == "f1.f1"]
    for label in baseline.first.trackers:
        own = (row for row in rows if row.label == label)
        ranges = {float(np.ptp(np.nan_to_num(row.value(row.trainings.sum(axis=1))))): row for row in own}
        widest = max(ranges)
        where = f"{ranges[widest].stratum}, {band_text(ranges[widest].band)}"
        yield (
            f"{label}: F1 differs by up to {widest:.4f} ({where})" if widest else f"{label}: F1 is the same in all runs"
        )


def sentence_of(row: AnyRow) -> str:
    """One row as a sentence."""
    if isinstance(row, VerdictRow):
        where = f" on {row.recording}" if row.recording else ""
        return f"{row.label}{where}, {place_of(row)}: {_change_text(row)}; {_limit_text(row)}"
    return f"{row.label}: {_change_text(row)}"


def second_text(verdict: Verdict, row: AnyRow) -> str:
    """The result of a second run for a worse row, to follow its sentence; empty without one."""
    for look in verdict.second_looks:
        if look.first == row:
            return f"; in a second run: {_change_text(look.second) if look.second else 'nothing of the kind'}"
    return ""


def _change_text(row: AnyRow) -> str:
    """The values of baseline and run in a row, without its tracker and its place."""
    if isinstance(row, SpeedRow):
        return (
            f"{row.call} takes {row.ratio_run:.3g} times as long as {row.reference}'s, in the baseline"
            f" {row.ratio_baseline:.3g}: {row.growth:+.0%}, margin {row.margin:.0%}"
        )
    if isinstance(row, TurnsRow):
        ratio, interval, rounds = turns_texts(row)
        return (
            f"{row.call} takes {ratio} times as long as {row.base}'s, in turns, 95 % interval {interval}"
            f" over {rounds} rounds, margin {row.margin:.0%}"
        )
    if isinstance(row, RecoveryRow):
        failures = f"{row.run} failure{'s' * (row.run != 1)}"
        return f"continued after {failures} inside it, in the baseline after {row.baseline}"
    significance = "" if row.p is None else f", p {p_digits(row.p)}"
    spread = "" if row.spread is None else f", spread between trainings {number_text(row.spread)}"
    then, now = score_texts(row)
    return (
        f"{row.name} {then} to {now}, "
        f"{_fall_text(row)}{f' since {row.since}' if row.since else ''}{significance}{spread}"
        f"{', a collapse' if row.criterion == 'collapse' else ''}"
    )


def _fall_text(row: VerdictRow) -> str:
    """The change in words; the `fall` of a log loss is a rise."""
    if not row.fall:
        return "no change"
    worse, better = _worse_and_better(row)
    return f"a {worse if row.fall > 0 else better} of {amount_text(row, abs(row.fall))}"


def _worse_and_better(row: VerdictRow) -> tuple[str, str]:
    """The words for a change to the worse and to the better."""
    return ("fall", "rise") if row.higher_is_better else ("rise", "fall")


def _limit_text(row: VerdictRow) -> str:
    """The smallest change that would have been worse, and the margin over all units if it differs."""
    worse, _ = _worse_and_better(row)
    where = " on one recording" if row.recording else ""
    if not np.isfinite(row.smallest):
        return _no_limit_text(row, worse, where)
    if not row.smallest:
        return f"any {worse} is worse"
    smallest, margin = amount_text(row, row.smallest), amount_text(row, row.margin)
    beside = "" if row.recording or margin == smallest else f" (margin {margin})"
    alike = ", alike in all units," if row.p is not None else ""
    return f"a {worse} of more than {smallest}{where}{alike} is worse{beside}"


def _no_limit_text(row: VerdictRow, worse: str, where: str) -> str:
    """Why no change of any size would have been found."""
    if row.higher_is_better and not row.baseline:
        return "no fall is possible"
    if row.verdict == "worse":
        return f"no {worse} alike in all units could be found"
    if row.higher_is_better and row.margin >= (row.baseline or 0.0):
        return f"no fall is beyond the margin of {amount_text(row, row.margin)}"
    return f"no {worse}{where} could be found with so few {'cells' if row.recording else 'units'}"


def second_lines(verdict: Verdict) -> list[str]:
    """Both results of each row that was worse in the first run."""
    return [
        f"{verdict.standing_of(look.first)}: {sentence_of(look.first)}{second_text(verdict, look.first)}"
        for look in verdict.second_looks
    ]


def place_of(row: VerdictRow) -> str:
    """The cells and the step band of a row."""
    return f"{row.stratum}, {band_text(row.band)}"


def _smallest_found(verdict: Verdict) -> list[str]:
    """For each tracker that is not worse, the smallest fall in F1 over all units that would have been worse: in the
    most and in the least sensitive row."""
    lines: list[str] = []
    if not verdict.significance:
        return lines
    worse = {row.label for row in verdict.worse}
    for label in dict.fromkeys(row.label for row in verdict.rows):
        found = [r for r in verdict.rows if (r.label, r.score) == (label, "f1.f1") and r.verdict != "nothing to find"]
        if label in worse or not found:
            continue
        best, worst = (choose(found, key=lambda row: row.smallest) for choose in (min, max))
        if not np.isfinite(best.smallest):
            lines.append(f"{label}: this baseline could not have shown any fall in F1")
            continue
        sizes = [f"{amount_text(row, row.smallest)} ({place_of(row)})" for row in (best, worst)]
        alike = amount_text(best, best.smallest) == amount_text(worst, worst.smallest)
        range_text = sizes[0] if alike else f"{sizes[0]} at best, {sizes[1]} at worst"
        lines.append(f"{label}: the smallest fall in F1 that this baseline could have shown: {range_text}")
    return lines


def band_text(band: str) -> str:
    """The horizons of a step band."""
    if band not in BANDS:
        return band
    low, high = BANDS[band]
    return f"over {low:g} s" if high >= 60.0 else f"{low:g} to {high:g} s"


def rule_of(verdict: Verdict) -> str:
    """The rule of the verdict, in one line."""
    judged = sum(row.verdict != "nothing to find" for row in verdict.rows)
    over = f"{judged} comparisons over {verdict.units} paired unit{'s' if verdict.units != 1 else ''}"
    collapse = f"or one of more than {COLLAPSE:g} margins on one recording, beyond the noise"
    if verdict.significance:
        trainings = (
            UNKNOWN_SPREAD
            if verdict.trainings == 1
            else f"the spread between trainings is from the {verdict.trainings} runs of the baseline"
        )
        return (
            f"{over}: worse is a change beyond the margin with p of at most {ALPHA:g}, corrected for all comparisons,"
            f" {collapse}; {trainings}"
        )
    return (
        f"{over}, too few for significance, which needs {LEAST_UNITS}: worse is a change beyond the margin or the"
        f" tracker's tolerance, which are 0 unless given, {collapse}; {UNKNOWN_SPREAD}"
    )


def _conclusion(verdict: Verdict) -> str:
    if not verdict.worse:
        return "no worse than the baseline"
    labels = sorted({row.label for row in verdict.worse})
    return f"worse than the baseline: {', '.join(labels)}"


def unchanged_labels(verdict: Verdict) -> list[str]:
    """The trackers with exactly the counts of the baseline."""
    changed = {row.label for row in verdict.rows if row.verdict in {"worse", "no worse"}}
    return [label for label in dict.fromkeys(row.label for row in verdict.rows) if label not in changed]


def turns_texts(row: TurnsRow) -> list[str]:
    """The ratio of the times in turns, its interval, and the number of rounds."""
    return [f"{row.ratio:.3f}", f"[{row.low:.3f}, {row.high:.3f}]", f"{row.rounds}"]


def amount_text(row: VerdictRow, value: float) -> str:
    """A change in the unit of margins: of F1, or a share of a log loss; `none` if it is infinite."""
    if not np.isfinite(value):
        return "none"
    return f"{value:.{_decimals(value * 100, 1)}%}" if row.relative else number_text(value)


def score_texts(row: VerdictRow) -> tuple[str, str]:
    """The score in the baseline and in the run, with enough digits to show their difference."""
    values = row.baseline, row.run
    difference = 0.0 if row.baseline is None or row.run is None else row.run - row.baseline
    then, now = (UNDEFINED if one is None else f"{one:.{_decimals(difference, LEAST_DECIMALS)}f}" for one in values)
    return then, now


def number_text(value: float | None) -> str:
    """A number with two digits or more."""
    return UNDEFINED if value is None else f"{value:.{_decimals(value, LEAST_DECIMALS)}f}"


def p_digits(p: float) -> str:
    """A p-value."""
    return f"{p:.4f}" if p >= LEAST_P else f"< {LEAST_P}"


def _decimals(value: float, least: int) -> int:
    """Decimals that show two digits of `value`; at least `least`, and not more than MOST_DECIMALS."""
    return min(max(least, 1 - math.floor(math.log10(abs(value)))), MOST_DECIMALS) if value else least
