"""Annotated people on ROS topics, of a robot that drives: leg_tracker, people_msgs, poses by their order."""

from __future__ import annotations

import math

import pytest

from gridtrack.common.errors import RecordingError
from gridtrack.common.geometry import SE2
from gridtrack.recordings import import_recording

from scenes import output_bag as outputs
from scenes.drive_bag import FRONT, MS, REAR, START_NS, Ros, robot_at, two_scanner_drive

ROS = {1: Ros(1), 2: Ros(2)}
STAMPS_MS = (500, 1000, 1500)


def walker_at(at_ms: float) -> tuple[float, float]:
    """The person of the drive, in odom."""
    return -5.0 + at_ms / 1000.0, 3.0


def pose(ros: Ros, x: float, y: float):
    return outputs.Outputs(ros).pose(SE2(x, y))


def leg_tracker(ros: Ros, at_ms: float, x: float, y: float, frame: str):
    return ros.make("leg_tracker/msg/Person", pose=pose(ros, x, y), id=4)


def leg_tracker_array(ros: Ros, at_ms: float, x: float, y: float, frame: str):
    people = [leg_tracker(ros, at_ms, x, y, frame)]
    return ros.make("leg_tracker/msg/PersonArray", header=ros.header(at_ms, frame), people=people)


def people_msgs(ros: Ros, at_ms: float, x: float, y: float, frame: str, name: str = "anna"):
    person = ros.make("people_msgs/msg/Person", name=name, position=ros.make("geometry_msgs/msg/Point", x=x, y=y))
    return ros.make("people_msgs/msg/People", header=ros.header(at_ms, frame), people=[person])


def unnamed(ros: Ros, at_ms: float, x: float, y: float, frame: str):
    return people_msgs(ros, at_ms, x, y, frame, name="")


def poses(ros: Ros, at_ms: float, x: float, y: float, frame: str):
    places = [pose(ros, math.nan, math.nan), pose(ros, x, y)]
    return ros.make("geometry_msgs/msg/PoseArray", header=ros.header(at_ms, frame), poses=places)


def bag(folder, make, frame="odom", version=1, place=walker_at):
    """A drive past a walker who is annotated at STAMPS_MS, received 200 ms later (a message without a header: then)."""
    ros = ROS[version]
    messages = [(at_ms, make(ros, at_ms, *place(at_ms), frame)) for at_ms in STAMPS_MS]
    late_ms = 0 if make is leg_tracker else 200
    people = [("/people", one.__msgtype__, START_NS + (at_ms + late_ms) * MS, one) for at_ms, one in messages]
    return ros.write(folder / ("a.bag" if version == 1 else "a"), [*two_scanner_drive(ros, 2000), *people])


def places(folder, source, people="/people", **options):
    """Track and place of the people at 1 s, rounded to the centimetre."""
    scans = import_recording(source, folder / "out.mcap", people=people, **options).scans()
    scan = next(one for one in scans if one.stamp_ns == START_NS + 1000 * MS)
    return {one.track: (round(one.x, 2), round(one.y, 2)) for one in scan.people or ()}


@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize(
    ("make", "track", "options"),
    [
        (leg_tracker, 4, {"people": "/people@odom"}),
        (leg_tracker_array, 4, {}),
        (people_msgs, 0, {}),
        (poses, 1, {"people_by_order": True}),
    ],
)
def test_every_kind_of_message_gives_positions_with_identity(tmp_path, version, make, track, options) -> None:
    assert places(tmp_path, bag(tmp_path, make, version=version), **options) == {track: walker_at(1000)}


@pytest.mark.parametrize("frame", ["odom", "base_footprint", "front_laser", "rear_laser", "/rear_laser"])
def test_positions_may_be_in_any_frame_that_carries_a_sensor_even_upside_down(tmp_path, frame) -> None:
    def place(at_ms: float) -> tuple[float, float]:
        laser = {"front_laser": FRONT, "rear_laser": REAR}.get(frame.strip("/"))
        carrier = SE2() if frame == "odom" else robot_at(at_ms) @ (laser.base_T_laser if laser else SE2())
        ((x, y),) = carrier.inverse().apply([walker_at(at_ms)]).tolist()
        return x, -y if laser is REAR else y

    assert places(tmp_path, bag(tmp_path, leg_tracker_array, frame, place=place)) == {4: walker_at(1000)}


@pytest.mark.parametrize(
    ("make", "frame", "people", "message"),
    [
        (leg_tracker, "", "/people", "name no frame: add it, --people /people@FRAME, one of odom, base_foot"),
        (leg_tracker_array, "map", "/people", "positions in the frame 'map': "),
        (poses, "odom", "/people", "the poses of /people have no identity: if each place in the array is one person's"),
        (unnamed, "odom", "/people", "a person of /people has no name, so no identity"),
        (leg_tracker_array, "odom", "/peple", "no topic '/peple' with people; did you mean '/people'?"),
        (leg_tracker_array, "odom", "/front_scan", "no topic '/front_scan' with people; known: /people"),
    ],
)
def test_people_that_cannot_be_used_are_refused_in_a_line(tmp_path, make, frame, people, message) -> None:
    with pytest.raises(RecordingError) as raised:
        places(tmp_path, bag(tmp_path, make, frame), people)
    assert message in str(raised.value)


def test_a_position_that_is_no_number_is_refused(tmp_path) -> None:
    with pytest.raises(RecordingError, match="a message of /people: a person at nan, 0"):
        places(tmp_path, bag(tmp_path, leg_tracker_array, place=lambda at_ms: (math.nan, 0.0)))
