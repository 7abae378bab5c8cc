"""Annotated people in ROS messages: leg_tracker, people_msgs, and arrays of poses."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from gridtrack.common.errors import RecordingError
from gridtrack.recordings.people import Annotation, checked

_PERSON, _PEOPLE = "leg_tracker/msg/Person", "leg_tracker/msg/PersonArray"
_NAMED, _ALL_NAMED = "people_msgs/msg/Person", "people_msgs/msg/People"
_POSES = "geometry_msgs/msg/PoseArray"


def is_people(kind: str) -> bool:
    """Whether messages of a type, in ROS 2's notation, can be read as people."""
    return kind in (_PERSON, _PEOPLE, _ALL_NAMED, _POSES)


class PeopleReader:
    """Reads the decoded messages of one topic; persons with names get numbers in the order in which they appear.

    `by_order`: the poses of an array are of the same persons in every message; NaN is a person who is absent.
    `received`: the stamps are the times of reception, like those of the scans.
    """

    def __init__(self, topic: str, *, by_order: bool, received: bool) -> None:
        self._topic, self._by_order, self._received = topic, by_order, received
        self._tracks: dict[str, int] = {}

    def read(self, message: Any, kind: str, received_ns: int) -> Iterator[Annotation]:
        """The positions in a message. Raises RecordingError without identity, or for numbers out of range."""
        header = getattr(message, "header", None)
        stamp_ns = 0 if header is None else header.stamp.sec * 1_000_000_000 + header.stamp.nanosec
        frame = "" if header is None else str(header.frame_id)
        stamp_ns = received_ns if self._received or not stamp_ns else stamp_ns
        for track, place in self._persons(message, kind):
            try:
                yield checked(Annotation(stamp_ns, track, float(place.x), float(place.y), frame))
            except ValueError as error:
                raise RecordingError(f"a message of {self._topic}: {error}") from None

    def _persons(self, message: Any, kind: str) -> Iterator[tuple[int, Any]]:
        """Track and position of each person."""
        if kind == _PERSON:
            yield int(message.id), message.pose.position
        elif kind == _PEOPLE:
            yield from ((int(person.id), person.pose.position) for person in message.people)
        elif kind == _ALL_NAMED:
            yield from ((self._track_of(person.name), person.position) for person in message.people)
        elif self._by_order:
            places = ((track, pose.position) for track, pose in enumerate(message.poses))
            yield from ((track, place) for track, place in places if place.x == place.x and place.y == place.y)
        else:
            raise RecordingError(
                f"the poses of {self._topic} have no identity: if each place in the array is one person's in every"
                " message (NaN: absent), say so with --people-by-order"
            )

    def _track_of(self, name: str) -> int:
        if not name:
            raise RecordingError(f"a person of {self._topic} has no name, so no identity")
        return self._tracks.setdefault(name, len(self._tracks))
