"""Stretches: parts of a recording as text on the command line, in seconds, and as recorded time."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from gridtrack.common.errors import RecordingError, did_you_mean
from gridtrack.common.files import NAME_RULE, is_name
from gridtrack.common.remote_files import fetched_file, is_url
from gridtrack.recordings.recording import Recording
from gridtrack.recordings.recording_info import Stretch, stretch_text

WALL_CLOCK_FROM_NS = 946_684_800 * 1_000_000_000
"""The year 2000. Later stamps are times of day; earlier ones come from a simulation, or a clock that starts at 0."""


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
        raise RecordingError(f"{name}{runs}: the recording is a single scan, which has no stretches")
    if start_s > duration_s or (end_s is not None and end_s > math.ceil(duration_s)):
        long = f"{duration_s:.1f} s long" + (f" ({recording.damage})" if recording.damage else "")
        raise RecordingError(f"{name}{runs}: the recording is {long}: name a range inside it ({_whole(recording)})")
    return (start_s, duration_s if end_s is None else end_s), name


def _whole(recording: Recording) -> str:
    """The whole recording as RECORDING@range."""
    return f"{recording.path}@{stretch_text((0.0, recording.survey.whole_s))}"


def fetched(text: str, note: Callable[[str], None]) -> str:
    """RECORDING[@RANGE] with a local copy in place of a URL; other texts are returned unchanged.

    The copy lies in `$XDG_CACHE_HOME/gridtrack/recordings` under the file's own name. It is fetched again when the file
    has changed; `note` receives a line before that. Raises StoreError.
    """
    if not is_url(text):
        return text
    url, stretch = _without_stretch(text)
    return f"{fetched_file(url, 'recordings', note)}{stretch}"


def _without_stretch(text: str) -> tuple[str, str]:
    """The URL, and `@RANGE` after its last part or nothing."""
    folder, slash, last = text.rpartition("/")
    name, at, stretch = last.rpartition("@")
    return (f"{folder}{slash}{name}", f"{at}{stretch}") if at else (text, "")


@dataclass(frozen=True, slots=True)
class RecordedTime:
    """Time at one `site`: stamps from `start_ns` to `end_ns` (excluded), first recorded in the file `source_sha256`."""

    source_sha256: str
    site: str
    start_ns: int
    end_ns: int

    def overlaps(self, other: RecordedTime) -> bool:
        """Whether both have a moment in common."""
        return self.common(other) is not None

    def common(self, other: RecordedTime) -> RecordedTime | None:
        """The intersection with `other`, or None.

        Stamps of one source are compared; stamps of one site too if they are times of day: a file that another program
        cut has another hash, and two lasers at one site see the same traffic.
        """
        on_wall_clock = min(self.start_ns, other.start_ns) >= WALL_CLOCK_FROM_NS
        comparable = self.source_sha256 == other.source_sha256 or (self.site == other.site and on_wall_clock)
        start_ns, end_ns = max(self.start_ns, other.start_ns), min(self.end_ns, other.end_ns)
        return replace(self, start_ns=start_ns, end_ns=end_ns) if comparable and start_ns < end_ns else None
