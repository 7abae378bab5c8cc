"""The figure of the trackers' expectation of a place: its numbers, damaged files, and its pictures in a browser."""

import base64
import re
import shutil
import zlib

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from gridtrack.evaluation.runs.prior import PRIOR_COLUMNS, PRIOR_FILE
from gridtrack.reports.page import render_page, render_report
from gridtrack.reports.priors import NEVER_SEEN, PRIOR_LEVELS, priors_of
from gridtrack.reports.run import read_runs
from gridtrack.reports.table import headline_tables

from scenes.report_page import data_of, opened

SIZE = 32
FRAMES = 8


def columns(expected_at, size=SIZE):
    """A place that is occupied in half of the frames at [3, 5] and never visible at [4, 6]."""
    row, column = np.indices((size, size), np.int16)
    visible, occupied = np.full((size, size), FRAMES, np.int32), np.zeros((size, size), np.int32)
    occupied[3, 5], visible[4, 6] = FRAMES // 2, 0
    probability = np.full((size, size), 1e-3, np.float32)
    probability[expected_at] = 1.0
    return {"row": row, "column": column, "visible": visible, "occupied": occupied, "probability": probability}


def write_prior(folder, cells):
    schema = pa.schema([(name, kind) for name, (kind, _) in PRIOR_COLUMNS.items()])
    table = pa.table([cells[name].ravel() for name in PRIOR_COLUMNS], schema=schema)
    parquet.write_table(table, folder / PRIOR_FILE)


@pytest.fixture
def run(run_folder, tmp_path):
    """A run in which `good` and `fair` have a prior."""
    run = shutil.copytree(run_folder, tmp_path / "run")
    write_prior(run / "good@crossing", columns((3, 5)))
    write_prior(run / "fair@crossing", columns((20, 9)))
    return run


def plane(packed):
    return np.frombuffer(zlib.decompress(base64.b64decode(packed)), np.uint8).reshape(SIZE, SIZE)


def test_the_recorded_share_and_each_prior_are_on_one_logarithmic_scale(run, run_folder):
    assert data_of(render_page(read_runs([run_folder])))["priors"] == []
    (place,) = data_of(render_page(read_runs([run])))["priors"]
    assert (place["recording"], place["size"]) == ("crossing", SIZE)
    assert {row["label"] for row in place["rows"]} == {"good", "fair"}
    recorded = plane(place["recorded"])
    # log10(0.5) is 0.301 of the three decades below 1
    assert recorded[3, 5] == pytest.approx(PRIOR_LEVELS * (1 - 0.30103 / 3), abs=0.5)
    assert (recorded[4, 6], recorded[0, 0]) == (NEVER_SEEN, 0)
    (good,) = [row for row in place["rows"] if row["label"] == "good"]
    assert np.argwhere(plane(good["cells"]) == PRIOR_LEVELS).tolist() == [[3, 5]]


def test_a_place_of_several_recordings_has_one_prior_of_each_row(twenty, tmp_path):
    run = shutil.copytree(twenty, tmp_path / "run")
    for trial in ("good@seed-00", "good@seed-01", "unlucky@seed-01"):
        write_prior(run / trial, columns((3, 5), size=100))
    runs = read_runs([run])
    places, notices = priors_of(runs, headline_tables(runs), dict.fromkeys(("good", "unlucky"), ""))
    assert not notices
    shown = [(place["recording"], [row["label"] for row in place["rows"]]) for place in places]
    assert shown == [("seed-00", ["good"]), ("seed-01", ["unlucky"])]


@pytest.mark.parametrize(
    "damage",
    [
        lambda cells: {**cells, "probability": np.full((SIZE, SIZE), 1.5, np.float32)},
        lambda cells: {**cells, "probability": np.full((SIZE, SIZE), np.nan, np.float32)},
        lambda cells: {**cells, "occupied": cells["visible"] + np.int32(1)},
        lambda cells: {name: values[1:] for name, values in cells.items()},
        lambda cells: {**cells, "row": cells["row"][::-1]},
    ],
    ids=["above 1", "NaN", "more than visible", "a row short", "another order"],
)
def test_a_damaged_prior_has_a_notice_and_the_others_are_shown(run, damage):
    write_prior(run / "good@crossing", damage(columns((3, 5))))
    page = render_page(read_runs([run]))
    assert "prior.parquet: not the prior of a grid of 32 x 32 cells" in page
    assert [row["label"] for row in data_of(page)["priors"][0]["rows"]] == ["fair"]
    (run / "good@crossing" / PRIOR_FILE).write_bytes(b"PAR1 no")
    assert "cannot be read as a prior" in render_page(read_runs([run]))


@pytest.fixture
def page(browser, run):
    with opened(browser, render_report([run])) as page:
        yield page


def test_a_browser_draws_the_maps_with_row_0_at_the_bottom(page):
    page.locator("#priors .line image").nth(2).wait_for()
    names = page.locator("#priors g.line text").all_text_contents()
    assert names == ["recorded: share of frames", "good", "fair"]
    bar = page.locator("#priors .colour-bar")
    assert bar.locator("text").all_text_contents() == ["P(occupied)", "0.001", "0.01", "0.1", "1", "never visible"]
    assert not re.search(r"white|black|grey", page.locator("#priors .note").inner_text()), "true in one scheme alone"
    # the darkest pixel of each picture of a tracker, from the top left
    darkest = page.evaluate(
        """async () => Promise.all([...document.querySelectorAll("#priors .line image")].slice(1).map(async (one) => {
          const picture = new Image();
          picture.src = one.getAttribute("href");
          await picture.decode();
          const canvas = new OffscreenCanvas(picture.width, picture.height), context = canvas.getContext("2d");
          context.drawImage(picture, 0, 0);
          const values = context.getImageData(0, 0, picture.width, picture.height).data;
          const cells = Array.from({ length: picture.width * picture.height }, (_, i) => 4 * i);
          const dark = cells.map((red) => values[red] + values[red + 1]);
          const at = dark.indexOf(Math.min(...dark));
          return [Math.floor(at / picture.width), at % picture.width];
        }))"""
    )
    assert darkest == [[SIZE - 1 - 3, 5], [SIZE - 1 - 20, 9]]
    page.locator('#priors button[aria-label*="CSV"]').wait_for()
    page.get_by_role("button", name="good").first.click()
    assert page.locator("#priors .line image").count() == 2
