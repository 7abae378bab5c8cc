"""Stretches: parts of a recording, as texts of the command line and as seconds."""

from __future__ import annotations

import math
import re
from pathlib import Path

from gridtrack.common.errors import RecordingError, did_you_mean
from gridtrack.common.names import NAME_RULE, is_name
from gridtrack.recordings.recording import Recording
from gridtrack.recordings.recording_info import Stretch, stretch_text


def parse_stretch(text: str) -> tuple[Path, Stretch | str | None]:
    """Read `demo.mcap`, `demo.mcap@30s-90s`, `demo.mcap@90s-` or `demo.mcap@test`: a path and a stretch of it.

    Raises RecordingError.
    """
    path, at, stretch = text.rpartition("@")
    if not at or Path(text).exists():
        return Path(text), None
    if not path or not stretch:
        raise RecordingError(f"'{text}': expected RECORDING, RECORDING@30s-90s or RECORDING@NAME")
    if not is_name(stretch):
        raise RecordingError(f"'{text}': no such recording, and '{stretch}' is not the name of a stretch: {NAME_RULE}")
    return Path(path), _seconds(stretch, text) or stretch


def parse_named_stretch(text: str) -> tuple[str, Stretch]:
    """Read `train=0s-75s` or `test=90s-`: a name for a stretch, and the stretch. Raises RecordingError."""
    name, _, stretch = text.partition("=")
    seconds = _seconds(stretch, text)
    if not name or seconds is None:
        raise RecordingError(f"'{text}': expected NAME=30s-90s, or NAME=90s- to the end")
    if not is_name(name):
        raise RecordingError(f"'{text}': '{name}' cannot be the name of a stretch: {NAME_RULE}")
    return name, seconds


def _seconds(stretch: str, where: str) -> Stretch | None:
    """`30s-90s` or `90s-` as (start, end); None for a text that is not a range of seconds."""
    seconds = re.fullmatch(r"(\d+(?:\.\d*)?)s?-(?:(\d+(?:\.\d*)?)s?)?", stretch)
    if seconds is None:
        return None
    start_s, end_s = float(seconds[1]), float(seconds[2]) if seconds[2] else None
    if end_s is not None and end_s <= start_s:
        raise RecordingError(f"'{where}': a stretch ends after it starts")
    return start_s, end_s


def stretch_of(recording: Recording, stretch: Stretch | str | None) -> tuple[Stretch, str]:
    """The stretch in seconds, with its end, and its name for messages. Raises RecordingError."""
    duration_s = recording.survey.duration_s
    if stretch is None:
        return (0.0, duration_s), recording.name
    if isinstance(stretch, str):
        if stretch not in recording.info.stretches:
            known = did_you_mean(stretch, recording.info.stretches)
            raise RecordingError(f"{recording.path}: no stretch '{stretch}'; {known} (or seconds: {_whole(recording)})")
        start_s, end_s = recording.info.stretches[stretch]
        name, runs = f"{recording.name}@{stretch}", f" ({stretch_text((start_s, end_s))})"
    else:
        name, runs, (start_s, end_s) = f"{recording.name}@{stretch_text(stretch)}", "", stretch
    if not duration_s:
        raise RecordingError(f"{name}{runs}: the recording is a single scan, of which there are no stretches")
    if start_s > duration_s or (end_s is not None and end_s > math.ceil(duration_s)):
        long = f"{duration_s:.1f} s long" + (f" ({recording.damage})" if recording.damage else "")
        raise RecordingError(f"{name}{runs}: the recording is {long}: name a range inside it ({_whole(recording)})")
    return (start_s, duration_s if end_s is None else end_s), name


def _whole(recording: Recording) -> str:
    """The whole recording as RECORDING@range."""
    return f"{recording.path}@{stretch_text((0.0, recording.survey.whole_s))}"


def ticks_in(stretch_s: Stretch, duration_ns: int, period_ns: int) -> range:
    """Numbers of the ticks in the stretch: its start included, its end excluded unless the recording ends there."""
    start_s, end_s = stretch_s
    end = duration_ns // period_ns + 1
    if end_s is not None and round(end_s * 1e9) < duration_ns:
        end = min(end, -(-round(end_s * 1e9) // period_ns))
    return range(-(-round(start_s * 1e9) // period_ns), end)
