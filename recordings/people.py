"""Annotated people: positions with identity from a CSV file or a topic, interpolated at the stamps of the scans.

Annotations are no full truth: they say where persons are, and nothing of walls, legs and hidden cells.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.errors import ConfigurationError, RecordingError, did_you_mean, one_line
from gridtrack.common.geometry import SE2
from gridtrack.common.scan import MAX_POSITION_M, Scan
from gridtrack.common.scene import Person
from gridtrack.recordings.interpolated_poses import InterpolatedPoses
from gridtrack.recordings.native_messages import MAX_TRACK
from gridtrack.recordings.stamp_order import MAX_STAMP_NS

PERSON_M = 0.4
"""Greatest distance of a cell's centre, or of a return, from the position of the person that it belongs to."""
MAX_PAUSE_S = 1.0
"""A person is interpolated between annotations at most this far apart. A longer pause without any annotation is not
annotated: nobody may be there, or nobody looked."""
SPEED_S = 1.0
"""The speed of a person is the way over this time about the stamp: from scan to scan it is mostly the annotator's
noise."""
MAX_DELAY_S = 1e9
MAX_ANNOTATIONS = 1_000_000
MAX_PRESENT = 1000
"""Limits of the positions, and of the persons at one stamp."""
MANY_FAR = 0.5
"""Share of persons without a return near them from which on a frame or a clock is likely to be wrong."""
TRIED_SCANS = (-2, -1, 1, 2)
NEARER, FEWEST_PERSONS = 0.85, 20
"""Annotations are often stamped a scan too late or too early. So many scans are tried; a warning appears if the mean
distance from the nearest return falls below this share of it, over at least so many persons."""


class Annotation(NamedTuple):
    """The position of a person at a stamp, metres, in `frame`; an empty frame is not named."""

    stamp_ns: int
    track: int
    x: float
    y: float
    frame: str = ""


class CarriedFrame(NamedTuple):
    """A frame that a sensor carries: its pose is that of the sensor, times `sensor_T_frame`.

    `mirrored`: y points to the right, as in the frame of a laser upside down.
    """

    sensor: str
    sensor_T_frame: SE2 = SE2()
    mirrored: bool = False


KnownFrames = Mapping[str, CarriedFrame | None]
"""The frames in which positions may be given; None for the world frame of the sensors' poses."""


class PeopleSource(NamedTuple):
    """A topic, or a CSV file; `frame` of positions that name none.

    `by_order`: each place in an array of poses is one person in every message. `delay_s`: the annotations are stamped
    so many seconds later than the scans that they were made on.
    """

    name: str
    frame: str = ""
    by_order: bool = False
    delay_s: float = 0.0

    @property
    def is_file(self) -> bool:
        """Whether it is a CSV file."""
        return self.name.lower().endswith(".csv")

    def __str__(self) -> str:
        """As on the command line, without the folder."""
        name = Path(self.name).name if self.is_file else self.name
        return f"{name}@{self.frame}" if self.frame else name


def parse_people(text: str, *, by_order: bool = False, delay_s: float = 0.0) -> PeopleSource:
    """Read `TOPIC`, `FILE.csv`, `TOPIC@FRAME` or `FILE.csv@FRAME`. Raises ConfigurationError for an endless delay."""
    if not abs(delay_s) <= MAX_DELAY_S:
        raise ConfigurationError(f"--people-delay {delay_s:g}: expected seconds, at most {MAX_DELAY_S:g}")
    name, at, frame = text.rpartition("@")
    if not at or text.lower().endswith(".csv"):
        name, frame = text, ""
    return PeopleSource(name, frame, by_order, delay_s)


def read_people(path: Path, first_ns: int) -> Iterator[Annotation]:
    """The rows of a CSV file with the columns stamp_ns or time_s (since `first_ns`), id, x, y, and optionally frame.

    Raises RecordingError with the line of the first bad row.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.DictReader(file, restval="")
            columns = set(reader.fieldnames or ())
            if not {"id", "x", "y"} <= columns or len({"stamp_ns", "time_s"} & columns) != 1:
                raise RecordingError(
                    f"{path}: expected the columns stamp_ns or time_s (seconds since the first scan), id, x, y and"
                    " optionally frame"
                )
            for row in reader:
                try:
                    yield _annotation_of(row, first_ns)
                except ValueError as error:
                    raise RecordingError(f"{path}, line {reader.line_num}: {one_line(str(error), 200)}") from None
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read ({error.strerror})") from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise RecordingError(f"{path}: not a CSV in UTF-8 ({error})") from None


def _annotation_of(row: Mapping[str, str], first_ns: int) -> Annotation:
    """A row of a CSV file. Raises ValueError."""
    if "stamp_ns" in row:
        stamp_ns = int(row["stamp_ns"])
    else:
        time_s = float(row["time_s"])
        if not abs(time_s) <= MAX_STAMP_NS / 1e9:
            raise ValueError(f"a time of {time_s:g} s")
        stamp_ns = first_ns + round(time_s * 1e9)
    if not row["id"].strip():
        raise ValueError("no id: a person needs one, the same number in every row")
    return checked(Annotation(stamp_ns, int(row["id"]), float(row["x"]), float(row["y"]), row.get("frame") or ""))


def checked(one: Annotation) -> Annotation:
    """The annotation. Raises ValueError for numbers out of range."""
    if not 0 <= one.stamp_ns <= MAX_STAMP_NS:
        raise ValueError(f"a stamp of {one.stamp_ns} ns")
    if not 0 <= one.track < MAX_TRACK:
        raise ValueError(f"an id of {one.track}; expected a number from 0 on")
    if not max(abs(one.x), abs(one.y)) <= MAX_POSITION_M:  # false for NaN
        raise ValueError(f"a person at {one.x:g}, {one.y:g}; expected a finite position in metres")
    return one


class _Part(NamedTuple):
    """Annotations of one person without a pause: stamps (N,) int64, places (N, 2) float64 in the world."""

    track: int
    stamps_ns: NDArray[np.int64]
    places: NDArray[np.float64]

    def at(self, stamp_ns: int) -> NDArray[np.float64]:
        """The place (2,) at a stamp; before the first annotation, and after the last, that one."""
        since_s = (self.stamps_ns - stamp_ns) / 1e9
        return np.array([np.interp(0.0, since_s, along) for along in self.places.T])

    def person(self, stamp_ns: int) -> Person:
        """The person at a stamp of the part."""
        half_ns = round(SPEED_S * 5e8)
        begin_ns = max(stamp_ns - half_ns, int(self.stamps_ns[0]))
        end_ns = min(stamp_ns + half_ns, int(self.stamps_ns[-1]))
        way_m = math.dist(self.at(begin_ns), self.at(end_ns))
        x, y = self.at(stamp_ns).tolist()
        return Person(self.track, x, y, way_m / ((end_ns - begin_ns) / 1e9) if end_ns > begin_ns else 0.0)


class People:
    """The annotated people of a recording, in the world frame."""

    def __init__(self, annotations: Iterable[Annotation]) -> None:
        """Raises RecordingError for two positions of one person at one stamp."""
        ordered = sorted(annotations, key=lambda one: (one.track, one.stamp_ns))
        self.size = len(ordered)
        self.tracks = len({one.track for one in ordered})
        tracks = np.array([one.track for one in ordered], np.int64)
        stamps_ns = np.array([one.stamp_ns for one in ordered], np.int64)
        places = np.array([(one.x, one.y) for one in ordered], np.float64).reshape(-1, 2)
        step_ns, same = np.diff(stamps_ns), np.diff(tracks) == 0
        for twice in np.flatnonzero(same & (step_ns == 0))[:1]:
            raise RecordingError(f"person {tracks[twice]} has two positions at {stamps_ns[twice]} ns: keep one")
        cuts = np.flatnonzero(~same | (step_ns > MAX_PAUSE_S * 1e9)) + 1
        pieces = (np.split(values, cuts) for values in (tracks, stamps_ns, places))
        self._parts = [_Part(int(track[0]), *rest) for track, *rest in zip(*pieces, strict=True) if track.size]
        self._begins, self._ends = (np.array([part.stamps_ns[k] for part in self._parts], np.int64) for k in (0, -1))
        self.stamps_ns = np.unique(stamps_ns)
        """Stamps (N,) int64 with an annotation."""

    def at(self, stamp_ns: int) -> tuple[Person, ...] | None:
        """The persons at a stamp; None outside of the annotated time, and in its pauses."""
        after = int(np.searchsorted(self.stamps_ns, stamp_ns))
        around_ns = self.stamps_ns[max(after - 1, 0) : after + 1]
        exact = after < len(self.stamps_ns) and self.stamps_ns[after] == stamp_ns
        if not exact and (len(around_ns) < 2 or around_ns[1] - around_ns[0] > MAX_PAUSE_S * 1e9):
            return None
        present = np.flatnonzero((self._begins <= stamp_ns) & (stamp_ns <= self._ends))
        return tuple(self._parts[k].person(stamp_ns) for k in present)

    @property
    def alone(self) -> int:
        """Number of annotations without another one of the same person within MAX_PAUSE_S."""
        return sum(len(part.stamps_ns) == 1 for part in self._parts)

    @property
    def pauses_s(self) -> float:
        """Seconds in pauses without any annotation."""
        steps_s = np.diff(self.stamps_ns) / 1e9
        return float(steps_s[steps_s > MAX_PAUSE_S].sum())


class SensorPaths:
    """The time of a recording, and the reference poses of its sensors in it, from one pass over its scans."""

    def __init__(self, scans: Iterable[Scan]) -> None:
        stamps: dict[str, list[int]] = {}
        poses: dict[str, list[SE2]] = {}
        for scan in scans:
            stamps.setdefault(scan.sensor, []).append(scan.stamp_ns)
            poses.setdefault(scan.sensor, []).append(scan.reference_T_sensor or scan.world_T_sensor)
        self.first_ns = min(own[0] for own in stamps.values())
        self.last_ns = max(own[-1] for own in stamps.values())
        self.period_ns = round(min(np.median(np.diff(own)) if len(own) > 1 else 0.0 for own in stamps.values()))
        """The shortest time between two scans of a sensor, median; 0 for a single scan."""
        self.poses = {sensor: InterpolatedPoses(own, poses[sensor]) for sensor, own in stamps.items()}


def placed_people(
    source: PeopleSource,
    annotations: Iterable[Annotation],
    paths: SensorPaths,
    frames: KnownFrames,
    note: Callable[[str], None],
) -> dict[float, People]:
    """The people at their places in the world, by their delay in seconds; `note` receives a line on what is left out.

    The first has the delay of `source`, the others are TRIED_SCANS later. Raises RecordingError for an unknown frame,
    for too many positions, and if none is within the recording's time.
    """
    found = list(islice(annotations, MAX_ANNOTATIONS + 1))
    if not found:
        raise RecordingError(f"{source}: no positions of people")
    if len(found) > MAX_ANNOTATIONS:
        raise RecordingError(f"{source}: more than {MAX_ANNOTATIONS} positions of people")

    def people_at(delay_ns: int) -> People:
        moved = (one._replace(stamp_ns=one.stamp_ns - delay_ns) for one in found)
        inside = [one for one in moved if paths.first_ns <= one.stamp_ns <= paths.last_ns]
        return People(_in_world(one, source, paths, frames) for one in inside)

    delay_ns = round(source.delay_s * 1e9)
    try:
        people = people_at(delay_ns)
    except RecordingError as error:
        raise RecordingError(f"{source}: {error}") from None
    _check_clock(source, found, people, paths)
    _note_left_out(source, len(found), people, note)
    tried = [delay_ns + scans * paths.period_ns for scans in TRIED_SCANS] if paths.period_ns else []
    return {one_ns / 1e9: people if one_ns == delay_ns else people_at(one_ns) for one_ns in (delay_ns, *tried)}


def _check_clock(source: PeopleSource, found: Sequence[Annotation], people: People, paths: SensorPaths) -> None:
    """Raise RecordingError if no annotation is within the recording's time."""
    if people.size:
        return
    begin_s, end_s = ((end(one.stamp_ns for one in found) - paths.first_ns) / 1e9 for end in (min, max))
    raise RecordingError(
        f"{source}: its {len(found)} positions are from {begin_s:.1f} s to {end_s:.1f} s after the first scan, and"
        f" the recording ends at {(paths.last_ns - paths.first_ns) / 1e9:.1f} s: their clock is another one; the"
        " difference can be given with --people-delay"
    )


def _note_left_out(source: PeopleSource, found: int, people: People, note: Callable[[str], None]) -> None:
    left_out = {
        f"{found - people.size} outside of the recording's time": found > people.size,
        f"{people.alone} without another of the same person within {MAX_PAUSE_S:g} s": people.alone,
        f"{people.pauses_s:.1f} s of pauses longer than {MAX_PAUSE_S:g} s are not annotated": people.pauses_s,
    }
    if any(left_out.values()):
        texts = "; ".join(text for text, count in left_out.items() if count)
        note(f"people of {source}: {found} positions of {people.tracks} persons; {texts}")


def _in_world(one: Annotation, source: PeopleSource, paths: SensorPaths, frames: KnownFrames) -> Annotation:
    name = (one.frame or source.frame).strip("/")
    if not name and source.is_file and None in frames.values():
        return one
    if not name:
        raise RecordingError(f"its positions name no frame: add it, --people {source}@FRAME, one of {_names(frames)}")
    if name not in frames:
        raise RecordingError(f"positions in the frame '{one_line(name, 80)}': {did_you_mean(name, frames)}")
    carried = frames[name]
    if carried is None:
        return one
    world_T_frame = paths.poses[carried.sensor].at(one.stamp_ns) @ carried.sensor_T_frame
    ((x, y),) = world_T_frame.apply(np.array([(one.x, -one.y if carried.mirrored else one.y)])).tolist()
    return one._replace(x=x, y=y)


def _names(frames: KnownFrames) -> str:
    return ", ".join(frames)


def with_people(scans: Iterable[Scan], by_delay: Mapping[float, People], note: Callable[[str], None]) -> Iterator[Scan]:
    """`scans` with the first of the people; at the end `note` receives a line if they do not fit the returns.

    They do not if most are far from every return, or if those with another delay are nearer.
    """
    (own_s, people), *_ = by_delay.items()
    distances: dict[float, list[NDArray[np.float64]]] = {delay_s: [] for delay_s in by_delay}
    for scan in scans:
        for delay_s, delayed in by_delay.items():
            distances[delay_s].append(_distances_to_returns(delayed.at(scan.stamp_ns) or (), scan))
        yield replace(scan, people=people.at(scan.stamp_ns))
    within = {delay_s: np.minimum(np.concatenate(found), PERSON_M) for delay_s, found in distances.items()}
    far, persons = int((within[own_s] >= PERSON_M).sum()), within[own_s].size
    mean_m = {delay_s: float(found.mean()) for delay_s, found in within.items() if found.size >= FEWEST_PERSONS}
    best_s = min(mean_m, key=mean_m.__getitem__, default=own_s)
    if best_s != own_s and own_s in mean_m and mean_m[best_s] < NEARER * mean_m[own_s]:
        note(
            f"the annotated persons are {mean_m[own_s]:.2f} m from the nearest return (mean; {PERSON_M:g} m at most"
            f" counts), and {mean_m[best_s]:.2f} m if their stamps are {best_s:.3f} s late: give --people-delay"
            f" {best_s:.3f}"
        )
    elif far > MANY_FAR * persons:
        note(
            f"{far} of {persons} persons at the stamps of scans have no return within {PERSON_M:g} m: check the frame"
            " and the clock of the annotations"
        )


def _distances_to_returns(people: Sequence[Person], scan: Scan) -> NDArray[np.float64]:
    """The distance (N,) of each person from the nearest return of a scan, metres; infinite without a return."""
    if len(people) > MAX_PRESENT:
        raise RecordingError(f"{len(people)} persons at one stamp; at most {MAX_PRESENT} are read")
    is_return = (scan.ranges >= scan.range_min) & (scan.ranges <= scan.range_max)
    if not people or not is_return.any():
        return np.full(len(people), np.inf)
    angles = scan.angle_min + scan.angle_increment * np.flatnonzero(is_return)
    points = np.stack([np.cos(angles), np.sin(angles)], axis=1) * scan.ranges[is_return, None]
    returns = (scan.reference_T_sensor or scan.world_T_sensor).apply(points)
    from scipy.spatial import cKDTree  # heavy, and few recordings have people

    distance, _ = cKDTree(returns).query([(one.x, one.y) for one in people])
    return np.asarray(distance)
