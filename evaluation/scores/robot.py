"""The virtual robot of contact foresight: a disc that drives straight on."""

from __future__ import annotations

from pydantic import Field

from gridtrack.common.config import Settings, parse_pairs, validated

ROBOT_OPTION = "--robot"


class Robot(Settings):
    """A disc of `radius`, metres, with a speed from 0 to `speed`, m/s; the default is a small robot indoors."""

    radius: float = Field(0.3, ge=0.05, le=10.0)
    """Radius of the disc, metres."""
    speed: float = Field(1.0, ge=0.0, le=50.0)
    """Highest speed, m/s."""

    def __str__(self) -> str:
        return f"radius {self.radius:g} m, up to {self.speed:g} m/s"


SMALL_ROBOT = Robot()
CAR = Robot(radius=1.0, speed=8.0)


def parse_robot(text: str) -> Robot:
    """Read `car`, or `radius=METRES,speed=M/S`. Raises ConfigurationError."""
    return CAR if text == "car" else validated(Robot, parse_pairs(text, ROBOT_OPTION), ROBOT_OPTION)
