"""The shipped recordings, and trackers with the weights that ship for a site."""

from __future__ import annotations

from pathlib import Path

from gridtrack.evaluation.runs.learned import find_weights
from gridtrack.recordings import packaged_recording
from gridtrack.recordings.stream import GridStream
from gridtrack.trackers import registry
from gridtrack.trackers.contract import StreamSpec, Tracker, stream_of

DEMO = packaged_recording("leg_tracker")
DATA = DEMO.parents[1]
JUNCTION = DATA / "junction"
WEIGHTS = DATA / "weights"
STEPS = 20
"""Steps of a forecast at the junction: 2.5 s."""


def junction_tests() -> list[Path]:
    """The twenty test recordings of the junction."""
    return sorted(JUNCTION.glob("test-*.tracks"))


def shipped_stream(name: str, source: GridStream) -> StreamSpec:
    """`source` as tracker `name` receives it, with its weights for the site."""
    learned = find_weights(name, source.site, None)
    return stream_of(source, learned.path if learned else None)


def shipped_tracker(name: str, source: GridStream) -> Tracker:
    """Tracker `name` with its default options and its weights for the site of `source`, reset with seed 0."""
    kind = registry.load(name)
    tracker = kind(shipped_stream(name, source), kind.Options())
    tracker.reset(0)
    return tracker
