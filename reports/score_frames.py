"""The results of a run as polars frames, for notebooks and for tables in CSV."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import polars as pl

from gridtrack.evaluation.runs.summary import HeadlineTest, RunSummary, StratumScores
from gridtrack.reports.run import with_pooled

SCORES = tuple(name for name in StratumScores.model_fields if name != "interval")
"""Names of the scores in a stratum, with the ends of their intervals."""


def score_frame(summary: RunSummary) -> pl.DataFrame:
    """Every score, a row for each recording, tracker, stratum and step; those pooled are of "all recordings"."""
    keys = {"recording": pl.String, "tracker": pl.String, "outcome": pl.String, "stratum": pl.String}
    schema = {**keys, "step": pl.Int64, "horizon_s": pl.Float64, **dict.fromkeys(SCORES, pl.Float64)}
    return pl.DataFrame(list(_score_rows(summary)), schema=schema, orient="row")


def _score_rows(summary: RunSummary) -> Iterator[tuple[Any, ...]]:
    shown = with_pooled(summary) if summary.has_pooled else summary
    for label, row in shown.trackers.items():
        for recording, trial in row.recordings.items():
            for stratum, scores in trial.strata.items():
                for step, horizon_s in enumerate(shown.recordings[recording].horizons_s):
                    values = (scores.at(name, step) for name in SCORES)
                    yield recording, label, trial.outcome, stratum, step, horizon_s, *values


def difference_frame(summary: RunSummary) -> pl.DataFrame:
    """The tests of the headline, a row each: a tracker against the reference on a recording, or on all."""
    keys = {"recording": pl.String, "tracker": pl.String, "reference": pl.String, "units": pl.Int64}
    texts, steps = ("stratum", "verdict"), ("step",)
    columns = {
        name: pl.String if name in texts else pl.Int64 if name in steps else pl.Float64
        for name in HeadlineTest.model_fields
    }
    rows = [
        (one.recordings, one.tracker, one.reference, one.units, *(getattr(test, name) for name in columns))
        for one in summary.differences
        for test in one.headline
    ]
    return pl.DataFrame(rows, schema={**keys, **columns}, orient="row")
