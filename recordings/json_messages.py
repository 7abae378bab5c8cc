"""The messages of a native recording that Foxglove has no schema for, in JSON: beam times and the quality of poses.

`/beam_times` or `/beam_times/SENSOR` {timestamp, time_increment_s} is written where it changes, `/pose_quality` or
`/pose_quality/SENSOR` {timestamp, outcome, inlier_share, residual_m} once for each scan whose pose has a quality.
"""

from __future__ import annotations

import json
from typing import Any

from gridtrack.common.pose_quality import MATCH_OUTCOMES, PoseQuality
from gridtrack.common.untrusted import parse_json
from gridtrack.recordings.recording import DamageError

BEAM_TIMES, POSE_QUALITY = "/beam_times", "/pose_quality"
MAX_SWEEP_S = 10.0
"""Limit of the time from a scan's first beam to its last."""
MAX_MESSAGE_CHARS = 1000

_TIMESTAMP = {"type": "object", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}}
_NUMBER = {"type": "number"}
JSON_SCHEMAS: dict[str, dict[str, Any]] = {
    BEAM_TIMES: {"title": "gridtrack.BeamTimes", "time_increment_s": _NUMBER},
    POSE_QUALITY: {
        "title": "gridtrack.PoseQuality",
        "outcome": {"type": "string", "enum": list(MATCH_OUTCOMES)},
        "inlier_share": _NUMBER,
        "residual_m": _NUMBER,
    },
}
"""By kind of topic: the name of the schema, and the fields beside the timestamp."""


def json_schema(kind: str) -> tuple[str, bytes]:
    """Name and JSON Schema of the messages of BEAM_TIMES or POSE_QUALITY."""
    fields = {"timestamp": _TIMESTAMP, **JSON_SCHEMAS[kind]}
    name = fields.pop("title")
    return name, json.dumps({"title": name, "type": "object", "properties": fields}).encode()


def beam_times_message(stamp_ns: int, time_increment_s: float) -> bytes:
    """A message of BEAM_TIMES."""
    return _encoded(stamp_ns, {"time_increment_s": time_increment_s})


def pose_quality_message(stamp_ns: int, quality: PoseQuality) -> bytes:
    """A message of POSE_QUALITY."""
    values = {"inlier_share": round(quality.inlier_share, 4), "residual_m": round(quality.residual_m, 5)}
    return _encoded(stamp_ns, {"outcome": quality.outcome, **values})


def read_beam_times(data: bytes) -> float:
    """The time between two beams, seconds. Raises DamageError."""
    increment_s = _number(_decoded(BEAM_TIMES, data), BEAM_TIMES, "time_increment_s")
    if not 0.0 <= increment_s <= MAX_SWEEP_S:
        raise DamageError(f"corrupt: {increment_s:g} s from beam to beam on {BEAM_TIMES}")
    return increment_s


def read_pose_quality(data: bytes) -> PoseQuality:
    """The quality of a pose. Raises DamageError."""
    values = _decoded(POSE_QUALITY, data)
    outcome = values.get("outcome")
    if outcome not in MATCH_OUTCOMES:
        raise DamageError(f"corrupt: an outcome on {POSE_QUALITY} that is none of {', '.join(MATCH_OUTCOMES)}")
    share, residual_m = (_number(values, POSE_QUALITY, name) for name in ("inlier_share", "residual_m"))
    if not (0.0 <= share <= 1.0 and 0.0 <= residual_m <= 1e6):
        raise DamageError(f"corrupt: a share of {share:g} or a residual of {residual_m:g} m on {POSE_QUALITY}")
    return PoseQuality(outcome, share, residual_m)


def _encoded(stamp_ns: int, values: dict[str, Any]) -> bytes:
    seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
    return json.dumps({"timestamp": {"sec": seconds, "nsec": nanoseconds}, **values}).encode()


def _decoded(topic: str, data: bytes) -> dict[str, Any]:
    try:
        values = parse_json(data) if len(data) <= MAX_MESSAGE_CHARS else None
    except ValueError:
        values = None
    if not isinstance(values, dict):
        raise DamageError(f"corrupt: a message of {topic} is not a {JSON_SCHEMAS[topic]['title']}")
    return values


def _number(values: dict[str, Any], topic: str, name: str) -> float:
    """The number called `name`; a comparison with its limits is false for NaN."""
    value = values.get(name)
    if not isinstance(value, int | float):
        raise DamageError(f"corrupt: no number '{name}' on {topic}")
    return float(value)
