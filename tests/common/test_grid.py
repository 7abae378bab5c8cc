"""The cells of a grid follow the conventions, and its text form round-trips."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from gridtrack.common.errors import ConfigurationError, RecordingError
from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridSpec, Shift, nearest_step, rolled, shift_between

metres = st.floats(-1e6, 1e6)
grids = st.builds(GridSpec, st.integers(1, 60), st.integers(1, 300).map(lambda n: n / 100), st.tuples(metres, metres))


def test_a_grid_without_origin_is_centred() -> None:
    assert GridSpec(100, 0.2).origin == (-10.0, -10.0)
    assert GridSpec(100, 0.2).extent == (-10.0, 10.0, -10.0, 10.0)


def test_rows_run_along_y_and_columns_along_x() -> None:
    grid = GridSpec(4, 0.5, (10.0, 20.0))
    cells, inside = grid.cells_of(np.array([[10.0, 20.0], [11.9, 20.6], [10.4, 21.9], [9.99, 20.5], [12.0, 20.5]]))
    assert inside.tolist() == [True, True, True, False, False]
    assert cells[:3].tolist() == [[0, 0], [1, 3], [3, 0]]


def test_a_point_on_a_grid_line_is_in_the_upper_cell_up_to_rounding() -> None:
    grid = GridSpec(10, 0.2, (0.0, 0.0))
    cells, _ = grid.cells_of(np.array([[0.6, 1.2], [0.6 - 1e-14, 1.2 + 1e-14]]))
    assert 0.6 / 0.2 < 3.0, "the quotient is below the line"
    assert cells.tolist() == [[6, 3], [6, 3]]


def test_centres_are_in_row_major_order() -> None:
    marked = np.zeros((4, 4), bool)
    marked[0, 3] = marked[2, 1] = marked[2, 2] = True
    centres = GridSpec(4, 0.5, (10.0, 20.0)).cell_centres(marked)
    assert centres.dtype == np.float32
    np.testing.assert_allclose(centres, [[11.75, 20.25], [10.75, 21.25], [11.25, 21.25]])


@given(st.builds(GridSpec, st.integers(1, 60), st.floats(0.01, 3.0)), st.data())
def test_the_centre_of_a_cell_lies_in_that_cell(grid: GridSpec, data: st.DataObject) -> None:
    row, column = (data.draw(st.integers(0, grid.size - 1)) for _ in range(2))
    marked = np.zeros(grid.shape, bool)
    marked[row, column] = True
    cells, inside = grid.cells_of(grid.cell_centres(marked))
    assert inside.all()
    assert cells.tolist() == [[row, column]]


@given(grids)
@example(GridSpec(100, 1 / 3, (1e-7, -123456.789)))
def test_text_form_round_trips(grid: GridSpec) -> None:
    assert GridSpec.parse(str(grid)) == grid


def test_text_forms() -> None:
    assert GridSpec.parse("100x0.2") == GridSpec(100, 0.2)
    assert GridSpec.parse("100x0.1@-2,-4.5") == GridSpec(100, 0.1, (-2.0, -4.5))


@pytest.mark.parametrize(
    "text", ["", "100", "100x", "x0.2", "100x0.2@1", "100x0.2@1,2,3", "100x-", "1e2x0.2", "100x0.2 m"]
)
def test_an_invalid_grid_text_is_refused_with_an_example(text: str) -> None:
    with pytest.raises(ConfigurationError, match=r"100x0\.2"):
        GridSpec.parse(text)


@pytest.mark.parametrize("text", ["0x0.2", "5000x0.2", "100x0", "100x-0.2", "100x1000", "100x0.2@1e999,0"])
def test_sizes_out_of_bounds_are_refused(text: str) -> None:
    with pytest.raises(ConfigurationError, match="grid"):
        GridSpec.parse(text)


def test_values_stay_at_their_place_in_the_world_when_the_window_moves() -> None:
    values = np.arange(25).reshape(5, 5)
    moved = rolled(values, Shift(rows=1, columns=-2), fill=-1)
    assert moved.tolist() == [
        [-1, -1, 5, 6, 7],
        [-1, -1, 10, 11, 12],
        [-1, -1, 15, 16, 17],
        [-1, -1, 20, 21, 22],
        [-1, -1, -1, -1, -1],
    ]


def test_rolled_cells_may_be_on_any_axes_and_take_an_array() -> None:
    values = np.arange(18).reshape(3, 3, 2)
    moved = rolled(values, Shift(1, 0), np.array([-1, -2]), axes=(0, 1))
    assert (moved[:2] == values[1:]).all()
    assert moved[2].tolist() == [[-1, -2]] * 3


@given(st.integers(-40, 40), st.integers(-40, 40), st.integers(1, 30), st.integers(1, 30), st.integers(1, 30))
def test_a_window_of_a_map_has_the_cells_of_the_map_inside_it(
    up: int, right: int, rows: int, columns: int, size: int
) -> None:
    area = np.arange(1, rows * columns + 1).reshape(rows, columns)
    found = rolled(area, Shift(up, right), 0, size=size)
    assert found.shape == (size, size)
    for r in range(size):
        for c in range(size):
            inside = 0 <= r + up < rows and 0 <= c + right < columns
            assert found[r, c] == (area[r + up, c + right] if inside else 0)


def test_a_shift_is_whole_cells_of_a_window_that_does_not_rotate() -> None:
    assert shift_between(SE2(1.0, 2.0), SE2(1.4, 1.8), 0.2) == Shift(rows=-1, columns=2)
    assert not shift_between(SE2(0.1, 0.7, 0.3), SE2(0.1, 0.7, 0.3), 0.2)
    with pytest.raises(RecordingError, match="whole cells"):
        shift_between(SE2(), SE2(0.1, 0.0), 0.2)
    with pytest.raises(RecordingError, match="never turns"):
        shift_between(SE2(), SE2(0.0, 0.0, 0.1), 0.2)


@pytest.mark.parametrize(
    ("rate_hz", "horizon_s", "step"),
    [(10.0, 0.5, 5), (7.5, 0.5, 4), (7.5, 1.0, 8), (5.0, 0.5, 2), (7.0, 0.5, 4), (20.0, 2.5, 50), (3.0, 0.1, 0)],
)
def test_the_nearest_step_of_a_horizon_needs_the_first_digits_of_a_period_only(rate_hz, horizon_s, step):
    assert nearest_step(horizon_s, 1 / rate_hz) == step
    assert nearest_step(horizon_s, round(1 / rate_hz, 6)) == step
