"""A recording: the scans of one or more lasers in the order of their stamps, independent of the file format."""

from __future__ import annotations

import re
import shlex
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from itertools import islice
from pathlib import Path

from gridtrack.common.errors import RecordingError, bounded_line, did_you_mean
from gridtrack.common.files import name_from, sha256_of
from gridtrack.common.notices import Notice
from gridtrack.common.options import option_fields, option_words
from gridtrack.common.scan import Scan
from gridtrack.recordings.file_reading import DamageError, Growth
from gridtrack.recordings.meaning import with_meaning
from gridtrack.recordings.native_messages import WORLD
from gridtrack.recordings.overview import RecordingOverview, SensorOverview
from gridtrack.recordings.people import Annotation, CarriedFrame, KnownFrames
from gridtrack.recordings.read_options import Mount, ReadOptions
from gridtrack.recordings.recording_info import RecordingInfo
from gridtrack.recordings.stamp_order import StampOrder
from gridtrack.recordings.survey import Survey

MAX_WARNINGS, MAX_LISTED_TOPICS = 100, 1000
"""Limits of the warnings about a recording, and of the topics that are listed."""
IN_BURSTS = "the stamps come in bursts: at the rate of their median many frames are empty"
NO_MORE_WARNINGS = f"more than {MAX_WARNINGS} warnings: the others are left out"


class NoScansError(RecordingError):
    """A file without scans, or without scans so far."""


@dataclass
class Topics:
    """The type and the number of messages of every topic, counted in one pass over a file."""

    types: dict[str, str] = field(default_factory=dict)
    counts: dict[str, int] = field(default_factory=dict)
    scans: set[str] = field(default_factory=set)
    """Topics that gridtrack can read as scans."""

    def add(self, topic: str, kind: str, is_scan: bool) -> None:
        """Count one message of `topic`; beyond MAX_LISTED_TOPICS only topics with scans are counted."""
        if len(self.types) >= MAX_LISTED_TOPICS and topic not in self.types and not is_scan:
            return
        self.types[topic] = kind
        self.counts[topic] = self.counts.get(topic, 0) + 1
        if is_scan:
            self.scans.add(topic)


def scans_between(scans: Iterable[Scan], start_s: float | None, end_s: float | None) -> Iterator[Scan]:
    """The scans with start_s <= stamp < end_s, seconds from the first one; nothing is read after `end_s`."""
    first_ns: int | None = None
    for scan in scans:
        first_ns = scan.stamp_ns if first_ns is None else first_ns
        since_s = (scan.stamp_ns - first_ns) / 1e9
        if end_s is not None and since_s >= end_s:
            return
        if start_s is None or since_s >= start_s:
            yield scan


class Recording(ABC):
    """A file of scans, read as a stream.

    `notices` has one for each fault in the part that has been read, even if it is read several times; `damage` is the
    reason why the rest of the file cannot be read. With the option `strict` the first fault raises RecordingError.
    """

    def __init__(self, path: Path, options: ReadOptions) -> None:
        self.path = path
        self.options = options
        self.notices: list[Notice] = []
        self.damage = ""
        self.growth: Growth | None = None
        """For a file that is still being written; None: the file is finished."""

    def __repr__(self) -> str:
        return f"{type(self).__name__}({str(self.path)!r})"

    @property
    def name(self) -> str:
        """The file's name."""
        return self.path.name

    @cached_property
    def sha256(self) -> str:
        """SHA-256 of the file, or of all files of a folder in the order of their names.

        For a file that is still being written, of the part that is read.
        """
        return sha256_of(self.path, self.growth.limit if self.growth else None)

    @property
    def warnings(self) -> list[str]:
        """The notices, a line each, with the path of the recording."""
        return [bounded_line(f"{self.path}: {notice.text}") for notice in self.notices]

    @property
    def scans_version(self) -> str:
        """The version of the rendering, for a format that renders its scans."""
        return ""

    @property
    def source_sha256(self) -> str:
        """SHA-256 of the first source of an imported recording, else of the file itself."""
        return self.info.source_sha256 or self.sha256

    @cached_property
    def info(self) -> RecordingInfo:
        """The metadata of the recording; a format without metadata has its file name as `site`."""
        return RecordingInfo(site=name_from(self.path))

    def topic_of(self, sensor: str) -> str:
        """The topic with the scans of `sensor`, as in the option `topic`."""
        return sensor

    def mount_remedy(self, sensor: str, turn_deg: int) -> str:
        """Remedy for a sensor that is mounted turned by `turn_deg` from its recorded heading."""
        return "correct its heading where its poses are recorded"

    def separate_lasers_with(self, sensor: str) -> str:
        """Remedy for two lasers in the scans of one sensor."""
        return "record each on a topic of its own"

    @property
    def stamp_remedy(self) -> str:
        """Remedy for many stamps that are alike or in disorder; empty if there is none."""
        return ""

    @property
    def pose_problem(self) -> str:
        """Why the poses of the sensors cannot be used, and the remedy; empty if they can."""
        return ""

    def import_command(self, words: Iterable[str]) -> str:
        """The command that imports the recording with its present options and those in `words`."""
        words = list(words)
        ends = {"--topic": "one", "--stamps": "stamped"}
        end = next((end for option, end in ends.items() if option in words), "posed")
        name = name_from(self.path)
        imported = re.fullmatch(rf"(.+-{end})(?:-(\d+))?", name)
        stem = f"{imported[1]}-{int(imported[2] or 1) + 1}" if imported else f"{name}-{end}"
        topic = words[words.index("--topic") + 1] if "--topic" in words else None
        mounts = [
            mount
            for mount in self.options.mounts
            if not any(word.startswith(f"{mount.sensor}=") for word in words)
            and (topic is None or self.is_mount_of(mount, topic))
        ]
        without = {"strict", *(option.path[0] for option in option_fields(ReadOptions) if f"--{option.name}" in words)}
        kept = {name: value for name, value in self.options.given.items() if name not in without} | {"mounts": mounts}
        command = ["gridtrack", "recording", "import", str(self.path), "--out", f"{stem}.mcap"]
        return shlex.join([*command, *option_words(ReadOptions, kept), *words])

    def is_mount_of(self, mount: Mount, topic: str) -> bool:
        """Whether a mount belongs to the sensor with the scans of `topic`."""
        return topic in (mount.sensor, self.topic_of(mount.sensor))

    def annotations(self, topic: str, *, by_order: bool) -> Iterator[Annotation]:
        """The annotated people on `topic`; `by_order`: each place in an array of poses is a person. RecordingError."""
        raise RecordingError(f"{self.path}: people on '{topic}': only topics of ROS are read; give them as a CSV file")

    def coordinate_frames(self, sensors: Iterable[str]) -> KnownFrames:
        """The frames in which people may be given: the world's, and those of the `sensors`."""
        return {WORLD: None, **{sensor: CarriedFrame(sensor) for sensor in sensors}}

    @abstractmethod
    def read(self, topics: Topics) -> Iterator[Scan]:
        """The scans in the order of the file; counts the messages in `topics`. Raises DamageError at damage."""

    def scans(self, start_s: float | None = None, end_s: float | None = None) -> Iterator[Scan]:
        """Scans with start_s <= stamp < end_s, seconds from the first scan, in the order of their stamps.

        Raises RecordingError if the file has no scans or cannot be read.
        """
        return scans_between(self._in_order(Topics()), start_s, end_s)

    @cached_property
    def survey(self) -> Survey:
        """Statistics of the whole recording, from one pass over it; takes 8 bytes of memory for each scan."""
        topics, survey = Topics(), Survey()
        for scan in self._in_order(topics):
            survey.add(scan)
        for found in self._found_by(survey):
            self.notify(found)
        if problem := self._pose_problem_of(survey):
            self.notify(problem)
        survey.topics = {topic: (kind, topics.counts[topic]) for topic, kind in topics.types.items()}
        return survey

    def recall(self, survey: Survey, warnings: Iterable[str], damage: str) -> None:
        """Use the results of an earlier pass over the same file; the `warnings` are without its path."""
        self.survey, self.damage = survey, damage
        for text in warnings:
            self.notify(text)

    def survey_again(self) -> None:
        """Forget `survey`, `sha256` and the warnings, because the file has grown; the next use finds them again."""
        self.notices.clear()
        for name in ("survey", "sha256"):
            self.__dict__.pop(name, None)

    def check_poses(self) -> None:
        """Raise RecordingError if the sensors have no poses in one frame."""
        if problem := self._pose_problem_of(self.survey):
            raise RecordingError(f"{self.path}: {problem}")

    def _found_by(self, survey: Survey) -> Iterator[Notice]:
        """The notices about the scans; poses from matching the scans are not compared with them."""
        for name, sensor in survey.sensors.items():
            if sensor.alternation.is_found(len(sensor.stamps)):
                yield Notice(
                    text=f"sensor '{name}': its scans alternate between two views, as those of two lasers on one topic"
                    f" do: {self.separate_lasers_with(name)}",
                    kind="the scans alternate between two views, as those of two lasers on one topic do",
                )
        for name, sensor in survey.sensors.items():
            if sensor.bursts:
                remedy = f", or {self.stamp_remedy}" if self.stamp_remedy else ""
                yield Notice(text=f"sensor '{name}': {sensor.bursts}{remedy}", kind=IN_BURSTS)
        yield from survey.notices()
        if not self.pose_problem and not self.info.has_matched_poses:
            yield from islice(self._drifts(survey), 1)

    def _drifts(self, survey: Survey) -> Iterator[Notice]:
        """A notice of each sensor with poses that disagree with its scans."""
        for name, sensor in survey.sensors.items():
            if not sensor.moved:
                text = sensor.rest.unrest(self.import_command(["--ego-motion", "kiss-icp"]))
                kind = "no motion is recorded, but the sensor moves: every score is of moving walls"
            elif turn_deg := sensor.drift.turn_deg:
                text = sensor.drift.wrong_mount(turn_deg, self.mount_remedy(name, turn_deg))
                kind = "the poses disagree with the scans, and agree if the sensor is turned"
            else:
                text = sensor.drift.problem(self.import_command(["--ego-motion", "refined"]))
                kind = "the poses disagree with the scans: trackers with a memory smear the walls and score worse"
            if text:
                yield Notice(text=f"sensor '{name}': {text}", kind=kind)

    def _pose_problem_of(self, survey: Survey) -> str:
        if self.pose_problem or len(survey.sensors) < 2 or len(set(survey.poses.values())) > 1:
            return self.pose_problem
        first, *others = (f"--topic {shlex.quote(self.topic_of(sensor))}" for sensor in survey.sensors)
        return (
            f"several sensors ({', '.join(survey.sensors)}) with the same pose, so that their scans cannot share a"
            f" grid: import one of them with `{self.import_command(shlex.split(first))}`, or {', '.join(others)}"
        )

    def overview(self) -> RecordingOverview:
        """The content of the recording, for `gridtrack recording info`."""
        survey = self.survey
        return RecordingOverview(
            path=str(self.path),
            sha256=self.sha256,
            info=self.info.model_dump(mode="json"),
            topics={topic: f"{kind}, {count}" for topic, (kind, count) in survey.topics.items()},
            duration_s=survey.duration_s,
            sensors={
                name: SensorOverview.of(sensor, poses_known=not self.pose_problem)
                for name, sensor in survey.sensors.items()
            },
            warnings=tuple(self.warnings),
        )

    def warning_texts(self) -> list[str]:
        """The warnings without the path of the recording."""
        return [notice.text for notice in self.notices]

    def warnings_for_copy(self) -> list[str]:
        """The warnings that a copy cannot find itself: all but those about the scans."""
        found = {one.text for one in self._found_by(self.survey)} if "survey" in self.__dict__ else set()
        return [text for text in self.warning_texts() if text not in found]

    def warn(self, text: str) -> None:
        """Add a warning about an error in the file, once. Raises RecordingError instead with the option `strict`."""
        if self.options.strict:
            raise RecordingError(text)
        self.notify(text)

    def notify(self, found: str | Notice) -> None:
        """Add a warning that is not about an error in the file, once."""
        notice = Notice(text=found) if isinstance(found, str) else found
        if notice.text not in self.warning_texts() and len(self.notices) <= MAX_WARNINGS:
            full = len(self.notices) == MAX_WARNINGS
            self.notices.append(Notice(text=NO_MORE_WARNINGS) if full else notice)

    def _in_order(self, topics: Topics) -> Iterator[Scan]:
        order = StampOrder(self.warn, lambda: self.stamp_remedy)
        try:
            for scan in filter(self._is_known, self._before_damage(topics)):
                yield from order.push(self._as_options_say(scan))
            yield from order.flush()
            if order.empty:
                raise NoScansError(self.why_no_scans(topics))
        except RecordingError as error:
            raise type(error)(f"{self.path}: {str(error).removeprefix(f'{self.path}: ')}") from None
        except OSError as error:
            raise RecordingError(f"{self.path}: cannot be read ({error.strerror})") from None

    def _is_known(self, scan: Scan) -> bool:
        """Whether the sensor existed when following a growing file began."""
        if self.growth is None or self.growth.sensors is None or scan.sensor in self.growth.sensors:
            return True
        self.notify(
            f"sensor '{scan.sensor}' has its first scan after the comparison began: it is left out; compare the"
            " finished file to include it"
        )
        return False

    def _as_options_say(self, scan: Scan) -> Scan:
        """The scan with the meaning of its numbers that the options give."""
        return with_meaning(scan, self.options)

    def _before_damage(self, topics: Topics) -> Iterator[Scan]:
        try:
            yield from self.read(topics)
        except DamageError as damage:
            self.damage = str(damage)
            self.warn(f"{damage}; the rest is left out")

    def why_no_scans(self, topics: Topics) -> str:
        """Why no scan was found, and the remedy."""
        topic = self.options.topic
        present = ", ".join(f"{name} ({kind})" for name, kind in sorted(topics.types.items())) or "none"
        if self.notices:
            last = self.notices[-1].text
            if self.damage:
                return f"no scans before the damage ({last}): copy the file again from its origin, or repair it"
            return f"no scan can be used: {last}"
        if topic is not None and topic not in topics.types:
            return f"no topic '{topic}'; {did_you_mean(topic, topics.scans or topics.types)}"
        if topic is not None and topic not in topics.scans:
            scans = ", ".join(sorted(topics.scans)) or "none"
            return f"topic '{topic}' is {topics.types[topic]}, not scans; topics with scans: {scans}"
        return f"no scans; topics: {present}"
