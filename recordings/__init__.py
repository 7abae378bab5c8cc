"""Recordings of laser scans: the native MCAP form, and ROS bags, ROS MCAP files and CARMEN logs read in place."""

from gridtrack.recordings.importing import import_recording
from gridtrack.recordings.native import write_native
from gridtrack.recordings.opening import open_recording, packaged_recording
from gridtrack.recordings.recording import Recording, RecordingInfo, Stretch
from gridtrack.recordings.ros_messages import CloudSlice
from gridtrack.recordings.survey import Summary

__all__ = [
    "CloudSlice",
    "Recording",
    "RecordingInfo",
    "Stretch",
    "Summary",
    "import_recording",
    "open_recording",
    "packaged_recording",
    "write_native",
]
