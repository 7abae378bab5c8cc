"""Forecasts on disk: hand-drawn planes in other windows, the forecast that is read at a frame, and refused files."""

from __future__ import annotations

import json
import zipfile

import numpy as np
import pytest
import zarr

from gridtrack.common.errors import RecordingError
from gridtrack.common.forecast_file import open_forecasts, write_forecasts
from gridtrack.common.forecast_reader import ForecastReader
from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridSpec

GRID = GridSpec(5, 1.0, (0.0, 0.0))
SECOND, HERE = 10**9, SE2()


def arrays(plane=None, **more):
    """One forecast of one plane (H, W) with its corner at the origin."""
    plane = np.zeros((5, 5)) if plane is None else np.array(plane, float)
    return {
        "occupancy": plane[None, None].astype(np.float32),
        "stamp_ns": np.array([SECOND]),
        "lead_s": np.array([0.0]),
        "cell_m": np.array(1.0),
        "origin_xy": np.zeros(2),
    } | more


@pytest.fixture
def opened(tmp_path):
    """`opened(arrays)`: the forecasts of a file of them."""

    def opened(own):
        write_forecasts(tmp_path / "mine.npz", own)
        return open_forecasts(tmp_path / "mine.npz")

    return opened


def read(file, grid=GRID, window=HERE):
    """The plane that is read at the stamp of the first forecast."""
    return ForecastReader(file, grid, 1.0).at(SECOND, window, 0).occupancy[0]


def drawn(text):
    """A plane as pictures show it, the top row first: digits are tenths, a dot is no value."""
    rows = [[np.nan if sign == "." else int(sign) / 10 for sign in line] for line in text.split()]
    return np.array(rows[::-1], np.float32)


def test_cells_of_another_window_are_cut_and_those_outside_have_no_value(opened):
    file = opened(arrays([[0.1, 0.2], [0.3, 0.4]], origin_xy=np.array([-1.0, 3.0])))
    assert np.array_equal(read(file), drawn("4.... 2.... ..... ..... ....."), equal_nan=True)
    assert np.array_equal(read(file, window=SE2(-2.0, 1.0)), drawn("..... .34.. .12.. ..... ....."), equal_nan=True)


def test_small_cells_give_their_largest_value_and_large_ones_theirs_to_each_cell_in_them(opened):
    small = opened(arrays([[0.1, 0.2, 0.0, 0.0], [0.3, np.nan, 0.0, 0.5]], cell_m=np.array(0.5)))
    assert np.array_equal(read(small), drawn("..... ..... ..... ..... 35..."), equal_nan=True)
    large = opened(arrays([[0.1, 0.2]], cell_m=np.array(2.5), origin_xy=np.array([0.0, 2.5])))
    # the centre of the middle cells lies on the border of two large cells: they belong to the upper one
    assert np.array_equal(read(large), drawn("11222 11222 11222 ..... ....."), equal_nan=True)


def test_a_plane_in_the_frame_of_a_turned_sensor_is_turned_back_with_its_velocities(opened):
    more = {"frame": np.array("sensor"), "pose": np.array([[3.0, 1.0, np.pi / 2]])}
    velocity = np.zeros((1, 1, 2, 1, 3))
    velocity[:, :, 0] = 2.0
    file = opened(arrays([[0.1, 0.2, 0.3]], velocity=velocity, **more))
    # x of the sensor is y of the world; its cell [0, 0] lies to the left of the corner (3, 1)
    assert np.array_equal(read(file), drawn("..... ..3.. ..2.. ..1.. ....."), equal_nan=True)
    found = ForecastReader(file, GRID, 1.0).at(SECOND, SE2(), 0).velocity[0]
    assert found[:, 2, 2] == pytest.approx([0.0, 2.0], abs=1e-6)
    assert np.isnan(found[:, 0, 0]).all()


def test_the_newest_available_forecast_is_read_at_the_nearest_times(opened):
    planes = np.arange(6, dtype=np.float32).reshape(2, 3, 1, 1) / 10 * np.ones((2, 3, 5, 5), np.float32)
    own = arrays() | {
        "occupancy": planes,
        "stamp_ns": np.array([10 * SECOND, 10 * SECOND + 4 * 10**8]),
        "available_ns": np.array([10 * SECOND, 10 * SECOND + 8 * 10**8]),
        "lead_s": np.array([0.0, 0.5, 1.0]),
    }
    reader = ForecastReader(opened(own), GRID, 0.1)

    def at(since_s, steps=8):
        found = reader.at(10 * SECOND + round(since_s * 1e9), SE2(), steps).occupancy[:, 0, 0]
        return [None if np.isnan(value) else round(float(value) * 10) for value in found]

    assert at(-0.1) == [None] * 9, "before the first one"
    assert at(0.0) == [0, 0, 0, 1, 1, 1, 1, 1, 2]
    assert at(0.7, 2) == [1, 2, 2], "the second is not available"
    assert at(0.8, 2) == [4, 4, 4], "0.4 s later: its second time ahead"
    assert at(1.5, 2) == [None] * 3, "older than a second"


def test_compressed_arrays_and_a_folder_are_read_as_the_file(tmp_path, opened):
    own = arrays(np.arange(25).reshape(5, 5) / 25)
    np.savez_compressed(tmp_path / "packed.npz", **own)
    (tmp_path / "folder").mkdir()
    for name, array in own.items():
        np.save(tmp_path / "folder" / f"{name}.npy", array)
    expected = opened(own).occupancy(0, 0)
    for path in (tmp_path / "packed.npz", tmp_path / "folder"):
        assert (open_forecasts(path).occupancy(0, 0) == expected).all()
    as_bytes = own | {"occupancy": np.full((1, 1, 5, 5), 51, np.uint8)}
    assert opened(as_bytes).occupancy(0, 0)[0, 0] == np.float32(0.2)


def write_zarr(path, arrays, version=3, **more):
    """The arrays as a Zarr store; texts are attributes. `more`: of the occupancy."""
    group = zarr.open_group(path, mode="w", zarr_format=version)
    for name, array in arrays.items():
        if array.dtype.kind == "U":
            group.attrs[name] = str(array)
        else:
            group.create_array(name, data=array, **(more if name == "occupancy" else {}))
    return path


@pytest.mark.parametrize("version", [2, 3])
def test_a_zarr_store_is_read_as_the_file(tmp_path, opened, version):
    own = arrays(np.arange(25).reshape(5, 5) / 25, axes=np.array("xy"), note=np.array("objects"))
    stored = open_forecasts(write_zarr(tmp_path / "mine.zarr", own, version, chunks=(1, 1, 2, 5)))
    assert (stored.occupancy(0, 0) == opened(own).occupancy(0, 0)).all()
    assert stored.note == "objects"
    chunk = next(path for path in (tmp_path / "mine.zarr" / "occupancy").rglob("*0") if path.is_file())
    chunk.write_bytes(b"damaged")
    with pytest.raises(RecordingError, match="occupancy is damaged"):
        stored.occupancy(0, 0)


def test_a_codec_of_a_zarr_store_cannot_run_code(tmp_path):
    path = write_zarr(tmp_path / "mine.zarr", arrays(), 2)
    description = path / "occupancy" / ".zarray"
    content = json.loads(description.read_text())
    description.write_text(json.dumps(content | {"filters": [{"id": "pickle"}]}))
    with pytest.raises(RecordingError, match="the codec 'pickle'; known: blosc"):
        open_forecasts(path)
    (tmp_path / "mine.zarr" / "link").symlink_to(tmp_path)
    with pytest.raises(RecordingError, match="a link"):
        open_forecasts(path)


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        ({"occupancy": np.zeros((1, 5, 5))}, r"occupancy is \(1, 5, 5\) float64; expected \(N, T, H, W\) float16"),
        ({"stamp_ns": np.array([1.0])}, r"stamp_ns is \(1,\) float64; expected \(1,\) int64"),
        ({"lead_s": np.array([-0.1])}, "lead_s must increase from 0"),
        ({"cell_m": np.array(0.0)}, "cell_m is 0; expected 0.001 to 100 m"),
        ({"origin_xy": np.array([0.0, np.nan])}, "origin_xy has values that are not finite"),
        ({"frame": np.array("sensor")}, 'frame "sensor" needs pose'),
        ({"axes": np.array("rc")}, "axes must be yx or xy"),
        ({"velocity": np.zeros((1, 1, 5, 5))}, r"velocity is .*; expected \(1, 1, 2, 5, 5\) float"),
        ({"futures": np.zeros((1, 4, 5, 5), np.float32)}, r"futures is .*; expected \(1, F, 1, 5, 5\)"),
        ({"probability": np.zeros(1)}, "unknown arrays probability; the arrays are occupancy, stamp_ns"),
        ({"occupancy": np.asfortranarray(np.zeros((2, 2, 5, 5), np.float32))}, "Fortran order: use C order"),
    ],
)
def test_arrays_that_do_not_fit_are_refused_in_a_line(opened, changes, line):
    with pytest.raises(RecordingError, match=line):
        opened(arrays() | changes)


def test_nothing_is_unpickled_and_a_header_cannot_ask_for_memory(tmp_path, opened):
    path = tmp_path / "hostile.npz"
    np.savez(path, **arrays() | {"note": np.array({}, object)})
    with pytest.raises(RecordingError, match="note has Python objects"):
        open_forecasts(path)
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (100000000000,), }"
    claimed = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header
    for compression in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        opened(arrays())
        (tmp_path / "mine.npz").rename(path)
        with zipfile.ZipFile(path, "a", compression) as packed:
            packed.writestr("pose.npy", claimed)
        with pytest.raises(RecordingError, match="pose has 800000000000 bytes"):
            open_forecasts(path)
    path.write_bytes(path.read_bytes()[:300])
    with pytest.raises(RecordingError, match="no arrays of forecasts"):
        open_forecasts(path)
    with pytest.raises(RecordingError, match="No such file"):
        open_forecasts(tmp_path / "absent.npz")
