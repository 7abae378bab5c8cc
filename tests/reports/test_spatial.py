"""The section on scale: curves of the fractions skill score, soft IoU and beam errors, as in summary.json."""

import json
import re
import shutil

import pytest

from gridtrack.evaluation.results.columns import SCALES
from gridtrack.evaluation.statistics.summary import summarise
from gridtrack.reports.page import render_page
from gridtrack.reports.recording_section import styles_of
from gridtrack.reports.run import UNDEFINED, read_runs
from gridtrack.reports.spatial import HEADINGS, spatial_section
from gridtrack.reports.table import headline_tables

from scenes import synthetic_run as synthetic

TITLE = "At which scale does a forecast know something?"


def section_of(run):
    runs = read_runs([run])
    table = headline_tables(runs)[0]
    return spatial_section(table, runs[0].summary.recordings[table.recording].grid, styles_of(runs))


def test_every_curve_has_the_scores_of_the_summary(run_folder, summary_of):
    section, summary = section_of(run_folder), summary_of(run_folder)
    horizons = summary["recordings"]["crossing"]["horizons_s"]
    assert len(section.panels) == 6
    assert {series.name for series in section.series} == set(summary["trackers"])
    for panel in section.panels:
        stratum, seconds = re.fullmatch(r"(\S+) cells, (\S+) s ahead", panel.title).groups()
        for series, values in panel.series:
            strata = summary["trackers"][series.name]["recordings"]["crossing"]["strata"]
            step = horizons.index(float(seconds))
            assert list(values) == [strata[stratum][f"fss_{scale}"][step] for scale in SCALES]


def test_a_block_forecast_beside_where_it_came_is_right_at_a_larger_scale(run_folder):
    panel = section_of(run_folder).panels[0]
    persistence = next(values for series, values in panel.series if series.name == "persistence")
    assert list(persistence) == sorted(persistence)
    assert persistence[-1] > persistence[0] + 0.1


def test_the_page_shows_the_section_and_a_dash_for_beams_that_a_recording_does_not_have(run_folder):
    page = render_page(read_runs([run_folder]))
    assert TITLE in page
    section = section_of(run_folder)
    assert section.main.stratum == "in-motion"
    assert section.main.horizon == "1 s"
    (good,) = [cells for row, cells in section.main.rows if row.label == "good"]
    texts = dict(zip(HEADINGS, (cell.text for cell in good), strict=True))
    assert texts["beam_error"] == texts["beam_bias"] == UNDEFINED
    assert f"<td>{texts['fss_5']}</td>" in page


def test_a_run_of_before_has_neither_the_section_nor_the_column(run_folder, tmp_path):
    run = shutil.copytree(run_folder, tmp_path / "run")
    summary = json.loads((run / "summary.json").read_text())
    for row in summary["trackers"].values():
        for scores in row["recordings"]["crossing"]["strata"].values():
            for name in [key for key in scores if key.startswith(tuple(HEADINGS))]:
                del scores[name]
    (run / "summary.json").write_text(json.dumps(summary))
    assert section_of(run) is None
    page = render_page(read_runs([run]))
    assert TITLE not in page
    assert "FSS, 5 cells" not in page


@pytest.fixture(scope="module")
def twenty(tmp_path_factory):
    run, names = tmp_path_factory.mktemp("runs") / "twenty", [f"seed-{i:02}" for i in range(20)]
    trials = [
        synthetic.write_trial(run, label, name, skill, seed=i, frames=3)
        for i, name in enumerate(names)
        for label, skill in {"persistence": 0.5, "good": 0.8}.items()
    ]
    described = {name: synthetic.description() for name in names}
    summarise(described, trials, [], False).write(run)
    synthetic.write_run_record(run, described)
    return run


def test_twenty_recordings_have_bands_and_intervals(twenty):
    section = section_of(twenty)
    assert section.has_bands
    assert all(line.band for panel in section.panels for line in panel.lines)
    assert all(cell.interval for _, cells in section.main.rows for cell in cells)
    (column,) = [column for column in headline_tables(read_runs([twenty]))[0].columns if column.score == "fss_5"]
    row = headline_tables(read_runs([twenty]))[0].rows[0]
    low, high = column.interval_of(row.trial)
    assert low < column.of(row.trial) < high
