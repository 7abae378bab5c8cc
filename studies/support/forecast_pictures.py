"""A drawing of kept forecasts: a row for each sample with the input, the frame observed later, and each forecast."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path

from gridtrack.evaluation.referee.samples import SAMPLES, Sample, read_samples
from gridtrack.reports.figures import document
from gridtrack.reports.pictures import frame_png, probability_png
from gridtrack.reports.run import ReportedRun

SIDE, GAP, TITLE = 200, 8, 16


def forecast_pictures(run: ReportedRun, trackers: Sequence[str], numbers: Sequence[int], horizon_s: float) -> str:
    """An SVG of the kept samples with these `numbers` of a run's only recording, as `trackers` forecast them."""
    kept = {name: list(read_samples(_folder(run, name) / SAMPLES)) for name in trackers}
    parts = []
    for row, number in enumerate(numbers):
        samples = {name: found[number] for name, found in kept.items()}
        top = row * (SIDE + GAP) + TITLE
        for column, (title, image) in enumerate(_images(samples, horizon_s).items()):
            left = column * (SIDE + GAP)
            if not row:
                parts.append(f'<text x="{left}" y="{TITLE - 4}">{escape(title)}</text>')
            parts.append(
                f'<image x="{left}" y="{top}" width="{SIDE}" height="{SIDE}" href="{image}"'
                ' style="image-rendering:pixelated"/>'
                f'<rect x="{left}" y="{top}" width="{SIDE}" height="{SIDE}" fill="none" stroke="#999"/>'
            )
    columns = 2 + len(trackers)
    return document(columns * (SIDE + GAP), len(numbers) * (SIDE + GAP) + TITLE, parts, 12)


def _folder(run: ReportedRun, tracker: str) -> Path:
    (recording,) = run.summary.trackers[tracker].recordings
    return run.trial_folder(tracker, recording)


def _images(samples: dict[str, Sample], horizon_s: float) -> dict[str, str]:
    """Title and picture of each column."""
    one = next(iter(samples.values()))
    at = one.horizons_s.index(horizon_s)
    return {
        "scan": frame_png(one.visible, one.occupied),
        f"{horizon_s:g} s later": frame_png(one.observed_visible[at], one.observed_occupied[at]),
        **{name: probability_png(sample.forecast[at]) for name, sample in samples.items()},
    }
