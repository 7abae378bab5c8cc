"""The true scene round-trips with its scan, in messages that Foxglove draws."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from gridtrack.common.errors import RecordingError
from gridtrack.common.geometry import SE2
from gridtrack.common.scene import Scene, SceneObject
from gridtrack.recordings import open_recording
from gridtrack.recordings.file_reading import DamageError
from gridtrack.recordings.native_messages import OBJECTS, OUTLINES, SceneReader, SceneWriter

CLASSES = ("pedestrian", "car", "static")
BOX = np.array([[-2, -1], [2, -1], [2, 1], [-2, 1 / 3]], np.float32)
WALLS = (BOX + np.float32(20), np.array([[0, 0], [1, 0], [0, 1]], np.float32))


def scene(k: int) -> Scene:
    """Two road users; the second is in every other scan only."""
    walker = SceneObject(3, 0, SE2(0.1 * k, 1 / 7, 0.3), BOX / np.float32(4))
    car = SceneObject(4_000_000_000, 1, SE2(-k, 0.0, -3.1), BOX)
    return Scene(WALLS, 2, (walker, car) if k % 2 else (walker,))


def assert_same_scene(found: Scene | None, expected: Scene) -> None:
    assert found is not None
    assert found.static_label == expected.static_label
    for a, b in zip(found.static, expected.static, strict=True):
        np.testing.assert_array_equal(a, b)
    for a, b in zip(found.objects, expected.objects, strict=True):
        assert (a.track, a.label) == (b.track, b.label)
        assert (a.world_T_object.x, a.world_T_object.y) == (b.world_T_object.x, b.world_T_object.y)
        assert a.world_T_object.theta == pytest.approx(b.world_T_object.theta, abs=1e-12)
        np.testing.assert_array_equal(a.outline, b.outline)
        assert a.outline.dtype == np.float32


@pytest.fixture
def recording(write, scan) -> Path:
    return write([replace(scan(k), scene=scene(k)) for k in range(20)], classes=CLASSES)


def test_every_scan_round_trips_with_its_scene(recording: Path) -> None:
    for k, found in enumerate(open_recording(recording).scans()):
        assert_same_scene(found.scene, scene(k))


def test_an_empty_scene_round_trips(write, scan) -> None:
    (found,) = open_recording(write([replace(scan(0), scene=Scene((), 255, ()))], classes=CLASSES)).scans()
    assert found.scene == Scene((), 255, ())


def test_a_scan_without_truth_does_not_get_the_scene_of_the_scan_before(write, scan) -> None:
    path = write([replace(scan(0), scene=scene(0)), scan(1)], classes=CLASSES)
    assert [found.scene is not None for found in open_recording(path).scans()] == [True, False]


def test_sensors_that_scan_at_once_share_the_scene(write, scan) -> None:
    both = [replace(scan(k, sensor), scene=scene(k)) for k in range(3) for sensor in ("front", "rear")]
    path = write(both, classes=CLASSES)
    for found, expected in zip(open_recording(path).scans(), both, strict=True):
        assert_same_scene(found.scene, expected.scene)
    for found in open_recording(path, topic="/scan/rear").scans():
        assert found.scene is not None


def test_static_outlines_are_written_once(recording: Path) -> None:
    topics = open_recording(recording).overview().topics
    assert topics[OUTLINES] == "foxglove.SceneUpdate, 1"
    assert topics[OBJECTS] == "foxglove.SceneUpdate, 20"


def test_the_overview_counts_truth(recording: Path, write, scan) -> None:
    text = str(open_recording(recording).overview())
    assert "20 scans with truth" in text
    assert "classes: pedestrian, car, static" in text
    assert "with truth" not in str(open_recording(write([scan(0)], "bare.mcap")).overview())


def test_the_messages_place_the_outlines_at_the_poses(recording: Path) -> None:
    with recording.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        updates = [m.decoded_message for m in reader.iter_decoded_messages(topics=[OBJECTS])]
    entity = updates[1].entities[1]
    assert (entity.id, entity.frame_id, entity.metadata[0].value) == ("4000000000", "world", "car")
    line = entity.lines[0]
    assert line.pose.position.x == -1.0
    assert [[p.x, p.y] for p in line.points] == BOX.tolist()
    assert line.color.a == 1.0


def test_an_object_of_an_unknown_class_is_refused(write, scan) -> None:
    with pytest.raises(RecordingError, match="'static 0' is of class 2; the recording names only 0"):
        write([replace(scan(0), scene=scene(0))])


def changed_message(change: Callable[[SceneUpdate], object]) -> bytes:
    update = SceneWriter(CLASSES).objects(scene(1), 7)
    change(update)
    return update.SerializeToString()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda u: u.entities[0].lines.add(), "has 2 lines; expected its outline"),
        (lambda u: u.entities[0].ClearField("lines"), "has 0 lines"),
        (lambda u: u.entities[0].lines[0].ClearField("points"), "not an outline of 3 to 1024 corners"),
        (
            lambda u: [u.entities[0].lines[0].points.add(x=1.0) for _ in range(2000)],
            "not an outline of 3 to 1024 corners",
        ),
        (lambda u: [u.entities.add() for _ in range(5000)], "5002 entities in a message of /objects; at most 4096"),
        (lambda u: setattr(u.entities[0].lines[0].points[0], "x", float("nan")), "a corner that is not finite"),
        (lambda u: setattr(u.entities[0].lines[0].pose.position, "y", float("inf")), "expected a finite pose"),
        (lambda u: setattr(u.entities[0].metadata[0], "value", "<b>ghost"), "a class that the recording does not name"),
        (lambda u: setattr(u.entities[0], "id", "-3"), "not a track number"),
        (lambda u: setattr(u.entities[0], "id", "9" * 5000), "not a track number"),
    ],
)
def test_an_invalid_message_is_one_clear_line(change: Callable[[SceneUpdate], object], message: str) -> None:
    with pytest.raises(DamageError, match=message):
        SceneReader(CLASSES).add(OBJECTS, changed_message(change))


def test_other_bytes_and_too_large_messages_are_refused() -> None:
    with pytest.raises(DamageError, match=r"not a foxglove\.SceneUpdate"):
        SceneReader(CLASSES).add(OBJECTS, b"\xff" * 40)
    with pytest.raises(DamageError, match="at most 8388608 are read"):
        SceneReader(CLASSES).add(OBJECTS, b"\0" * (1 << 24))
