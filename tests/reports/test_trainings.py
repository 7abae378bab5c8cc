"""The table of trackers with several trainings on the page; a run without any has none."""

import json
import shutil

import pytest

from gridtrack.reports.differences import trainings_across, trainings_table
from gridtrack.reports.page import render_report
from gridtrack.reports.run import read_runs
from gridtrack.reports.table import headline_tables

from scenes.edited_run import put, trial_of
from scenes.report_page import opened


def score(**values):
    return {"stratum": "in-motion", "horizon_s": 1.0, "step": 8, "values": [0.5, 0.6], **values}


def test_trainings_have_mean_spread_and_judged_difference(make_run, tmp_path):
    run = make_run(tmp_path / "run")
    assert trainings_table(read_runs([run])[0], "crossing") is None
    summary = json.loads((run / "summary.json").read_text())
    common = {"recordings": "crossing", "reference": "persistence", "units": 20}
    judged = {"difference": {"value": 0.25, "low": 0.125, "high": 0.375}, "p_holm": 0.01}
    summary["trainings"] = [
        {**common, "tracker": "persistence", "labels": ["persistence"], "scores": [score(values=[0.3], mean=0.3)]},
        {
            **common,
            "tracker": "net",
            "labels": ["good", "<b>good</b> 2"],
            "scores": [score(mean=0.55, spread=0.0707, verdict="better", **judged)],
        },
        {
            **common,
            "tracker": "other",
            "labels": ["other"],
            "interval": "one training: the spread between trainings is not known",
            "scores": [score(values=[0.4], mean=0.4, difference={"value": 0.1}, verdict="not tested")],
        },
    ]
    (run / "summary.json").write_text(json.dumps(summary))
    table = trainings_table(read_runs([run])[0], "crossing")
    assert table.columns == (("in-motion", 1.0),)
    floor, net, other = table.rows
    assert (net.name, net.keys, net.count) == ("good", ("good", "<b>good</b> 2"), 2)
    (cell,) = net.cells
    assert (cell.mean, cell.spread) == ("0.550", "± 0.071")
    assert (cell.below, cell.p, cell.verdict) == ("+0.250 [+0.125, +0.375]", "p = 0.010", "better")
    assert (floor.cells[0].mean, floor.cells[0].spread, floor.cells[0].below) == ("0.300", "", "")
    assert (other.cells[0].below, other.cells[0].verdict) == ("+0.100", "")
    page = render_report([run]).read_text("utf-8")
    assert "Several trainings" in page
    assert "one training: the spread between trainings is not known" in page
    assert "± 0.071" in page


@pytest.fixture
def training(run_folder, tmp_path):
    """`training(name, sha256, f1)`: a copy of a run in which `good` has these weights, and `f1` everywhere."""

    def training(name, sha256, f1):
        run = shutil.copytree(run_folder, tmp_path / name)
        record = json.loads((run / "run.json").read_text())
        record["weights"] = {"good@crossing": {"name": "good/crossing.toml", "sha256": sha256}}
        (run / "run.json").write_text(json.dumps(record))
        summary = json.loads((run / "summary.json").read_text()) | {"headline": "f1.f1"}
        for stratum in trial_of(summary, "good")["strata"]:
            put(trial_of(summary, "good"), stratum, "f1.f1", f1)
        (run / "summary.json").write_text(json.dumps(summary))
        return run

    return training


def test_runs_with_other_weights_of_one_tracker_show_its_spread(training):
    paths = [training(name, sha, f1) for name, sha, f1 in (("a", "1" * 64, 0.4), ("b", "2" * 64, 0.5))]
    again = training("c", "2" * 64, 0.5)  # the weights of b: no third training
    runs = read_runs([*paths, again])
    table = trainings_across(runs, headline_tables(runs)[0])
    (good,) = table.rows
    assert (good.name, good.count, table.reference) == ("good", 2, "")
    assert table.columns[:3] == (("in-motion", 0.5), ("in-motion", 1.0), ("in-motion", 2.5))
    assert {(cell.mean, cell.spread, cell.below) for cell in good.cells} == {("0.450", "± 0.071", "0.400 to 0.500")}
    page = render_report([*paths, again]).read_text("utf-8")
    assert "Several trainings" in page
    assert "below, the lowest and the highest." in page


def test_runs_with_the_same_weights_are_no_trainings(training):
    runs = read_runs([training(name, "1" * 64, 0.5) for name in ("a", "b")])
    assert trainings_across(runs, headline_tables(runs)[0]) is None


def test_a_row_of_trainings_is_hidden_when_all_of_its_rows_are(browser, training):
    paths = [training(name, sha, f1) for name, sha, f1 in (("a", "1" * 64, 0.4), ("b", "2" * 64, 0.5))]
    runs = read_runs(paths)
    (good,) = trainings_across(runs, headline_tables(runs)[0]).rows
    assert good.keys == ("b: good", "a: good")
    with opened(browser, render_report(paths)) as page:
        row = page.get_by_role("region", name="Several trainings").locator("tbody tr")
        assert row.locator("th .swatch line").count() == 1
        first, second = (page.locator("#trackers").get_by_role("button", name=key, exact=True) for key in good.keys)
        first.click()
        assert row.is_visible()
        second.click()
        assert not row.is_visible()
        first.click()
        assert row.is_visible()


def test_trainings_with_labels_of_their_own_have_the_name_of_their_tracker(training):
    first, second = (training(name, sha, f1) for name, sha, f1 in (("a", "1" * 64, 0.4), ("b", "2" * 64, 0.5)))
    for name in ("summary.json", "run.json"):
        (second / name).write_text(
            (second / name).read_text().replace('"good', '"seed-2').replace('"seed-2-tracker', '"good-tracker')
        )
    (second / "good@crossing").rename(second / "seed-2@crossing")
    outcome = second / "seed-2@crossing" / "outcome.json"
    outcome.write_text(outcome.read_text().replace('"good"', '"seed-2"'))
    runs = read_runs([first, second])
    (row,) = trainings_across(runs, headline_tables(runs)[0]).rows
    assert (row.name, row.keys) == ("good-tracker", ("b: seed-2", "a: good"))
