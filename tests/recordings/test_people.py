"""Annotated people: read from CSV files and topics, placed in the world, interpolated, and kept by the import."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gridtrack.common.errors import ConfigurationError, RecordingError
from gridtrack.common.geometry import SE2
from gridtrack.common.scan import Scan
from gridtrack.common.scene import Person
from gridtrack.recordings import import_recording, open_recording
from gridtrack.recordings.ego_motion.estimation import MatchedTrajectory, with_matched_poses
from gridtrack.recordings.stream import open_stream


@pytest.fixture
def source(scan, write) -> Path:
    """Three seconds at 10 Hz of a sensor that drives along x at 1 m/s and turns by a quarter after 1.5 s."""
    poses = [SE2(0.1 * k, 0.0, 0.0 if k < 15 else math.pi / 2) for k in range(31)]
    return write([scan(k, pose=pose) for k, pose in enumerate(poses)])


@pytest.fixture
def imported(source: Path, tmp_path: Path) -> Callable[..., list[Scan]]:
    """The scans of the import of `source` with people from this CSV text."""

    def with_csv(text: str, frame: str = "", **options: object) -> list[Scan]:
        csv = tmp_path / "people.csv"
        csv.write_text(text)
        people = f"{csv}@{frame}" if frame else str(csv)
        return list(import_recording(source, tmp_path / "out.mcap", people=people, **options).scans())

    return with_csv


def people_at(scans: list[Scan], tenths: int) -> tuple[Person, ...] | None:
    return scans[tenths].people


def places(people: tuple[Person, ...] | None) -> dict[int, tuple[float, float]]:
    return {one.track: (round(one.x, 6), round(one.y, 6)) for one in people or ()}


def test_positions_are_interpolated_at_the_scans_between_the_first_and_the_last(imported) -> None:
    scans = imported("time_s,id,x,y\n0.5,7,1,2\n1.3,7,1,2.8\n")
    assert people_at(scans, 4) is None, "before the first"
    assert places(people_at(scans, 9)) == {7: (1.0, 2.4)}
    assert people_at(scans, 9)[0].speed_mps == pytest.approx(1.0)
    assert people_at(scans, 14) is None, "after the last"


def test_stamps_may_be_those_of_the_scans(imported, scan) -> None:
    rows = "".join(f"{scan(k).stamp_ns},1,{k},0\n" for k in range(3))
    assert [places(one.people) for one in imported(f"stamp_ns,id,x,y\n{rows}")[:4]] == [
        {1: (0.0, 0.0)},
        {1: (1.0, 0.0)},
        {1: (2.0, 0.0)},
        {},
    ]


def test_nobody_is_carried_over_a_pause_of_more_than_a_second(imported) -> None:
    scans = imported("time_s,id,x,y\n0,1,0,0\n0.4,1,1,0\n1.5,1,2,0\n0.4,2,5,5\n1.2,2,5,5\n")
    assert places(people_at(scans, 4)) == {1: (1.0, 0.0), 2: (5.0, 5.0)}
    assert places(people_at(scans, 8)) == {2: (5.0, 5.0)}, "another person is annotated there"
    scans = imported("time_s,id,x,y\n0,1,0,0\n0.4,1,1,0\n1.5,1,2,0\n2,1,2,0\n", overwrite=True)
    assert people_at(scans, 8) is None, "nobody is: that may mean that nobody looked"
    assert places(people_at(scans, 16)) == {1: (2.0, 0.0)}


def test_the_speed_is_over_a_second_and_not_over_the_noise_of_an_annotation(imported) -> None:
    rows = "".join(f"{0.1 * k:.1f},1,{0.05 * (k % 2)},0\n" for k in range(21))
    assert people_at(imported(f"time_s,id,x,y\n{rows}"), 10)[0].speed_mps < 0.1


def test_positions_in_the_frame_of_a_sensor_move_and_turn_with_it(imported) -> None:
    scans = imported("time_s,id,x,y\n1,3,2,0.5\n2,3,2,0.5\n", frame="scan")
    assert places(people_at(scans, 10)) == {3: (3.0, 0.5)}
    assert places(people_at(scans, 20)) == {3: (1.5, 2.0)}
    assert places(people_at(imported("time_s,id,x,y,frame\n1,3,2,0.5,scan\n", overwrite=True), 10)) == {3: (3.0, 0.5)}


def test_a_second_import_keeps_the_people_and_the_command_repeats_the_first(imported, tmp_path) -> None:
    scans = imported("time_s,id,x,y\n0.5,7,1,2\n1.3,7,1,2.8\n")
    again = import_recording(tmp_path / "out.mcap", tmp_path / "again.mcap")
    assert [one.people for one in again.scans()] == [one.people for one in scans]
    assert open_recording(tmp_path / "out.mcap").info.command.endswith("--people people.csv")
    assert "9 scans with annotated people" in str(again.overview())


def test_other_annotations_replace_all_that_were_there(imported, tmp_path) -> None:
    imported("time_s,id,x,y\n0,7,1,2\n0.5,7,1,2\n")
    (tmp_path / "other.csv").write_text("time_s,id,x,y\n1,8,0,0\n1.5,8,0,0\n")
    again = import_recording(tmp_path / "out.mcap", tmp_path / "again.mcap", people=str(tmp_path / "other.csv"))
    assert {one.track for scan in again.scans() for one in scan.people or ()} == {8}


def test_a_stretch_has_people_where_it_meets_the_annotated_time(imported, tmp_path, source) -> None:
    imported("time_s,id,x,y\n1,7,1,2\n1.5,7,1,2.8\n")
    out = tmp_path / "out.mcap"
    found = [open_stream(f"{out}@{stretch}").has_people for stretch in ("0s-0.8s", "0.5s-1.2s", "1.8s-3s")]
    assert found == [False, True, False]
    assert not open_stream(source).has_people
    assert not open_stream(out).has_truth


def test_people_stay_in_the_world_of_the_recorded_poses_when_others_are_matched(scan) -> None:
    scans = [replace(scan(k), people=None if k else ()) for k in range(2)]
    poses = [SE2(9.0), SE2(9.5)]
    trajectory = MatchedTrajectory("scan", [one.stamp_ns for one in scans], [SE2(), SE2()], poses, [None, None])
    found = list(with_matched_poses(scans, trajectory, has_people=True))
    assert [(one.world_T_sensor.x, one.reference_T_sensor) for one in found] == [(9.0, SE2()), (9.5, SE2())]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("id,x,y\n1,2,3\n", "expected the columns stamp_ns or time_s"),
        ("stamp_ns,time_s,id,x,y\n1,1,2,3\n", "expected the columns stamp_ns or time_s"),
        ("time_s,id,x,y\n", "no positions of people"),
        ("time_s,id,x,y\n1,,0,0\n", "line 2: no id"),
        ("time_s,id,x,y\n1,anna,0,0\n", "line 2: invalid literal"),
        ("time_s,id,x,y\n1,-1,0,0\n", "line 2: an id of -1"),
        ("time_s,id,x,y\n1,9999999999999999999999,0,0\n", "line 2: an id of"),
        ("time_s,id,x,y\n1,1,nan,0\n", "line 2: a person at nan, 0"),
        ("time_s,id,x,y\n1,1,1e300,0\n", "line 2: a person at"),
        ("time_s,id,x,y\n1,1,0\n", "line 2: could not convert"),
        ("time_s,id,x,y\ninf,1,0,0\n", "line 2: a time of inf s"),
        ("time_s,id,x,y\n1e30,1,0,0\n", "line 2: a time of"),
        ("time_s,id,x,y\n1,1,0,0\n1,1,2,0\n", "person 1 has two positions at"),
        ("time_s,id,x,y\n500,1,0,0\n501,1,0,0\n", "its 2 positions are from 500.0 s to 501.0 s after the first scan"),
        ("time_s,id,x,y,frame\n1,1,0,0,map\n", "in the frame 'map': known: scan, world"),
        ("time_s,id,x,y,frame\n1,1,0,0,map\x1b[31m\n", "in the frame"),
        ('time_s,id,x,y,frame\n1,1,0,0,"a\nb"\n', "in the frame 'a"),
        (f"time_s,id,x,y\n1,{'9' * 5000},0,0\n", "line 2: Exceeds the limit"),
        (f"time_s,id,x,y\n1,{'a' * 200_000},0,0\n", "not a CSV in UTF-8 (field larger than field limit"),
        ("\x00\x01", "expected the columns"),
    ],
)
def test_a_hostile_file_is_one_line_and_nothing_is_written(imported, tmp_path, text, message) -> None:
    with pytest.raises(RecordingError) as raised:
        imported(text)
    assert message in str(raised.value)
    assert not (tmp_path / "out.mcap").exists()


def test_what_is_left_out_is_one_line_with_numbers(imported, tmp_path) -> None:
    imported("time_s,id,x,y\n-5,1,0,0\n0,1,0,0\n0.5,1,0,0\n0.5,2,0,0\n2,1,0,0\n2.5,1,0,0\n")
    text = next(one for one in open_recording(tmp_path / "out.mcap").overview().warnings if "people of" in one)
    assert text.endswith(
        "people of people.csv: 6 positions of 2 persons; 1 outside of the recording's time; 1 without another of the"
        " same person within 1 s; 1.5 s of pauses longer than 1 s are not annotated"
    )


@pytest.mark.parametrize(("x", "warned"), [(500.0, True), (None, False)])
def test_persons_far_from_every_return_are_a_warning(imported, source, tmp_path, x, warned) -> None:
    scan = list(open_recording(source).scans())[5]
    bearing = scan.angle_min + 10 * scan.angle_increment
    at = (x, 0.0) if x else (0.5 + scan.ranges[10] * math.cos(bearing), scan.ranges[10] * math.sin(bearing))
    imported(f"time_s,id,x,y\n0.5,1,{at[0]},{at[1]}\n")
    warnings = open_recording(tmp_path / "out.mcap").overview().warnings
    assert any("1 of 1 persons at the stamps of scans have no return within 0.4 m" in one for one in warnings) is warned


def test_people_of_a_file_without_topics_come_from_a_csv(source, tmp_path) -> None:
    with pytest.raises(RecordingError, match="people on '/people': only topics of ROS are read"):
        import_recording(source, tmp_path / "out.mcap", people="/people")


def test_with_poses_from_the_scans_the_recorded_world_is_no_frame_for_people(source, tmp_path) -> None:
    (tmp_path / "p.csv").write_text("time_s,id,x,y\n1,1,0,0\n")
    with pytest.raises(RecordingError, match=r"name no frame: add it, --people p\.csv@FRAME, one of scan"):
        import_recording(source, tmp_path / "out.mcap", people=str(tmp_path / "p.csv"), ego_motion="kiss-icp")


def test_a_damaged_message_of_people_ends_the_recording_with_a_warning(scan, write) -> None:
    scans = [replace(scan(k), people=(Person(1, 0.0, 0.0, 1.0 if k < 3 else math.nan),)) for k in range(5)]
    recording = open_recording(write(scans))
    assert len(list(recording.scans())) == 3
    assert "a person of /people at 0, 0 with a speed of 'nan'" in recording.warnings[0]


@pytest.mark.parametrize(("delay_s", "said"), [(0.0, "0.100"), (0.1, "")])
def test_annotations_stamped_a_scan_late_are_found_by_their_distance_from_the_returns(
    scan, write, tmp_path, delay_s, said
) -> None:
    """A walker at 2 m/s is the only return; the rows are of the walker one scan before."""
    ranges = np.full((30, 36), np.inf, np.float32)
    ranges[:, 0] = 1.0 + 0.2 * np.arange(30)
    far = {"angle_min": 0.0, "range_max": 20.0}
    source = write([replace(scan(k), ranges=own, **far) for k, own in enumerate(ranges)])
    rows = "".join(f"{0.1 * (k + 1):.1f},1,{1.0 + 0.2 * k:.1f},0\n" for k in range(29))
    (tmp_path / "p.csv").write_text(f"time_s,id,x,y\n{rows}")
    people = {"people": str(tmp_path / "p.csv"), "people_delay_s": delay_s}
    found = import_recording(source, tmp_path / "out.mcap", **people)
    assert places(next(iter(found.scans())).people) == ({1: (1.0, 0.0)} if delay_s else {})
    warnings = [one for one in found.overview().warnings if "--people-delay" in one]
    assert [one.rsplit(" ", 1)[1] for one in warnings] == ([said] if said else [])
    assert ("--people-delay 0.1" in found.info.command) is bool(delay_s)


def test_a_delay_without_end_is_refused(imported) -> None:
    with pytest.raises(ConfigurationError, match="--people-delay nan: expected seconds"):
        imported("time_s,id,x,y\n1,1,0,0\n", people_delay_s=math.nan)
