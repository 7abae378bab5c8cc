"""The cells of a grid follow the conventions, and its text form round-trips."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from gridtrack.common.errors import ConfigurationError
from gridtrack.common.grid import GridSpec

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
