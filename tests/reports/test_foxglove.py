"""Foxglove draws forecasts.mcap and recordings: read by a generic reader, with the schemas and settings of its SDK."""

import json
import math
import re
import struct
from typing import get_args, get_type_hints

import foxglove.messages as official
import numpy as np
import pytest
from foxglove import layouts
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from typer.testing import CliRunner

from gridtrack.cli import app
from gridtrack.evaluation.referee.samples import SAMPLES, RobotPaths, read_samples
from gridtrack.recordings import RecordingInfo, write_native

from scenes import truth_scene
from scenes.drawn_samples import ROBOTS, STAMP_NS, write_samples

TOPIC_SETTINGS = {
    "foxglove.Grid": layouts.BaseRendererGridTopicSettings,
    "foxglove.LaserScan": layouts.BaseRendererLaserScanTopicSettings,
    "foxglove.SceneUpdate": layouts.BaseRendererSceneUpdateTopicSettings,
    "foxglove.PosesInFrame": layouts.BaseRendererPosesTopicSettings,
}


@pytest.fixture(scope="module")
def samples(tmp_path_factory):
    """Two samples: a walker in the first, none in the second."""
    path = tmp_path_factory.mktemp("trial") / SAMPLES
    write_samples(path)
    return path


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """A native recording with truth and labels."""
    path = tmp_path_factory.mktemp("recording") / "room.mcap"
    with path.open("wb") as file:
        info = RecordingInfo(site="room", classes=truth_scene.CLASSES)
        write_native(file, info, (truth_scene.scan(index) for index in range(5)))
    return path


def messages(path):
    """Schema, topic, log time and message, decoded by the descriptors in the file itself."""
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            yield schema, channel.topic, message.log_time, decoded


def message_at(path, topic, log_time=STAMP_NS):
    (found,) = [one for _, name, at, one in messages(path) if (name, at) == (topic, log_time)]
    return found


def cell(message, row, column):
    """The value of each field of a cell, read as the schema says."""
    start = row * message.row_stride + column * message.cell_stride
    return {field.name: message.data[start + field.offset] for field in message.fields}


def in_world(path, x, y):
    """A point of the frame `grid` in `world`, by the transform in the file."""
    window = message_at(path, "/window")
    assert (window.parent_frame_id, window.child_frame_id) == ("world", "grid")
    z, w = window.rotation.z, window.rotation.w
    cos, sin = w * w - z * z, 2 * w * z
    return window.translation.x + cos * x - sin * y, window.translation.y + sin * x + cos * y


def test_cells_have_their_values_their_shade_and_their_place_in_the_world(samples):
    grid = message_at(samples, "/input")
    assert cell(grid, 0, 0) == {"visible": 255, "occupied": 0, "shade": 64}
    assert cell(grid, 0, 1) == {"visible": 255, "occupied": 255, "shade": 255}
    assert cell(grid, 2, 2) == {"visible": 0, "occupied": 0, "shade": 0}
    assert (grid.cell_size.x, grid.cell_size.y, grid.column_count, len(grid.data)) == (0.5, 0.5, 3, 27)
    assert grid.frame_id == "grid"
    assert grid.timestamp.seconds * 10**9 + grid.timestamp.nanos == STAMP_NS
    # the hit, row 0 and column 1, is half a metre right of the corner; the window is a quarter turn to the left
    centre = grid.pose.position.x + 1.5 * grid.cell_size.x, grid.pose.position.y + 0.5 * grid.cell_size.y
    assert in_world(samples, *centre) == pytest.approx((10.0 - 2.25, -4.0 - 0.25))


def test_the_later_frame_its_known_state_and_the_forecast(samples):
    assert cell(message_at(samples, "/came/1s"), 1, 0)["shade"] == 255
    known = message_at(samples, "/scored/1s")
    shades = [cell(known, *at)["shade"] for at in ((0, 0), (1, 0), (0, 2), (1, 2), (2, 0))]
    assert shades == [64, 255, 32, 191, 0]
    assert [cell(known, *at)["state"] for at in ((1, 0), (1, 2))] == [1, 3]
    forecast = message_at(samples, "/forecast/1s")
    assert [cell(forecast, row, row)["probability"] for row in range(3)] == [0, 128, 51]
    assert cell(forecast, 1, 0) == {"probability": 255}


def test_a_track_is_a_box_with_an_arrow_as_long_as_it_moves_in_a_second(samples):
    (entity,) = message_at(samples, "/tracks").entities
    (cube,), (arrow,) = entity.cubes, entity.arrows
    assert (entity.id, entity.frame_id) == ("7", "grid")
    assert (cube.pose.position.x, cube.pose.position.y) == pytest.approx((-0.5, 2.5))
    assert (cube.size.x, cube.size.y) == pytest.approx((0.8, 0.4))
    assert cube.pose.position.z == cube.size.z / 2  # it stands on the grid
    assert 2 * math.atan2(cube.pose.orientation.z, cube.pose.orientation.w) == pytest.approx(0.5)
    assert arrow.shaft_length + arrow.head_length == pytest.approx(1.0)
    assert min(arrow.head_length, arrow.head_diameter) > 0  # not given, a viewer takes 0 and draws no head
    assert 2 * math.atan2(arrow.pose.orientation.z, arrow.pose.orientation.w) == pytest.approx(math.atan2(-0.8, 0.6))


def test_the_paths_of_robots_are_points_with_the_values_of_each(samples):
    cloud = message_at(samples, "/robots")
    names = [field.name for field in cloud.fields]
    assert names == ["x", "y", "vx", "vy", "until_s", "contact", "risk"]
    assert (cloud.frame_id, len(cloud.data)) == ("grid", 3 * cloud.point_stride)
    first = struct.unpack_from("<7f", cloud.data)
    assert dict(zip(names, first, strict=True)) == {
        "x": -0.5, "y": 2.25, "vx": 0.5, "vy": 0.0, "until_s": 0.5, "contact": 1.0, "risk": 0.25,
    }  # fmt: skip
    with_robots, without = read_samples(samples)
    assert without.robots is None
    for name in RobotPaths.__slots__:
        assert np.array_equal(getattr(with_robots.robots, name), getattr(ROBOTS, name), equal_nan=True)


def test_a_track_that_ended_is_not_drawn_on(samples):
    drawn = {}
    for _, topic, _, update in messages(samples):
        if topic == "/tracks":
            for deletion in update.deletions:
                assert deletion.type == 1  # all of this topic
                drawn.clear()
            drawn |= {entity.id: entity for entity in update.entities}
    assert drawn == {}


def schema_of(descriptors):
    """The fields of each message and the values of each enumeration."""
    found = {}
    for file in FileDescriptorSet.FromString(descriptors).file:
        enumerations = [(file.package, one) for one in file.enum_type]
        for message in file.message_type:
            name = f"{file.package}.{message.name}"
            found[name] = sorted((f.number, f.name, f.type, f.label, f.type_name) for f in message.field)
            enumerations += [(name, one) for one in message.enum_type]
        for parent, one in enumerations:
            found[f"{parent}.{one.name}"] = [(value.number, value.name) for value in one.value]
    return found


@pytest.mark.parametrize("file", ["samples", "recording"])
def test_every_schema_is_the_one_that_foxglove_publishes(file, request):
    schemas = {schema.name: schema for schema, *_ in messages(request.getfixturevalue(file))}
    assert len(schemas) >= 3
    for name, schema in schemas.items():
        published = getattr(official, name.removeprefix("foxglove.")).get_schema()
        assert (schema.name, schema.encoding) == (published.name, published.encoding)
        assert schema_of(schema.data) == schema_of(published.data)


@pytest.fixture(scope="module")
def layout():
    done = CliRunner().invoke(app, ["recording", "layout"], catch_exceptions=False)
    found = json.loads(done.stdout)
    return found


def test_the_layout_shows_the_content_of_the_files(samples, recording, layout):
    kinds = {topic: schema.name for path in (samples, recording) for schema, topic, *_ in messages(path)}
    shown = set()
    for panel in layout["configById"].values():
        for name, settings in panel["topics"].items():
            topic = re.sub(r"/[\d.]+s$", "/1s", name)
            assert set(settings) <= TOPIC_SETTINGS[kinds[topic]]()._to_dict().keys()
            assert settings.get("colorMode", "flat") in ("flat", "gradient", "colormap")
            if kinds[topic] == "foxglove.Grid":
                assert settings["colorField"] in cell(message_at(samples, topic), 0, 0)
            shown |= {name} if settings["visible"] else set()
    assert {"/input", "/forecast/1s", "/scored/1s", "/tracks", "/scan", "/outlines", "/objects"} <= shown


def test_each_panel_is_valid_for_foxglove_and_has_its_place(layout):
    known = layouts.ThreeDeeConfig()._to_dict().keys() | {"foxglovePanelTitle"}
    modes = get_args(get_args(get_type_hints(layouts.ThreeDeeConfig)["follow_mode"])[0])
    for name, panel in layout["configById"].items():
        assert name.startswith("3D!")
        assert set(panel) <= known
        assert set(panel["cameraState"]) <= layouts.ThreeDeeCameraState()._to_dict().keys()
        assert set(panel["scene"]) <= layouts.BaseRendererSceneSettings()._to_dict().keys()
        assert panel["followMode"] in modes
        assert panel["followTf"] == "world"

    def leaves(node):
        return [node] if isinstance(node, str) else leaves(node["first"]) + leaves(node["second"])

    assert sorted(leaves(layout["layout"])) == sorted(layout["configById"])
