"""The table of trackers with several trainings on the page; a run without any has none."""

import pytest

from gridtrack.reports.differences import trainings_across, trainings_table
from gridtrack.reports.page import render_report
from gridtrack.reports.run import read_runs
from gridtrack.reports.table import headline_tables

from scenes.edited_run import edit, edited, put, trial_of
from scenes.report_page import opened


def score(**values):
    return {"stratum": "in-motion", "horizon_s": 1.0, "step": 8, "values": [0.5, 0.6], **values}


def trainings_of(tracker, labels, one_score, interval=""):
    common = {"recordings": "crossing", "reference": "persistence", "units": 20, "interval": interval}
    return {**common, "tracker": tracker, "labels": labels, "scores": [one_score]}


def test_trainings_have_mean_spread_and_judged_difference(run_folder, tmp_path):
    assert trainings_table(read_runs([run_folder])[0], "crossing") is None
    judged = {"difference": {"value": 0.25, "low": 0.125, "high": 0.375}, "p_holm": 0.01, "verdict": "better"}
    untested = {"difference": {"value": 0.1}, "verdict": "not tested"}
    unknown = "one training: the spread between trainings is not known"
    trainings = [
        trainings_of("persistence", ["persistence"], score(values=[0.3], mean=0.3)),
        trainings_of("net", ["good", "<b>good</b> 2"], score(mean=0.55, spread=0.0707, **judged)),
        trainings_of("other", ["other"], score(values=[0.4], mean=0.4, **untested), unknown),
    ]
    run = edited(run_folder, tmp_path / "run", lambda summary: summary.update(trainings=trainings))
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
    assert unknown in page
    assert "± 0.071" in page


@pytest.fixture
def training(run_folder, tmp_path):
    """`training(name, sha256, f1)`: a copy of a run in which `good` has these weights, and `f1` everywhere."""

    def training(name, sha256, f1):

        def with_f1(summary):
            summary["headline"] = "f1.f1"
            for stratum in trial_of(summary, "good")["strata"]:
                put(trial_of(summary, "good"), stratum, "f1.f1", f1)

        weights = {"good@crossing": {"name": "good/crossing.toml", "sha256": sha256}}
        run = edited(run_folder, tmp_path / name, with_f1)
        return edit(run, lambda record: record.update(weights=weights), "run.json")

    return training


@pytest.fixture
def two(training):
    """Two runs with other weights of `good`."""
    return [training("a", "1" * 64, 0.4), training("b", "2" * 64, 0.5)]


def test_runs_with_other_weights_of_one_tracker_show_its_spread(two, training):
    again = training("c", "2" * 64, 0.5)  # the weights of b: no third training
    same = read_runs([two[1], again])
    assert trainings_across(same, headline_tables(same)[0]) is None
    runs = read_runs([*two, again])
    table = trainings_across(runs, headline_tables(runs)[0])
    (good,) = table.rows
    assert (good.name, good.count, table.reference) == ("good", 2, "")
    assert table.columns[:3] == (("in-motion", 0.5), ("in-motion", 1.0), ("in-motion", 2.5))
    assert {(cell.mean, cell.spread, cell.below) for cell in good.cells} == {("0.450", "± 0.071", "0.400 to 0.500")}
    page = render_report([*two, again]).read_text("utf-8")
    assert "Several trainings" in page
    assert "below, the lowest and the highest." in page


def test_a_row_of_trainings_is_hidden_when_all_of_its_rows_are(browser, two):
    runs = read_runs(two)
    (good,) = trainings_across(runs, headline_tables(runs)[0]).rows
    assert good.keys == ("b: good", "a: good")
    with opened(browser, render_report(two)) as page:
        row = page.get_by_role("region", name="Several trainings").locator("tbody tr")
        assert row.locator("th .swatch line").count() == 1
        first, second = (page.locator("#trackers").get_by_role("button", name=key, exact=True) for key in good.keys)
        first.click()
        assert row.is_visible()
        second.click()
        assert not row.is_visible()
        first.click()
        assert row.is_visible()


def test_trainings_with_labels_of_their_own_have_the_name_of_their_tracker(two):
    _, second = two
    for name in ("summary.json", "run.json", "good@crossing/outcome.json"):
        text = (second / name).read_text().replace('"good', '"seed-2')
        (second / name).write_text(text.replace('"seed-2-tracker', '"good-tracker'))
    (second / "good@crossing").rename(second / "seed-2@crossing")
    runs = read_runs(two)
    (row,) = trainings_across(runs, headline_tables(runs)[0]).rows
    assert (row.name, row.keys) == ("good-tracker", ("b: seed-2", "a: good"))
