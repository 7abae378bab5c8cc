"""The drives with poses of every kind: as they are recorded, of kiss-icp, and with the ego-motion ignored.

In each of them forecasts are scored by the true poses. Thresholds are chosen on the validation drives with poses of the
same kind, which are joined to one recording for that.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

from gridtrack.common.files import atomic_write
from gridtrack.common.geometry import SE2
from gridtrack.common.scan import Scan
from gridtrack.recordings import Recording, open_recording
from gridtrack.recordings.formats.native import write_native
from gridtrack.recordings.importing import import_recording
from gridtrack.recordings.recording_info import RecordingInfo

RECORDED = {"perfect": "", "odometry": "-odometry", "beside": "-beside"}
"""The kinds that are simulated as recordings of their own: the end of their names."""
KINDS = ("perfect", "odometry", "kiss-icp", "ignored", "beside")
"""Of poses; beside: those of a laser that stands beside the drive in the same minute."""
PAUSE_NS = 5_000_000_000
"""Between two joined drives: longer than a forecast, so that none is scored on the next drive."""


def minutes_in(folder: Path) -> list[str]:
    """The names of the drives in a folder of a drive set, such as `car-202`."""
    return sorted(path.stem for path in folder.glob("*.tracks") if path.stem.count("-") == 1)


def recording_of(kind: str, minute: str, folder: Path, out: Path) -> Path:
    """The recording of a drive in `folder` with one of KINDS of poses; written below `out` if not recorded so."""
    if kind in RECORDED:
        return folder / f"{minute}{RECORDED[kind]}.tracks"
    path = out / kind / f"{minute}.mcap"
    if not path.exists() and kind == "kiss-icp":
        import_recording(folder / f"{minute}.tracks", path, ego_motion="kiss-icp")
    elif not path.exists():
        source = open_recording(folder / f"{minute}.tracks")
        described = {"poses": "ignored", "source": source.name, "source_sha256": source.sha256}
        _write(path, source.info.model_copy(update=described), standing(source.scans()))
    return path


def joined_recording(kind: str, folder: Path, out: Path) -> Path:
    """All drives in `folder` with one of KINDS of poses, one after the other in one recording below `out`."""
    path = out / kind / "validation.mcap"
    if not path.exists():
        recordings = [open_recording(recording_of(kind, minute, folder, out)) for minute in minutes_in(folder)]
        info = recordings[0].info.model_copy(update={"source": "", "source_sha256": "", "command": ""})
        _write(path, info, joined(recordings))
    return path


def standing(scans: Iterable[Scan]) -> Iterator[Scan]:
    """`scans` as if the sensor stood at its first pose; the recorded poses become the reference poses."""
    first: SE2 | None = None
    for scan in scans:
        first = scan.world_T_sensor if first is None else first
        yield replace(scan, world_T_sensor=first, reference_T_sensor=scan.reference_T_sensor or scan.world_T_sensor)


def joined(recordings: Iterable[Recording]) -> Iterator[Scan]:
    """The scans of one recording after the other, PAUSE_NS after the last of the one before."""
    start_ns = 0
    for recording in recordings:
        survey = recording.survey
        for scan in recording.scans():
            yield replace(scan, stamp_ns=start_ns + scan.stamp_ns - survey.first_ns)
        start_ns += survey.last_ns - survey.first_ns + PAUSE_NS


def _write(path: Path, info: RecordingInfo, scans: Iterable[Scan]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path) as file:
        write_native(file, info, scans)
