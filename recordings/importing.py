"""Importing a recording: written as a native one, with site, grid, stretches, labels and annotated people."""

from __future__ import annotations

import csv
import hashlib
import json
import shlex
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from importlib.metadata import version
from itertools import groupby
from pathlib import Path
from typing import Annotated, Any, NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from gridtrack.common.config import validated
from gridtrack.common.errors import RecordingError, did_you_mean
from gridtrack.common.files import atomic_write, check_path, name_from, user_cache_folder
from gridtrack.common.options import Option, from_texts, option_words
from gridtrack.common.scan import Scan
from gridtrack.common.scene import UNLABELLED
from gridtrack.recordings.formats.native import write_native
from gridtrack.recordings.frames.trajectory import ClocksApartError
from gridtrack.recordings.opening import open_recording
from gridtrack.recordings.people import (
    People,
    PeopleSource,
    SensorPaths,
    parse_people,
    placed_people,
    read_people,
    with_people,
)
from gridtrack.recordings.read_options import NO_POSES, PoseSource, ReadOptions, reading_options
from gridtrack.recordings.recording import Recording
from gridtrack.recordings.recording_info import RecordingInfo, Stretch, stretch_text
from gridtrack.recordings.stretches import parse_named_stretch, stretch_of

MATCHING_VERSION = 1
"""Increases with every change to the poses that are found in the same scans."""


class ImportSettings(ReadOptions):
    """What an import adds to a recording or changes in it, and how the recording is read."""

    site: Annotated[str | None, Option(metavar="SITE")] = None
    """The site of the sensor"""
    grid: Annotated[str | None, Option(metavar="CELLSxMETRES[@X,Y]")] = None
    """Grid, such as 100x0.2; default: the grid of the recording"""
    licence: Annotated[str, Option(metavar="TEXT")] = ""
    """Licence of the recording"""
    credit: Annotated[str, Option(metavar="TEXT")] = ""
    """Authors of the recording"""
    rate_hz: float | None = None
    """Frames per second; default: the rate of the recording"""
    stretches: Annotated[
        dict[str, Stretch],
        from_texts(parse_named_stretch),
        Option("stretch", "NAME=RANGE", texts=lambda named: (f"{name}={stretch_text(named[name])}" for name in named)),
    ] = Field(default_factory=dict)
    """Stretch, such as train=0s-75s; repeat for several"""
    labels: Annotated[Path | None, Option(metavar="FILE", texts=lambda path: [path.name])] = None
    """CSV of the class of each beam"""
    people: Annotated[str | None, Option(metavar="TOPIC|CSV", texts=lambda text: [str(parse_people(text))])] = None
    """Annotated positions of persons: a topic or FILE.csv, with @FRAME if they name no frame"""
    people_by_order: bool = False
    """Each place in an array of poses is one person"""
    people_delay_s: float = Field(default=0.0, allow_inf_nan=True)
    """How much later than the scans the people are stamped"""
    ego_motion: Annotated[PoseSource, Option(metavar="SOURCE")] = "recorded"
    """Source of the poses: recorded; kiss-icp, from the scans alone; refined, from the scans with the recorded motion
    as a prior"""


METADATA = ("site", "grid", "licence", "credit", "rate_hz", "stretches")
"""Fields of the settings that replace those of RecordingInfo."""


def import_recording(source: Path | str, out: Path | str, *, overwrite: bool = False, **options: Any) -> Recording:
    """Write the recording at `source`, in any format, as a native one at `out`, and open it.

    Ranges are copied exactly, including NaN and infinities; only `no_return` makes codes infinite. The same source and
    options give the same bytes. Warnings about the file are written too, so reading the result repeats them. `options`
    are the fields of ImportSettings; `site` defaults to the site in the source, or to its file name. With `ego_motion`
    "kiss-icp" a single sensor needs no usable recorded poses. An existing file at `out` is replaced only with
    `overwrite`. Raises RecordingError and ConfigurationError; `out` is then not changed.
    """
    out = Path(out)
    check_path(out, RecordingError)
    settings = validated(ImportSettings, options, "import")
    recording = _opened(source, options, settings.ego_motion)
    _check_destination(out, recording, overwrite)
    people: PeopleSource | None = None
    if settings.people is not None:
        people = parse_people(settings.people, by_order=settings.people_by_order, delay_s=settings.people_delay_s)
    for stretch in settings.stretches.values():
        stretch_of(recording, stretch)
    info = _info(recording, out, settings)
    if recording.pose_problem:
        raise RecordingError(f"{recording.path}: {recording.pose_problem}")
    posed: Callable[[], Iterable[Scan]] = recording.scans
    if settings.ego_motion != "recorded":
        info, posed = _with_matched_poses(info, recording, settings.ego_motion)
    scans = posed()
    if settings.labels is not None:
        scans = with_labels(scans, settings.labels, info.classes)
    if people is not None:
        found = _people_in(recording, people, SensorPaths(posed()), settings.ego_motion)
        scans = with_people(scans, found, recording.notify)
    _write(out, info, scans, recording.warnings_for_copy)
    return open_recording(out, strict=recording.options.strict)


def posed_copy(path: Path, ego_motion: PoseSource, format: str | None, note: Callable[[str], None]) -> Path:
    """A native copy of the recording at `path` with poses from `ego_motion`; `path` itself if it has them.

    The copy is kept in `$XDG_CACHE_HOME/gridtrack/recordings` under the recording's name, and made again if the file
    has changed; `note` receives a line before that. Raises RecordingError and PluginError.
    """
    if ego_motion == "recorded":
        return path
    recording = open_recording(path, format=format)
    if recording.info.poses.startswith(f"{ego_motion}:"):
        return path
    key = [recording.sha256, version("gridtrack"), MATCHING_VERSION, ego_motion, format]
    folder = user_cache_folder() / "recordings" / hashlib.sha256(json.dumps(key).encode()).hexdigest()[:32]
    copy = folder / f"{name_from(path)}.mcap"
    if not copy.exists():
        note(f"{path}: taking the poses from the scans (--ego-motion {ego_motion})")
        import_recording(path, copy, ego_motion=ego_motion, format=format)
    return copy


def _opened(source: Path | str, options: Mapping[str, Any], ego_motion: PoseSource) -> Recording:
    """The source, opened without its poses if they cannot be used and are not needed."""
    reading = reading_options(options)
    recording = open_recording(source, **reading)
    if ego_motion == "kiss-icp" and not _can_use_poses(recording):
        recording = open_recording(source, **{**reading, "pose_topic": NO_POSES})
    return recording


def _can_use_poses(recording: Recording) -> bool:
    """Whether the recorded poses can be used, or are needed for several sensors."""
    try:
        several = len(recording.survey.sensors) > 1
    except ClocksApartError:
        return False
    return several or not recording.pose_problem


def _check_destination(out: Path, recording: Recording, overwrite: bool) -> None:
    if out.suffix != ".mcap":
        raise RecordingError(f"{out}: a recording is written as .mcap")
    in_source = out.resolve().parent == recording.path.resolve()  # a bag that is a folder
    if in_source or (out.exists() and out.samefile(recording.path)):
        raise RecordingError(f"{out}: is the source itself, or in its folder; choose another place for the result")
    if out.exists() and not overwrite:
        raise RecordingError(
            f"{out}: exists already; choose another place for the result, or replace it with --overwrite"
        )


def _with_matched_poses(
    info: RecordingInfo, recording: Recording, ego_motion: PoseSource
) -> tuple[RecordingInfo, Callable[[], Iterator[Scan]]]:
    """The metadata that describes the poses of the matches, and the scans with these poses."""
    from gridtrack.recordings.ego_motion import matched_trajectory, with_matched_poses

    if ego_motion == "refined" and not recording.survey.moves:
        raise RecordingError(
            f"{recording.path}: the recorded poses do not change, so that there is no motion to refine: --ego-motion"
            " kiss-icp takes the poses from the scans alone"
        )
    trajectory = matched_trajectory(recording.scans(), ego_motion)
    described = info.model_copy(update={"poses": trajectory.describe(ego_motion)})
    has_people = any(sensor.with_people for sensor in recording.survey.sensors.values())
    return described, lambda: with_matched_poses(recording.scans(), trajectory, has_people=has_people)


def _people_in(
    recording: Recording, source: PeopleSource, paths: SensorPaths, ego_motion: PoseSource
) -> dict[float, People]:
    """The people by their delay; with poses from the scans only in frames that a sensor carries. RecordingError."""
    frames = recording.coordinate_frames(paths.poses)
    if ego_motion != "recorded":
        frames = {name: carried for name, carried in frames.items() if carried is not None}
    if source.is_file:
        annotations = read_people(Path(source.name), paths.first_ns)
    else:
        annotations = recording.annotations(source.name, by_order=source.by_order)
    return placed_people(source, annotations, paths, frames, recording.notify)


def _info(recording: Recording, out: Path, settings: ImportSettings) -> RecordingInfo:
    """The metadata of the source, replaced by the given values, with the command that repeats the import."""
    values = recording.info.model_dump() | {name: value for name in METADATA if (value := getattr(settings, name))}
    if not recording.info.source_sha256:  # else the source was imported itself: its own source identifies it
        values |= {"source": recording.name, "source_sha256": recording.sha256}
    if settings.labels is not None:
        values["classes"] = classes_in(settings.labels)
    given = {**settings.given, **recording.options.given, "strict": False}
    words = ["--out", out.name, *option_words(ImportSettings, given)]  # without the folders of this machine
    command = shlex.join(["gridtrack", "recording", "import", recording.name, *words])
    return validated(RecordingInfo, values | {"command": command}, "import")


def _write(out: Path, info: RecordingInfo, scans: Iterable[Scan], warnings: Callable[[], Sequence[str]]) -> None:
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(out) as file:
            write_native(file, info, scans, warnings)
    except OSError as error:
        raise RecordingError(f"{out}: cannot be written ({error.strerror})") from None


class BeamLabel(NamedTuple):
    """One row of the CSV file of labels, `stamp_ns,beam,class[,sensor]`: the class of one beam."""

    stamp_ns: int
    sensor: str
    beam: int
    name: str
    line: int


def classes_in(path: Path) -> tuple[str, ...]:
    """The classes in the CSV file, sorted. Raises RecordingError."""
    names = {label.name for label in _read_labels(path)}
    if len(names) > UNLABELLED:
        raise RecordingError(f"{path}: {len(names)} classes; at most {UNLABELLED}")
    return tuple(sorted(names))


def with_labels(scans: Iterable[Scan], path: Path, classes: tuple[str, ...]) -> Iterator[Scan]:
    """`scans` with the labels of the CSV file; its rows are sorted by stamp.

    A row without a sensor labels the sensor `scan`. Raises RecordingError for a row without a scan.
    """
    index = {name: i for i, name in enumerate(classes)}
    groups = groupby(_read_labels(path), key=lambda row: (row.stamp_ns, row.sensor))
    pending: dict[tuple[int, str], list[BeamLabel]] = {}
    read_to_ns = -1
    for scan in scans:
        while read_to_ns <= scan.stamp_ns and (group := next(groups, None)) is not None:
            key, rows = group
            if key[0] < read_to_ns:
                raise RecordingError(
                    f"{path}, line {next(rows).line}: a stamp before that of the row above; sort the rows by stamp"
                )
            read_to_ns = key[0]
            pending.setdefault(key, []).extend(rows)  # rows of sensors that share a stamp may alternate
        labels = pending.pop((scan.stamp_ns, scan.sensor), None)
        yield scan if labels is None else replace(scan, labels=_labels(labels, scan, index, path))
        for key in [key for key in pending if key[0] < scan.stamp_ns]:
            _raise_no_scan(pending[key][0], path)
    for rest in pending.values():
        _raise_no_scan(rest[0], path)
    for _, rows in groups:
        _raise_no_scan(next(rows), path)


def _raise_no_scan(row: BeamLabel, path: Path) -> NoReturn:
    raise RecordingError(f"{path}, line {row.line}: no scan of sensor '{row.sensor}' is stamped {row.stamp_ns}")


def _labels(rows: list[BeamLabel], scan: Scan, index: dict[str, int], path: Path) -> NDArray[np.uint8]:
    labels = np.full(scan.ranges.size, UNLABELLED, np.uint8)
    for row in rows:
        if row.name not in index:
            raise RecordingError(f"{path}, line {row.line}: no class '{row.name}'; {did_you_mean(row.name, index)}")
        if not 0 <= row.beam < labels.size:
            raise RecordingError(f"{path}, line {row.line}: beam {row.beam} of a scan of {labels.size} beams")
        labels[row.beam] = index[row.name]
    return labels


def _read_labels(path: Path) -> Iterator[BeamLabel]:
    try:
        with path.open(newline="", encoding="utf-8") as file:
            reader = csv.DictReader(file, restval="")
            if not {"stamp_ns", "beam", "class"} <= set(reader.fieldnames or ()):
                raise RecordingError(f"{path}: expected the columns stamp_ns, beam, class and optionally sensor")
            for row in reader:
                try:
                    stamp_ns, beam = int(row["stamp_ns"]), int(row["beam"])
                except ValueError as error:
                    raise RecordingError(f"{path}, line {reader.line_num}: {error}") from None
                yield BeamLabel(stamp_ns, row.get("sensor") or "scan", beam, row["class"], reader.line_num)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read ({error.strerror})") from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise RecordingError(f"{path}: not a CSV in UTF-8 ({error})") from None
