"""A report of many recordings: the page stays within its size and names the omissions; a user names recordings."""

import csv
import io

import pytest
from typer.testing import CliRunner

from gridtrack.cli import app
from gridtrack.common.errors import ConfigurationError
from gridtrack.reports import page as page_module
from gridtrack.reports.formats import render_as
from gridtrack.reports.page import render_page
from gridtrack.reports.run import chosen_runs, read_runs
from gridtrack.reports.table import headline_tables

from scenes import synthetic_run as synthetic
from scenes.report_page import data_of

SKILLS = {"hall-1": 0.7, "hall-2": 0.95, "street-1": 0.65, "street-2": 0.85}
"""Of `good` on each recording; `persistence` has 0.6 on all."""


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "places"
    described = {name: synthetic.description() for name in SKILLS}
    trials = [
        synthetic.write_trial(folder, label, name, skill, seed=i, frames=4)
        for i, (name, good) in enumerate(SKILLS.items())
        for label, skill in (("good", good), ("persistence", 0.6))
    ]
    return synthetic.write_results(folder, described, trials)


@pytest.fixture
def room_for_three(run, monkeypatch):
    """Room on a page for the pooled results and two recordings."""
    tables = headline_tables(read_runs([run]))
    sizes = [sum(len(curve) for row in table.rows for _, curve in row.trial.curves()) for table in tables]
    monkeypatch.setattr(page_module, "MOST_VALUES", sizes[0] + sum(sorted(sizes[1:])[-2:]))


def recordings_on(page):
    return [recording["name"] for recording in data_of(page)["recordings"]]


def test_a_page_without_room_for_all_has_the_recordings_with_the_largest_differences(run, room_for_three):
    page = render_page(read_runs([run]))
    assert recordings_on(page) == ["all recordings", "hall-2", "street-2"], "in the order of the run"
    assert "2 of 4 recordings are not on this page" in page
    assert data_of(page)["left_out"] == 2
    assert "recording street-1" not in page
    assert "4 recordings: 16 forecasts scored" in page, "the answer is that of the whole run"


def test_a_user_names_the_recordings_of_a_page_and_of_other_formats(run, room_for_three):
    page = render_page(chosen_runs(read_runs([run]), "street-*"))
    assert recordings_on(page) == ["street-1", "street-2"]
    assert "1 tracker and 1 floor on 2 recordings" in page
    assert "hall" not in page.partition("<h2>Setup</h2>")[0], "neither the result nor a notice is of another"
    assert "not on this page" not in page
    rows = csv.DictReader(io.StringIO(render_as("csv", [run], recordings="hall-1, street-2").decode()))
    assert [row["recording"] for row in rows] == ["hall-1"] * 2 + ["street-2"] * 2
    markdown = render_as("markdown", [run], recordings="hall-2").decode()
    assert "all recordings" not in markdown, "scores of all recordings are no scores of those"
    assert markdown.startswith("## gridtrack: 1 tracker and 1 floor on hall-2\n")


def test_an_unknown_recording_is_refused_in_one_line(run):
    with pytest.raises(ConfigurationError, match=r"--recordings 'hal-1': no such recording: did you mean 'hall-1'\?"):
        chosen_runs(read_runs([run]), "street-1, hal-1")
    done = CliRunner().invoke(app, ["report", str(run), "--recordings", "street-1", "--format", "csv"])
    assert done.exit_code == 0
    assert done.stdout.count("street-1") == 2
