"""The wire carries streams, frames and forecasts unchanged, and refuses other bytes before memory is allocated."""

from __future__ import annotations

import json
import os
import struct
import tracemalloc
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec
from gridtrack.trackers import messages
from gridtrack.trackers.contract import Forecast, StreamSpec, TrackedObject
from gridtrack.trackers.wire import DTYPES, Message, WireError, encode, fill_from, receive, write_to

from scenes.programs_here import received

GRID = GridSpec(6, 0.5, (-1.0, 2.0))


def sent(message: Message, max_body: int = 1 << 20) -> Message:
    """The message that the receiver decodes."""
    return received(b"".join(encode(message)), max_body)


arrays = st.dictionaries(
    st.text(max_size=8),
    st.sampled_from(sorted(DTYPES)).flatmap(
        lambda name: hnp.arrays(DTYPES[name], hnp.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=4))
    ),
    max_size=5,
)


@given(arrays, st.integers(0, 2**53))
def test_arrays_of_every_type_and_shape_are_carried_bit_by_bit(content: dict[str, Any], number: int) -> None:
    back = sent(Message("update", number, {"site": "Straße"}, content))
    assert (back.kind, back.number, back.fields) == ("update", number, {"site": "Straße"})
    assert list(back.arrays) == list(content)
    for name, array in content.items():
        assert back.arrays[name].dtype == array.dtype
        assert back.arrays[name].shape == array.shape
        assert back.arrays[name].tobytes() == array.tobytes()
        assert back.arrays[name].flags.aligned


def test_the_bytes_agree_with_the_documentation() -> None:
    """The example in docs/wire.md."""
    page = (Path(__file__).parents[2] / "docs" / "wire.md").read_text()
    header = b'{"type":"reset","id":2,"arrays":[{"name":"a","dtype":"int32","shape":[2]}],"seed":7}'
    body = struct.pack("<2i", 1, -1)
    expected = b"GTW\x01" + struct.pack("<IQ", len(header), len(body)) + header + body
    assert b"".join(encode(Message("reset", 2, {"seed": 7}, {"a": np.array([1, -1], np.int32)}))) == expected
    assert expected[:4].hex(" ") + "  " + expected[4:8].hex(" ") + "  " + expected[8:16].hex(" ") in page
    assert header.decode() in page
    assert body[:4].hex(" ") + "  " + body[4:].hex(" ") in page


def test_arrays_in_any_layout_and_byte_order_keep_their_values() -> None:
    array = np.arange(12, dtype=">f4").reshape(3, 4).T[::2]
    assert np.array_equal(sent(Message("x", 1, {}, {"a": array})).arrays["a"], array)


def test_a_byte_other_than_0_and_1_is_read_as_true() -> None:
    message = received(raw([{"name": "a", "dtype": "bool", "shape": [3]}], b"\x00\x02\xff"))
    assert message.arrays["a"].view(np.uint8).tolist() == [0, 1, 1]


def raw(declared: Any, body: bytes = b"", **other: Any) -> bytes:
    header = json.dumps({"type": "x", "id": 1, "arrays": declared} | other).encode()
    return b"GTW\x01" + struct.pack("<IQ", len(header), len(body)) + header + body


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"HTTP/1.1 200 OK\n", "starts with b'HTTP/1.1'"),
        (b"GTW\x02" + bytes(12), "wire version 2"),
        (raw([], b"123"), "fill 0 bytes of a body of 3"),
        (raw([{"name": "a", "dtype": "uint8", "shape": [4]}], b"123"), "ends at byte 4 of a body of 3"),
        (raw([{"name": "a", "dtype": "uint8", "shape": [-1]}], b"1"), "is not a shape"),
        (raw([{"name": "a", "dtype": "uint8", "shape": [True]}], b"1"), "is not a shape"),
        (raw([{"name": "a", "dtype": "uint8", "shape": [1.0]}], b"1"), "is not a shape"),
        (raw([{"name": "a", "dtype": "uint8", "shape": [1] * 9}], b"1"), "is not a shape"),
        (raw([{"name": "a", "dtype": "float64", "shape": [2**30] * 8}], b"1"), "ends at byte"),
        (raw([{"name": "a", "dtype": "object", "shape": [1]}], b"1"), "of dtype 'object'"),
        (raw([{"name": "a", "dtype": ["uint8"], "shape": [1]}], b"1"), "of dtype"),
        (raw([{"name": "a", "shape": [1]}], b"1"), "declared by name, dtype and shape"),
        (raw([{"name": "a", "dtype": "uint8", "shape": [0]}] * 2), "declared twice"),
        (raw([{"name": str(i), "dtype": "uint8", "shape": [0]} for i in range(65)]), "65 arrays"),
        (raw({}), "needs 'type'"),
        (raw([], id=True), "needs 'type'"),
        (raw([], type=3), "needs 'type'"),
    ],
)
def test_bytes_that_are_not_a_message_are_refused_with_the_reason(data: bytes, message: str) -> None:
    with pytest.raises(WireError, match=message):
        received(data)


def test_an_excessive_size_is_refused_before_memory_is_allocated() -> None:
    tracemalloc.start()
    with pytest.raises(WireError, match="at most 1048576 and 1000 are accepted"):
        received(b"GTW\x01" + struct.pack("<IQ", 2, 1 << 40) + b"{}", max_body=1000)
    assert tracemalloc.get_traced_memory()[1] < 100_000
    tracemalloc.stop()


def test_an_object_array_is_not_encoded() -> None:
    with pytest.raises(WireError, match="array 'a' is object"):
        encode(Message("x", 1, {}, {"a": np.array([{}])}))


def test_a_field_that_is_not_json_is_not_encoded() -> None:
    for value in (float("nan"), {1, 2}):
        with pytest.raises(WireError, match="a field is not JSON"):
            encode(Message("x", 1, {"a": value}))


def test_pipes_carry_messages_larger_than_their_capacity() -> None:
    read_fd, write_fd = os.pipe()
    pid = os.fork()
    array = np.arange(1 << 20, dtype=np.float32)
    if pid == 0:
        write_to(write_fd, encode(Message("x", 1, {}, {"a": array})))
        os._exit(0)
    os.close(write_fd)
    assert np.array_equal(receive(fill_from(read_fd), 1 << 23).arrays["a"], array)
    with pytest.raises(EOFError):
        receive(fill_from(read_fd), 0)
    os.close(read_fd)
    os.waitpid(pid, 0)


def test_a_stream_with_weights_that_are_no_path_is_refused() -> None:
    fields = messages.stream_fields(StreamSpec(GRID, 0.1, "a site")) | {"weights": ["here.toml"]}
    with pytest.raises(WireError, match="'weights' of type str"):
        messages.stream_from(Message("start", 0, {"stream": fields}, {}))


@pytest.mark.parametrize("weights", [None, Path("/data/static-map/here.toml")])
def test_a_stream_is_carried_unchanged(weights: Path | None) -> None:
    stream = StreamSpec(GRID, 0.1, "a site", ("car", "person"), weights)
    assert messages.stream_from(sent(Message("start", 1, {"stream": messages.stream_fields(stream)}))) == stream
    asked = replace(stream, velocity_scored=True)
    assert messages.stream_from(sent(Message("start", 1, {"stream": messages.stream_fields(asked)}))) == asked


def a_frame(seed: int) -> GridFrame:
    rng = np.random.default_rng(seed)
    visible = rng.random(GRID.shape) < 0.7
    return GridFrame(
        2**62 + seed,
        visible,
        visible & (rng.random(GRID.shape) < 0.3),
        SE2(0.1, -0.2, 0.3),
        rng.random((2, 2), np.float32),
        rng.random((7, 2), np.float32),
        rng.integers(0, 2, 7, np.uint8),
    )


@given(st.integers(0, 100))
def test_a_frame_is_carried_unchanged(seed: int) -> None:
    frame = a_frame(seed)
    back = messages.frame_from(sent(Message("update", 1, {}, messages.frame_arrays(frame))))
    assert (back.stamp_ns, back.world_T_grid) == (frame.stamp_ns, frame.world_T_grid)
    for name in ("visible", "occupied", "origins", "points", "point_origin"):
        assert np.array_equal(getattr(back, name), getattr(frame, name))
        assert getattr(back, name).dtype == getattr(frame, name).dtype
    assert sum(a.nbytes for a in messages.frame_arrays(frame).values()) <= messages.update_limit(GRID)


def an_object(track: int, label: str) -> TrackedObject:
    rng = np.random.default_rng(track)
    return TrackedObject(track, *(rng.random(shape).astype(np.float32) for shape in ((5,), (2,), (4, 4))), label=label)


def full_forecast(steps: int = 2) -> Forecast:
    rng = np.random.default_rng(1)
    semantics = rng.random((steps + 1, 3, *GRID.shape), np.float32)
    return Forecast(
        rng.random((steps + 1, *GRID.shape), np.float32),
        semantics / semantics.sum(axis=1, keepdims=True),
        rng.normal(size=(2, *GRID.shape)).astype(np.float32),
        (an_object(7, "person"), an_object(2**40, ""), an_object(9, "car")),
    )


def futures_of(count: int, steps: int = 2) -> NDArray[np.bool_]:
    drawn: NDArray[np.bool_] = np.random.default_rng(2).random((count, steps + 1, *GRID.shape)) < 0.3
    drawn[0, 0] = True
    return drawn


def over_the_wire(forecast: Forecast, steps: int = 2, classes: int = 3) -> Forecast:
    fields, content = messages.forecast_fields(forecast)
    message = sent(Message("forecast", 1, fields, content), messages.forecast_limit(GRID, steps, classes))
    return messages.forecast_from(message, GRID, steps, classes)


def test_a_forecast_with_all_optional_parts_is_carried_unchanged() -> None:
    forecast = full_forecast()
    back = over_the_wire(forecast)
    for name in ("occupancy", "semantics", "velocity"):
        assert np.array_equal(getattr(back, name), getattr(forecast, name))
    assert [(o.track, o.label) for o in back.objects] == [(7, "person"), (2**40, ""), (9, "car")]
    for one, other in zip(back.objects, forecast.objects, strict=True):
        assert np.array_equal(one.box, other.box)
        assert np.array_equal(one.velocity, other.velocity)
        assert np.array_equal(one.covariance, other.covariance)


def test_half_precision_is_accepted_and_read_as_single() -> None:
    occupancy = np.full((3, *GRID.shape), 0.25, np.float16)
    back = over_the_wire(Forecast(occupancy))
    assert back.occupancy.dtype == np.float32
    assert (back.occupancy == 0.25).all()
    assert (back.semantics, back.velocity, back.objects) == (None, None, ())


@pytest.mark.parametrize("dtype", [np.bool_, np.float16])
def test_velocities_at_every_step_and_sampled_futures_are_carried_unchanged(dtype: type[Any]) -> None:
    occupancy = np.zeros((3, *GRID.shape), np.float32)
    velocity = np.random.default_rng(3).normal(size=(3, 2, *GRID.shape)).astype(np.float32)
    velocity[:, :, 0] = np.nan
    back = over_the_wire(Forecast(occupancy, velocity=velocity, futures=futures_of(64).astype(dtype)))
    assert np.array_equal(back.velocity, velocity, equal_nan=True)
    assert back.futures.dtype == dtype
    assert np.array_equal(back.futures, futures_of(64))


def changed(**change: Any) -> Message:
    """The message of a full forecast with some arrays or fields replaced, or left out where None."""
    fields, content = messages.forecast_fields(full_forecast())
    fields = {k: v for k, v in (fields | change).items() if k == "labels"}
    content = {k: v for k, v in (content | change).items() if k != "labels" and v is not None}
    return Message("forecast", 1, fields, content)


nothing = np.zeros((2, *GRID.shape), np.float32)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"occupancy": None}, "has no 'occupancy'"),
        ({"semantics": np.zeros((3, 2, *GRID.shape), np.float32)}, "semantics has shape"),
        ({"semantics": np.full((3, 3, *GRID.shape), 0.3, np.float32)}, "the largest error is 0.1"),
        ({"velocity": nothing[:1]}, "velocity has shape"),
        ({"velocity": np.zeros((2, 2, *GRID.shape), np.float32)}, "velocity has shape .* for step 0 alone"),
        ({"velocity": np.zeros(2, np.float32)}, "velocity has shape"),
        ({"velocity": nothing - np.inf}, "velocity has 72 infinite values; NaN says: no velocity"),
        ({"velocity": nothing.astype(np.int64)}, "velocity is int64"),
        ({"futures": futures_of(4, steps=1)}, "array 'futures' is bool"),
        ({"futures": nothing > 0}, "array 'futures' is bool"),
        ({"futures": futures_of(4).astype(np.float32)}, "futures is float32; expected bool or float16"),
        ({"futures": futures_of(4).astype(np.uint8)}, "futures is uint8"),
        ({"futures": futures_of(1)}, "1 futures in one forecast; expected 2 to 64"),
        ({"futures": futures_of(65)}, "65 futures in one forecast; expected 2 to 64"),
        ({"futures": futures_of(4) * np.float16(1.5)}, "futures goes from 0 to 1.5; expected probabilities"),
        ({"futures": futures_of(4) * np.float16(np.nan)}, "futures has 432 values that are not finite"),
        ({"object_box": np.zeros((2, 5), np.float32)}, "array 'object_box'"),
        ({"object_box": np.full((3, 5), np.inf, np.float32)}, "object_box has 15 values"),
        ({"object_label": np.array([0, 1, 2], np.int32)}, "there are 2 labels"),
        ({"labels": [1, 2]}, "not all names: expected 1 to 160 bytes"),
        ({"labels": "person"}, "needs a field 'labels'"),
        ({"object_velocity": None}, "needs an array 'object_velocity'"),
        ({"object_track": np.zeros(5000, np.int64)}, "5000 objects"),
    ],
)
def test_every_part_of_a_forecast_is_checked(change: dict[str, Any], message: str) -> None:
    with pytest.raises(WireError, match=message):
        messages.forecast_from(changed(**change), GRID, 2, 3)


def test_semantics_without_named_classes_are_refused() -> None:
    with pytest.raises(WireError, match="names no classes"):
        messages.forecast_from(changed(), GRID, 2, 0)


def test_objects_of_differing_shapes_are_not_encoded() -> None:
    odd = TrackedObject(1, np.zeros(4, np.float32), np.zeros(2, np.float32), np.zeros((4, 4), np.float32))
    with pytest.raises(WireError, match="differ in shape"):
        messages.forecast_fields(Forecast(nothing, objects=(an_object(3, ""), odd)))
