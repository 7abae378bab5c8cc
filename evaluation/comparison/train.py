"""Preparing a tracker for a site: `gridtrack train NAME RECORDING... --validation RECORDING[@range] --out DIR`."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from gridtrack.common.config import validated
from gridtrack.common.errors import ConfigurationError, PluginError
from gridtrack.common.grid import GridSpec
from gridtrack.evaluation.comparison.learned import weights_path
from gridtrack.evaluation.scoring.in_process import score_in_process
from gridtrack.evaluation.scoring.splits import TRAIN, VALIDATION, own_validation, shares_frames
from gridtrack.recordings import open_recording
from gridtrack.recordings.stream import GridStream, parse_stretch
from gridtrack.trackers import registry
from gridtrack.trackers.contract import FitOutput


def train(
    name: str,
    recordings: Sequence[str],
    validation: Sequence[str],
    out: Path,
    options: Mapping[str, Any],
    seed: int,
    command: str,
    *,
    grid: GridSpec | None = None,
    rate_hz: float | None = None,
    report: Callable[[str], None] = print,
) -> Path:
    """Fit the tracker `name` to the recordings' site and return the card it wrote, `<out>/<name>/<site>.toml`.

    Each of `recordings` and `validation` is RECORDING[@range]; without a range, and for validation where none is
    given, it is the recording's stretch of that name. Runs in this process, as fitting is the user's own to start and
    to stop. Logs and checkpoints lie beside the card in `<site>.logs`; a second call resumes there. Raises
    GridtrackError.
    """
    tracker = registry.load(name)
    if not tracker.learns:
        raise PluginError(f"tracker '{name}' has nothing to learn: compare it as it is")
    settings = validated(tracker.Options, dict(options), f"tracker '{name}'")
    fitted = [_stretch(text, TRAIN, grid, rate_hz) for text in recordings]
    chosen_by = [_stretch(text, VALIDATION, grid, rate_hz) for text in validation] or _own_validation(fitted)
    _refuse_shared(fitted, chosen_by)
    path = weights_path(out, name, fitted[0].site)
    _make_folder(path.parent)
    output = FitOutput(path, command, seed, path.with_suffix(".logs"), report)
    tracker.fit(fitted, chosen_by, score_in_process, output, settings)
    return path


def _make_folder(folder: Path) -> None:
    """Made before the training: what it takes an hour to learn must have a place to go."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigurationError(
            f"{folder}: cannot be made ({error.strerror}); name a folder for weights with --out"
        ) from None
    if not os.access(folder, os.W_OK):
        raise ConfigurationError(f"{folder}: may not be written to; name another folder for weights with --out")


def _stretch(text: str, use: str, grid: GridSpec | None, rate_hz: float | None) -> GridStream:
    """The stretch that `text` names, or the recording's own for this use, or the whole of a recording without any."""
    path, stretch = parse_stretch(text)
    recording = open_recording(path)
    own = recording.info.stretches
    if stretch is None and own and use not in own:
        raise ConfigurationError(
            f"{path}: it names no stretch '{use}'; name one of {', '.join(own)}, or seconds: @0s-75s"
        )
    return GridStream(recording, use if stretch is None and own else stretch, grid=grid, rate_hz=rate_hz)


def _own_validation(fitted: Sequence[GridStream]) -> list[GridStream]:
    found = [own_validation(stream) for stream in fitted if VALIDATION in stream.recording.info.stretches]
    if not found:
        raise ConfigurationError(
            f"{fitted[0].name}: no validation stretch; name one with --validation RECORDING[@range]"
        )
    return found


def _refuse_shared(fitted: Sequence[GridStream], chosen_by: Sequence[GridStream]) -> None:
    for stream in fitted:
        for other in chosen_by:
            if shares_frames(stream, other):
                raise ConfigurationError(
                    f"{other.name} shares frames with {stream.name}: what is learned must be chosen on other frames"
                )
