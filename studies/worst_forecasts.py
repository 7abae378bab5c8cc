"""Worst forecasts: pictures of the forecasts of cells in motion with the least F1, for each tracker of a run.

`python -m studies.worst_forecasts RUN` (some seconds) reads a run and writes RUN/worst-forecasts.html: for each
tracker the kept frames with the least F1 in motion one second ahead, of equal ones those with the most cells, at most
one of a recording and only frames with enough cells in motion; the input, the observed frame, the forecast, and the
forecast at its threshold: hit, missed, false alarm.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from html import escape
from pathlib import Path

import numpy as np

from gridtrack.common.grid import nearest_step
from gridtrack.evaluation.referee.samples import SAMPLES, Sample, read_samples
from gridtrack.evaluation.results.columns import SCORES_TABLE
from gridtrack.reports.moments import FrameScore, frame_scores
from gridtrack.reports.pictures import frame_png, probability_png
from gridtrack.reports.run import ReportedRun, read_runs
from gridtrack.reports.table import MAIN_STRATUM

HORIZON_S = 1.0
ENOUGH_CELLS = 20
SHOWN = 4
SIDE = 260
COLOURS = {"hit": "#1a1a1a", "missed": "#d81b60", "false alarm": "#1e88e5"}


@dataclass(frozen=True)
class Failure:
    """The forecast of one tracker at one frame of one recording, and the threshold that applies to it."""

    recording: str
    scored: FrameScore
    sample: Sample
    threshold: float


def worst(run: ReportedRun, label: str) -> list[Failure]:
    """The worst kept frame of each recording, the SHOWN worst of these."""
    found: list[Failure] = []
    for recording, trial in run.summary.trackers[label].recordings.items():
        if run.is_pooled(recording) or MAIN_STRATUM not in trial.strata:
            continue
        step = nearest_step(HORIZON_S, run.summary.recordings[recording].period_s)
        folder = run.trial_folder(label, recording)
        scores = frame_scores(folder / SCORES_TABLE.file, [step])[step]
        scored = {stamp: score for stamp, score in scores.items() if score.occupied >= ENOUGH_CELLS}
        kept = [sample for sample in read_samples(folder / SAMPLES) if sample.stamp_ns in scored]
        if kept:
            sample = min(kept, key=lambda one: badness(scored[one.stamp_ns]))
            found.append(
                Failure(recording, scored[sample.stamp_ns], sample, trial.strata[MAIN_STRATUM].threshold[step] or 1)
            )
    return sorted(found, key=lambda failure: badness(failure.scored))[:SHOWN]


def badness(scored: FrameScore) -> tuple[float, int]:
    """Less is worse: the F1, then the more cells."""
    return scored.f1, -scored.occupied


def compared_cells(failure: Failure) -> Iterator[str]:
    """Every visible cell that is forecast above the threshold, or was observed occupied."""
    sample, h = failure.sample, failure.sample.horizons_s.index(HORIZON_S)
    above = (sample.forecast[h] >= failure.threshold) & sample.observed_visible[h]
    observed, size = sample.observed_occupied[h], sample.grid.size
    for kind, where in (("hit", above & observed), ("missed", observed & ~above), ("false alarm", above & ~observed)):
        rows, columns = np.nonzero(where)
        squares = "".join(f"M{c} {size - 1 - r}h1v1h-1z" for r, c in zip(rows, columns, strict=True))
        yield f'<path d="{squares}" fill="{COLOURS[kind]}"/>'


def pictures(failure: Failure) -> str:
    """Input, observed frame, forecast, and the forecast's hits and errors, side by side."""
    sample, h = failure.sample, failure.sample.horizons_s.index(HORIZON_S)
    nothing = np.zeros_like(sample.visible)
    ground = frame_png(sample.observed_visible[h], nothing)
    images = (
        frame_png(sample.visible, sample.occupied),
        frame_png(sample.observed_visible[h], sample.observed_occupied[h]),
        probability_png(sample.forecast[h]),
    )
    size = sample.grid.size
    below = f'style="background:url({ground}) 0 0/100% 100%"'
    errors = f'<svg viewBox="0 0 {size} {size}" {below}>{"".join(compared_cells(failure))}</svg>'
    shown = "".join(f'<img src="{image}">' for image in images) + errors
    scored = failure.scored
    return (
        f"<h3>{escape(failure.recording)}, {sample.stamp_ns / 1e9:.2f} s: F1 in motion {scored.f1:.2f}"
        f" ({scored.tp} hit, {scored.fn} missed, {scored.fp} false)</h3><div>{shown}</div>"
    )


def failures_page(run: ReportedRun, labels: list[str]) -> str:
    style = (
        f"body{{font-family:sans-serif;margin:1em}} img,svg{{width:{SIDE}px;height:{SIDE}px;image-rendering:pixelated;"
        "border:1px solid #999;margin-right:8px} h3{font-weight:normal;margin:.6em 0 .2em}"
    )
    key = ", ".join(f'<b style="color:{colour}">{kind}</b>' for kind, colour in COLOURS.items())
    head = (
        f"<p>Input; the frame observed {HORIZON_S:g} s later; its forecast; the forecast at its threshold: {key}.</p>"
    )
    parts = []
    for label in labels:
        failures = worst(run, label)
        parts.append(f"<h2>{escape(label)}</h2>" + "".join(map(pictures, failures)))
        for failure in failures:
            scored = failure.scored
            at_s = failure.sample.stamp_ns / 1e9
            print(
                f"{label:20} {failure.recording:12} {at_s:8.2f} s  F1 {scored.f1:.2f}  {scored.occupied} occupied cells"
            )
    return f"<!doctype html><meta charset=utf-8><style>{style}</style>{head}{''.join(parts)}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("run", type=Path)
    (run,) = read_runs([parser.parse_args().run])
    labels = [label for label, entry in run.summary.trackers.items() if not entry.ceiling]
    (run.path / "worst-forecasts.html").write_text(failures_page(run, labels))


if __name__ == "__main__":
    main()
