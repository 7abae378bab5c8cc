"""Annotations become tracks in metres, y up, with headings along the motion."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest

from gridtrack.common.errors import RecordingError
from gridtrack.recordings import open_recording
from gridtrack.simulation.stanford import Video, read_stanford
from gridtrack.simulation.tracks_file import write_recording

VIDEO = Video(scale=0.05, site="quad", laser_at=(10.0, -20.0))


def line(track: int, x: float, y: float, frame: int, label: str, lost: int = 0, wide: float = 20, high: float = 20):
    corners = (x - wide / 2, y - high / 2, x + wide / 2, y + high / 2)
    return " ".join(map(str, (track, *corners, frame, lost, 0, 0))) + f' "{label}"'


def written(path: Path, lines: Iterable[str]) -> Path:
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture
def annotations(tmp_path: Path) -> Path:
    """Five seconds: someone walks down the picture at 1.5 m/s, out of view for a second; a cyclist stands behind; a
    car is parked."""
    lines = [line(7, 100, 100 + frame, frame, "Pedestrian", lost=int(60 <= frame < 90)) for frame in range(150)]
    lines += [line(2, 200 + 2 * frame, 400, frame, "Biker") for frame in range(150)]
    lines += [line(9, 300, 700, frame, "Car", wide=40, high=90) for frame in range(150)]
    return written(tmp_path / "annotations.txt", lines)


def test_paths_are_in_metres_with_y_up_at_the_rate_of_the_recording(annotations: Path) -> None:
    tracks = read_stanford(annotations, VIDEO)
    assert tracks.info.frames == 40
    walker = tracks.pose[tracks.label == 0]
    frame = tracks.frame[tracks.label == 0]
    middle = slice(6, 10)
    assert walker[middle, 0] == pytest.approx(5.0)
    assert walker[middle, 1] == pytest.approx(-(100 + frame[middle] / 8.0 * 30.0) * 0.05, abs=0.02)


def test_headings_follow_the_motion_or_the_longer_side_of_the_box(annotations: Path) -> None:
    tracks = read_stanford(annotations, VIDEO)
    for label, heading in ((0, -np.pi / 2), (1, 0.0), (2, np.pi / 2)):
        assert tracks.pose[tracks.label == label, 2] == pytest.approx(heading, abs=0.002)


def test_a_road_user_that_leaves_the_view_returns_as_another_track(annotations: Path) -> None:
    tracks = read_stanford(annotations, VIDEO)
    walker = tracks.label == 0
    assert np.unique(tracks.track[walker]).size == 2
    assert not set(tracks.frame[walker]) & set(range(17, 24))


def test_labels_have_the_classes_and_bodies_of_the_junction(tmp_path: Path) -> None:
    labels = ("Pedestrian", "Skater", "Biker", "Cart", "Car", "Bus")
    lines = [line(k, 100 * k, 0, frame, label) for k, label in enumerate(labels) for frame in range(30)]
    tracks = read_stanford(written(tmp_path / "a.txt", lines), VIDEO)
    names = [tracks.info.recording.classes[label] for label in tracks.label[tracks.frame == 0]]
    assert names == ["pedestrian", "pedestrian", "cyclist", "car", "car", "bus"]
    assert tracks.size[tracks.frame == 0][-1].tolist() == [11.5, 2.55]


def test_the_laser_sees_them(annotations: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    write_recording(tmp_path / "quad.tracks", read_stanford(annotations, VIDEO))
    scans = list(open_recording(tmp_path / "quad.tracks").scans())
    assert len(scans) == 40
    assert {0, 1, 2} <= set(np.unique(np.concatenate([scan.labels for scan in scans])))


def test_the_laser_gets_a_position_clear_of_road_users(annotations: Path) -> None:
    tracks = read_stanford(annotations, Video(scale=0.05, site="quad"))
    laser = tracks.info.lasers["scan"]
    assert np.hypot(*(tracks.pose[:, :2] - (laser.x, laser.y)).T).min() > 0.75


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no road user is ever in view"),
        (line(1, 5, 5, 0, "Pedestrian", lost=1), "no road user is ever in view"),
        ("1 2 3 4 5", "line 1: expected `track xmin"),
        (line(1, 5, 5, 0, "Ghost"), "line 1: expected .* with one of Pedestrian, Skater"),
        (line(1, 5, 5, 0, "Car").replace(" 0 0 0 ", " 0 zero 0 "), "line 1: a value is not a number"),
        (line(1, float("nan"), 5, 0, "Car"), "line 1: a track, box or frame outside the valid range"),
        (line(1, 5, 5, -1, "Car"), "line 1: a track, box or frame outside the valid range"),
        (line(1, 5, 5, 10**12, "Car"), "line 1: a track, box or frame outside the valid range"),
        (line(1, 5e9, 5, 0, "Car"), "line 1: a track, box or frame outside the valid range"),
    ],
)
def test_the_error_for_an_invalid_annotation_names_its_line(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(RecordingError, match=message):
        read_stanford(written(tmp_path / "a.txt", [text]), VIDEO)


def test_a_missing_file_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="cannot be read"):
        read_stanford(tmp_path / "nowhere.txt", VIDEO)
