"""A recording that is still being written, opened when it holds enough to begin with."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from gridtrack.common.errors import ConfigurationError, RecordingError
from gridtrack.evaluation.runs.plan import Trial
from gridtrack.evaluation.runs.settings import CompareSettings, check_together
from gridtrack.evaluation.scoring.referee import WARM_UP
from gridtrack.recordings import Recording, open_recording
from gridtrack.recordings.growth import FileEnds, Growth
from gridtrack.recordings.mcap_file import MCAP_MAGIC, McapFile
from gridtrack.recordings.recording import DamageError, NoScansError
from gridtrack.recordings.stretches import parse_stretch

SPARE_FRAMES = 3
"""Beside the warm-up and one horizon: a frame is made when the scans of two periods after it are read."""


def open_growing(path: Path, settings: CompareSettings, more: Callable[[], bool]) -> Recording:
    """The recording at `path` when it holds the warm-up and one horizon, or its writer has closed it.

    `more()` waits for more bytes, and says whether there are any. What the recording knows then of its sensors, their
    frames and its rate holds to the end. Raises RecordingError where nothing more comes, or its format cannot grow.
    """
    holds = "nothing that can be read"
    while True:
        if _has_begun(path):
            growth = Growth()
            recording = open_recording(path, growth=growth)
            held_s, needed_s = _held_s(recording), _needed_s(recording, settings)
            if held_s >= needed_s or not growth.cut:
                growth.sensors = frozenset(recording.survey.sensors)
                return recording
            holds = f"{held_s:.1f} s of scans"
        if not more():
            raise RecordingError(
                f"{path}: nothing more is written to it, and it holds {holds}: to follow it, the recorder must be"
                f" running; a comparison begins with {WARM_UP} frames and one horizon ({settings.horizon_s:g} s)"
            )


def path_to_follow(settings: CompareSettings) -> Path:
    """The recording to follow. Raises ConfigurationError for settings that are for finished recordings."""
    check_together(settings)
    path, stretch = parse_stretch(settings.recordings[0])
    if len(settings.recordings) > 1 or stretch is not None:
        raise ConfigurationError("--follow reads one recording from its beginning to its end: name one file, no range")
    given = {name: getattr(settings, name) for name in ("resume", "latency", "deadline", "degrade")}
    for name, value in given.items():
        if value:
            raise ConfigurationError(f"--{name} is for finished recordings: leave it out with --follow")
    if settings.validation and parse_stretch(settings.validation)[0].resolve() == path.resolve():
        raise ConfigurationError(
            f"--validation {settings.validation}: the recording that is followed; name a finished one"
        )
    return path


def refuse_raw(trials: Sequence[Trial]) -> None:
    """Raise ConfigurationError where a tracker asks for returns of the laser."""
    for trial in trials:
        if trial.selection.points != "centres":
            raise ConfigurationError(
                f"{trial.label}: returns of the laser (points={trial.selection.points}) are for finished recordings:"
                " leave them out with --follow"
            )


def _has_begun(path: Path) -> bool:
    """Whether the format can be told: of an MCAP file by its first message. Where the file is missing opening tells."""
    if not path.is_file():
        return True
    growth = Growth()
    try:
        with growth.open(path) as file:
            head = file.read(len(MCAP_MAGIC))
        if head != MCAP_MAGIC:
            return True
        return next(McapFile(path, growth).messages(), None) is not None or not growth.cut
    except FileEnds:
        return False
    except DamageError:
        return True


def _held_s(recording: Recording) -> float:
    try:
        return recording.survey.duration_s
    except NoScansError:
        assert recording.growth is not None
        if not recording.growth.cut:
            raise
        return 0.0


def _needed_s(recording: Recording, settings: CompareSettings) -> float:
    """Seconds of scans to begin with; no number of them where the rate is not known yet."""
    try:
        rate_hz = settings.rate_hz or recording.info.rate_hz or recording.survey.rate_hz
    except NoScansError:
        rate_hz = None
    return (WARM_UP + SPARE_FRAMES) / rate_hz + settings.horizon_s if rate_hz else float("inf")
