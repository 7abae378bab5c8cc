"""ROS 1 bags in the folder of the test."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from scenes import drive_bag as made


@pytest.fixture
def bag(tmp_path: Path) -> Callable[..., Path]:
    """Writes messages as a bag in the order of their reception."""

    def write(*messages: made.Message, name: str = "a.bag") -> Path:
        return made.Ros(1).write(tmp_path / name, messages)

    return write
