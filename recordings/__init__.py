"""Recordings of laser scans: read in any registered format, written in the native one."""

from gridtrack.recordings.formats.native import write_native
from gridtrack.recordings.importing import import_recording
from gridtrack.recordings.opening import open_recording, packaged_recording, recordings_at
from gridtrack.recordings.overview import RecordingOverview
from gridtrack.recordings.read_options import CloudSlice, Mount, ReadOptions, parse_mount
from gridtrack.recordings.recording import Recording
from gridtrack.recordings.recording_info import RecordingInfo, Stretch
from gridtrack.recordings.registry import RecordingFormat

__all__ = [
    "CloudSlice",
    "Mount",
    "ReadOptions",
    "Recording",
    "RecordingFormat",
    "RecordingInfo",
    "RecordingOverview",
    "Stretch",
    "import_recording",
    "open_recording",
    "packaged_recording",
    "parse_mount",
    "recordings_at",
    "write_native",
]
