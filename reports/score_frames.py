"""The results of a run as polars frames, for notebooks."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import polars as pl

from gridtrack.evaluation.runs.summary import PointEstimate, RunSummary
from gridtrack.reports.run import output_name, shown_summary


def score_frame(summary: RunSummary) -> pl.DataFrame:
    """Every score, a row for each recording, tracker, stratum and step; of all recordings pooled "all recordings".

    A column for each output, `f1` or `f1.recall`, and `... low` and `... high` for the ends of its interval.
    """
    shown = shown_summary(summary)
    keys = {"recording": pl.String, "tracker": pl.String, "outcome": pl.String, "stratum": pl.String}
    names = [output_name(*one) for one in shown.outputs]
    values = {f"{name}{end}": pl.Float64 for name in names for end in ("", " low", " high")}
    schema = {**keys, "step": pl.Int64, "horizon_s": pl.Float64, **values}
    return pl.DataFrame(list(_score_rows(shown)), schema=schema, orient="row")


def _score_rows(shown: RunSummary) -> Iterator[tuple[Any, ...]]:
    keys = [(score.name, output.name) for score, output in shown.outputs]
    for label, row in shown.trackers.items():
        for recording, trial in row.recordings.items():
            for stratum in trial.strata:
                for step, horizon_s in enumerate(shown.recordings[recording].horizons_s):
                    points = (trial.at(stratum, *key, step) for key in keys)
                    values = (value for one in points for value in (one.value, one.low, one.high))
                    yield recording, label, trial.outcome, stratum, step, horizon_s, *values


def difference_frame(summary: RunSummary) -> pl.DataFrame:
    """The headline tests, a row each: a tracker against the reference on a recording, or on all.

    Columns: `recording`, `tracker`, `reference`, `units`, `stratum`, `horizon_s`, `step`, `p_holm` and `verdict` of the
    headline score, and of each tested output the difference, `... low`, `... high` and its uncorrected `... p`.
    """
    tested = [(score, output) for score, output in summary.outputs if output.tested]
    texts = ("recording", "tracker", "reference", "stratum", "verdict")
    columns = ("recording", "tracker", "reference", "units", "stratum", "horizon_s", "step", "p_holm", "verdict")
    schema: dict[str, Any] = {
        name: pl.String if name in texts else pl.Int64 if name in ("units", "step") else pl.Float64 for name in columns
    }
    schema |= {f"{output_name(*one)}{end}": pl.Float64 for one in tested for end in ("", " low", " high", " p")}
    rows = [
        (
            *(one.recordings, one.tracker, one.reference, one.units),
            *(test.stratum, test.horizon_s, test.step, test.p_holm, test.verdict),
            *_values(one.at(test.stratum, score.name, output.name, test.step) for score, output in tested),
        )
        for one in summary.differences
        for test in one.tests
    ]
    return pl.DataFrame(rows, schema=schema, orient="row")


def _values(points: Iterable[PointEstimate]) -> Iterator[float | None]:
    for one in points:
        yield from (one.value, one.low, one.high, one.p)
