"""A survey as a file, so that it need not be found again: .npz, with stamps, first scans and, as JSON, the rest."""

from __future__ import annotations

import json
from array import array
from collections.abc import Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.geometry import SE2
from gridtrack.common.scan import Scan
from gridtrack.recordings.pose_drift import PoseDrift
from gridtrack.recordings.pose_jumps import PoseJumps
from gridtrack.recordings.recording import Recording
from gridtrack.recordings.survey import SensorSurvey, Survey

SURVEY_COUNTS = ("moved", "no_return", "invalid", "zeros", "readings", "labelled", "with_truth")
POSE_JUMPS = tuple(field.name for field in fields(PoseJumps) if not field.name.startswith("_"))
FIRST_SCAN = ("stamp_ns", "angle_min", "angle_increment", "range_min", "range_max", "sensor", "time_increment_s")
"""Fields of the first scan that are kept beside its ranges and poses; labels and truth are not."""


def write_survey(recording: Recording, path: Path) -> None:
    """Write the survey of `recording`, its warnings and damage to `path`. Raises RecordingError, OSError."""
    survey = recording.survey
    about = {
        "sensors": {name: _values(sensor) for name, sensor in survey.sensors.items()},
        "topics": survey.topics,
        "warnings": recording.warning_texts(),
        "damage": recording.damage,
    }
    arrays: dict[str, Any] = {}
    for n, sensor in enumerate(survey.sensors.values()):
        arrays |= {f"stamps_{n}": sensor.stamps_ns, f"ranges_{n}": sensor.first.ranges}
    with path.open("wb") as file:
        np.savez_compressed(file, about=np.array(json.dumps(about)), **arrays)


def recall_survey(recording: Recording, path: Path) -> None:
    """Let `recording` take over what `write_survey` wrote about the same file. Raises OSError."""
    with np.load(path, allow_pickle=False) as stored:
        about = json.loads(str(stored["about"]))
        sensors = {
            name: _sensor(values, stored[f"stamps_{n}"], stored[f"ranges_{n}"])
            for n, (name, values) in enumerate(about["sensors"].items())
        }
    topics = {topic: (kind, count) for topic, (kind, count) in about["topics"].items()}
    recording.recall(Survey(sensors, topics), about["warnings"], about["damage"])


def _values(sensor: SensorSurvey) -> dict[str, Any]:
    first = sensor.first
    return {
        "first": {name: getattr(first, name) for name in FIRST_SCAN},
        "pose": asdict(first.world_T_sensor),
        "reference": first.reference_T_sensor and asdict(first.reference_T_sensor),
        "beams": sorted(sensor.beams),
        "longest_rest_ns": sensor.longest_rest_ns,
        "counts": {name: getattr(sensor, name) for name in SURVEY_COUNTS},
        "jumps": {name: getattr(sensor.jumps, name) for name in POSE_JUMPS},
        "drift": sensor.drift.displacements_m.tolist(),
    }


def _sensor(values: Mapping[str, Any], stamps_ns: NDArray[np.int64], ranges: NDArray[np.float32]) -> SensorSurvey:
    reference = values["reference"]
    first = Scan(
        **values["first"],
        ranges=ranges,
        world_T_sensor=SE2(**values["pose"]),
        reference_T_sensor=SE2(**reference) if reference else None,
    )
    return SensorSurvey(
        first,
        stamps=array("q", stamps_ns.tolist()),
        beams=set(values["beams"]),
        longest_rest_ns=tuple(values["longest_rest_ns"]),
        jumps=PoseJumps(**values["jumps"]),
        drift=PoseDrift(array("d", values["drift"])),
        **values["counts"],
    )
