"""A run's folder is read as it was written; a folder without a readable run is an error of one line."""

import shutil

import pytest

from gridtrack.evaluation.regression.measuring import measure_run
from gridtrack.evaluation.runs.result_files import RunError
from gridtrack.reports.run import ReportError, read_runs

from scenes.edited_run import edit, trial_of


@pytest.fixture
def copied(run_folder, tmp_path):
    return shutil.copytree(run_folder, tmp_path / "copied")


def curve_of_fair(summary):
    """F1 of `fair` on cells in motion at every step."""
    return trial_of(summary, "fair")["strata"]["in-motion"]["f1"]["f1"]["value"]


def refusal(run):
    with pytest.raises(RunError) as refused:
        read_runs([run])
    message = str(refused.value)
    assert "\n" not in message
    assert str(run) in message
    return message


def test_an_unfinished_run_and_a_missing_folder_have_different_errors(copied, tmp_path):
    (copied / "summary.json").unlink()
    assert "did not finish" in refusal(copied)
    assert "there is no such" in refusal(tmp_path / "nowhere")


def test_curves_that_do_not_reach_every_horizon_are_refused(copied):
    edit(copied, lambda summary: curve_of_fair(summary).pop())
    assert "fair on crossing, in-motion" in refusal(copied)


@pytest.mark.parametrize("last", [float("inf"), float("nan"), 1e12])
def test_horizons_beyond_the_limit_are_refused(copied, last):
    def lengthen(summary):
        summary["recordings"]["crossing"]["horizons_s"][-1] = last

    edit(copied, lengthen)
    assert "recordings.crossing.horizons_s" in refusal(copied)


def test_nan_is_undefined(copied):
    def undefine(summary):
        curve_of_fair(summary)[3] = float("nan")

    (run,) = read_runs([edit(copied, undefine)])
    assert run.summary.trackers["fair"].recordings["crossing"].at("in-motion", "f1", "f1", 3).value is None


def test_runs_of_the_same_name_are_named_by_their_paths(run_folder, tmp_path):
    other = shutil.copytree(run_folder, tmp_path / run_folder.name)
    assert [run.name for run in read_runs([run_folder, other])] == [str(run_folder), str(other)]


@pytest.mark.parametrize("label", ["../../etc", "a/b", ".."])
def test_a_label_cannot_lead_out_of_the_run(run_folder, label):
    (run,) = read_runs([run_folder])
    with pytest.raises(ReportError, match="not the name of a folder"):
        run.trial_folder(label + "/x", "crossing")


@pytest.mark.parametrize("name", ["report", "good@crossing/forecasts.mcap", "summary.json"])
def test_a_folder_with_a_link_is_refused(copied, tmp_path, name):
    """A report would be written to, or read from, wherever it leads."""
    mine = tmp_path / "mine"
    mine.mkdir()
    if (copied / name).exists():
        (copied / name).replace(mine / "moved")
    (copied / name).symlink_to(mine)
    assert f"{name}: a link" in refusal(copied)
    with pytest.raises(RunError, match="a link"):
        measure_run(copied)
