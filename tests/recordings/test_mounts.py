"""Mounts from the command line."""

from __future__ import annotations

import math

import pytest

from gridtrack.common.errors import ConfigurationError
from gridtrack.recordings.read_options import Mount, parse_mount


def test_a_mount_is_metres_and_an_angle_with_its_unit() -> None:
    mount = parse_mount("front_laser=0.4,-0.2,45deg")
    assert mount == Mount(sensor="front_laser", x=0.4, y=-0.2, heading_rad=math.pi / 4)
    assert parse_mount("a=1,2,0.5rad").heading_rad == pytest.approx(0.5)
    assert parse_mount("a=1,2,0").heading_rad == 0.0
    assert parse_mount("a=1,2,270deg").heading_rad == pytest.approx(-math.pi / 2)


def test_a_mount_may_name_its_parent_and_be_mirrored() -> None:
    mount = parse_mount("rear/scan=base_link:-0.4,0,180deg,mirrored")
    assert (mount.sensor, mount.parent, mount.x, mount.mirrored) == ("rear/scan", "base_link", -0.4, True)
    assert abs(mount.heading_rad) == pytest.approx(math.pi)
    assert str(mount) == "rear/scan=base_link:-0.4,0,180deg,mirrored"
    assert parse_mount(str(mount)) == mount


@pytest.mark.parametrize(
    "text",
    ["", "a", "a=", "=1,2,3deg", "a=1,2", "a=1,2,3", "a=1,2,3deg,upside", "a=nan,0,0deg", "a=0,nan,0deg",
     "a=1,inf,0deg", "a=1,2,3deg,mirrored,mirrored", "a=1e12,0,0deg", "a=1,2,nandeg"],
)  # fmt: skip
def test_a_text_that_is_no_mount_is_refused_in_one_line(text: str) -> None:
    with pytest.raises(ConfigurationError, match="--mount") as error:
        parse_mount(text)
    assert "\n" not in str(error.value)
