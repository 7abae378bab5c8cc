"""The page in a browser: its scripts draw the ranking and the curves; without a browser, what they are given."""

import pytest

from gridtrack.evaluation.runs.summarise import summarise
from gridtrack.evaluation.runs.summary import read_summary
from gridtrack.reports.page import render_report

from scenes import synthetic_run as synthetic
from scenes.report_page import data_of

RECORDINGS = [f"seed-{i:02}" for i in range(20)]


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    """The report of twenty recordings, on which good and fair differ from persistence, and twin does not."""
    run = tmp_path_factory.mktemp("runs") / "twenty"
    skills = {"persistence": 0.6, "good": 0.8, "fair": 0.7, "twin": 0.6, "late": 0.9}
    trials = [
        synthetic.write_trial(
            run, label, name, skill, seed=i, frames=6, scored=3 if label == "late" and not i else None
        )
        for i, name in enumerate(RECORDINGS)
        for label, skill in skills.items()
    ]
    described = {name: synthetic.description() for name in RECORDINGS}
    summarise(described, trials, [], False).write(run)
    synthetic.write_run_record(run, described)
    return render_report([run])


def test_the_data_has_the_summarys_scores_and_intervals(report):
    summary = read_summary(report.parent.parent)
    expected = summary.trackers["good"].pooled.estimate("in-motion", "f1", "f1")
    (pooled,) = [one for one in data_of(report.read_text("utf-8"))["recordings"] if one["name"] == "all recordings"]
    (row,) = [one for one in pooled["rows"] if one["label"] == "good"]
    shown = row["strata"]["in-motion"]["f1"]["f1"]
    assert shown["value"] == pytest.approx(expected.value, rel=1e-4)
    assert shown["low"] == pytest.approx(expected.low, rel=1e-4)
    assert pooled["horizons_s"] == list(summary.pooled_horizons_s)


def test_the_groups_have_rows_that_do_not_differ_significantly(report):
    groups = data_of(report.read_text("utf-8"))["recordings"][0]["groups"]["f1.f1/in-motion/8"]
    assert groups == {"pairs": 6, "units": 20, "groups": [["persistence", "twin"]]}


@pytest.mark.parametrize(
    "line",
    [
        "<dt>Compared on</dt><dd>20 recordings: 120 forecasts scored, of 800 frames, the longest forecast 2.5 s ahead",
        "<dt>Weights</dt><dd>none: persistence, good, fair, twin, late</dd>",
        "<dt>Keeps up with the sensor</dt><dd>not measured: gridtrack compare --latency measures it</dd>",
        "<dt>Not ranked</dt><dd>late: crashed on 1 of 20 recordings</dd>",
    ],
)
def test_the_answer_is_a_line_each(report, line):
    assert line in report.read_text("utf-8")


def test_a_browser_draws_ranking_tiers_and_curves_without_an_error(browser, report):
    page = browser.new_page()
    page.set_default_timeout(120_000)
    faults = []
    page.on("console", lambda message: message.type == "error" and faults.append(message.text))
    page.on("pageerror", lambda error: faults.append(str(error)))
    page.goto(report.as_uri())
    page.locator("#every-score table").wait_for()
    assert faults == []
    assert page.locator("#ranking .whisker").count() == 4
    assert page.locator("#ranking circle.tier").count() == 2
    assert page.locator("#curves .band").count() == 4
    assert page.locator('[aria-pressed="true"]').count() == 5
    page.close()
