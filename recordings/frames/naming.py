"""What the names of frames say by the conventions of ROS (REP 105): worlds that do not move, bodies of robots."""

from __future__ import annotations

WORLD_WORDS = ("odom", "map")
"""In the names of frames that do not move; `odom` first, since it is continuous."""
BODY_FRAMES = ("base_link", "base_footprint")
"""Frames of a robot's body."""


def last_part(frame: str) -> str:
    """`odom` of `robot1/odom`."""
    return frame.rpartition("/")[2]


def has_word(frame: str, word: str) -> bool:
    """Whether a frame's name is `odom`, or has it as a word, as in `robot1/odom`, `odom_combined` and `tb_odom`."""
    return word in last_part(frame).lower().split("_")


def is_world(frame: str) -> bool:
    """Whether a frame's name is that of a world that does not move."""
    return any(has_word(frame, word) for word in WORLD_WORDS)


def is_body(frame: str) -> bool:
    """Whether a frame is a robot's body, as `base_link`, `robot1/base_link` and `tb_base_link`."""
    return last_part(frame).endswith(BODY_FRAMES)
