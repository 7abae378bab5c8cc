"""Bands of the figures beside the curves over the horizon: precision over recall, and hidden cells by time."""

from __future__ import annotations

import copy
import csv
import shutil

import numpy as np
import pytest

from gridtrack.evaluation.runs.summarise import summarise
from gridtrack.evaluation.scores.cells import PROBABILITY_EDGES
from gridtrack.reports.page import render_report
from gridtrack.reports.run import read_runs
from gridtrack.reports.score_figures import score_figures
from gridtrack.reports.table import headline_tables

from scenes import synthetic_run as synthetic
from scenes.edited_run import edited, put, trial_of
from scenes.report_page import data_of, downloaded, opened

RECORDINGS = [f"seed-{i:02}" for i in range(20)]
SKILLS = {"persistence": 0.6, "good": 0.8}
STEPS, STEP = 5, "2"
"""Steps of a forecast, and the step 1 s ahead."""
TOP_BIN = 5
"""Bins from the last one to that of the cells that are called occupied at a threshold of 0.5."""


def written(run, recordings, steps=STEPS, skills=SKILLS, **trial):
    """A run on `recordings`, by name their descriptions."""
    trials = [
        synthetic.write_trial(run, label, name, skill, seed=seed, steps=steps, **trial)
        for seed, name in enumerate(recordings)
        for label, skill in skills.items()
    ]
    summarise(recordings, trials, [], False).write(run)
    synthetic.write_run_record(run, recordings)
    return run


@pytest.fixture(scope="module")
def run(twenty):
    return twenty


@pytest.fixture(scope="module")
def report(twenty_report):
    return twenty_report


@pytest.fixture
def page(browser, report):
    with opened(browser, report) as page:
        yield page


def curves_of(run):
    runs = read_runs([run])
    curves, notices = score_figures(runs, headline_tables(runs))
    assert notices == ()
    return curves


@pytest.fixture(scope="module")
def curves(run):
    return curves_of(run)


def ends_at_half(curve):
    """Precision with the ends of its interval at the point of the cells that are called occupied at 0.5."""
    at = curve["p"].index(pytest.approx(PROBABILITY_EDGES[-1 - TOP_BIN], rel=1e-3))
    return [curve["precision"][end][at] for end in ("value", "low", "high")]


def expected_at_half(scope, stratum, step=int(STEP)):
    point = scope.at(stratum, "f1", "precision", step)
    return [point.value, point.low, point.high]


def test_precision_at_the_threshold_in_use_has_the_interval_of_the_summary(run, curves):
    (read,) = read_runs([run])
    for label in SKILLS:
        for stratum in ("in-motion", "visible"):
            expected = expected_at_half(read.summary.trackers[label].pooled, stratum)
            assert ends_at_half(curves["all recordings", label]["pr_auc"][stratum][STEP]) == pytest.approx(
                expected, rel=1e-3
            )


@pytest.fixture(scope="module")
def long_run(tmp_path_factory):
    """One recording that is long enough for twenty blocks."""
    described = {"long": synthetic.description(steps=4)}
    return written(tmp_path_factory.mktemp("runs") / "long", described, 4, frames=500, every_s=5)


def test_blocks_of_one_long_recording_agree_with_the_summary(long_run):
    trial = read_runs([long_run])[0].summary.trackers["good"].recordings["long"]
    assert trial.interval == ""
    curve = curves_of(long_run)["long", "good"]["pr_auc"]["in-motion"]["4"]
    assert ends_at_half(curve) == pytest.approx(expected_at_half(trial, "in-motion", 4), rel=1e-3)


def test_without_blocks_the_curves_have_no_bands_and_a_notice_says_why(long_run, tmp_path):
    """They depend on the scores of every tracker."""
    run = shutil.copytree(long_run, tmp_path / "run")
    (run / "persistence@long" / "sums.parquet").write_bytes(b"not")
    runs = read_runs([run])
    curves, notices = score_figures(runs, headline_tables(runs))
    assert ("long", "persistence") not in curves
    assert "low" not in curves["long", "good"]["pr_auc"]["in-motion"]["4"]["precision"]
    assert {notice.partition(": ")[0] for notice in notices} == {"persistence", "no intervals of precision over recall"}


def test_precision_has_no_interval_if_scores_have_none(curves):
    curve = curves[RECORDINGS[0], "good"]["pr_auc"]["in-motion"][STEP]
    assert "low" not in curve["precision"]


def test_recordings_of_unlike_periods_have_pooled_curves_if_their_scores_are_pooled(tmp_path):
    periods_s = np.where(np.arange(20) < 10, 0.125, 0.25)
    described = {
        name: synthetic.description(period_s=period_s, steps=8)
        for name, period_s in zip(RECORDINGS, periods_s, strict=True)
    }
    run = written(tmp_path / "run", described, 8, {"good": 0.8}, frames=2)
    (read,) = read_runs([run])
    horizons_s = read.summary.pooled_horizons_s
    assert horizons_s == (0.0, 0.5, 1.0)
    curve = curves_of(run)["all recordings", "good"]["pr_auc"]["in-motion"]["2"]
    expected = expected_at_half(read.summary.trackers["good"].pooled, "in-motion", 2)
    assert ends_at_half(curve) == pytest.approx(expected, rel=1e-3)


def numbers_of(page, figure):
    return list(csv.DictReader(downloaded(page, f"#{figure}").splitlines()))


def test_hidden_cells_by_time_have_bands_and_their_ends_in_the_file(page, run):
    section = page.locator("#hidden-time")
    assert section.locator("polygon.band").count() == 4
    assert "a band is a 95 % interval" in section.locator(".note").inner_text()
    first = numbers_of(page, "hidden-time")[0]
    point = read_runs([run])[0].summary.trackers["good"].pooled.at("occluded to 0.5 s", "f1", "f1", int(STEP))
    assert float(first["good low"]) == pytest.approx(point.low, rel=1e-4)
    assert float(first["good high"]) == pytest.approx(point.high, rel=1e-4)
    section.locator(".chart").focus()
    page.keyboard.press("ArrowRight")
    low, high = (f"{float(first[name]):.3f}" for name in ("good low", "good high"))
    assert f"[{low}, {high}]" in section.locator(".readout").inner_text()


def test_precision_over_recall_has_bands_and_their_ends_in_the_file(page, report):
    section = page.locator("#precision-recall")
    assert section.locator("polygon.band").count() == 4
    assert "a band is a 95 % interval" in section.locator(".note").inner_text()
    rows = [row for row in numbers_of(page, "precision-recall") if row["tracker"] == "good"]
    (pooled,) = [
        row["figures"]["pr_auc"]
        for recording in data_of(report.read_text())["recordings"]
        for row in recording["rows"]
        if (recording["name"], row["label"]) == ("all recordings", "good")
    ]
    curve = pooled["in-motion"][STEP]
    drawn = [tuple(float(row[f"precision{end}"]) for end in ("", " low", " high")) for row in rows]
    ends = list(zip(*(curve["precision"][end] for end in ("value", "low", "high")), strict=True))
    assert set(drawn) == set(ends)
    recall = [float(row["recall"]) for row in rows]
    assert (recall[0], drawn[0]) == (0.0, ends[0])
    assert list(zip(recall[1:], drawn[1:], strict=True)) == list(dict.fromkeys(zip(curve["recall"], ends, strict=True)))


def test_a_file_without_intervals_has_no_columns_of_their_ends(page):
    page.locator("#precision-recall").get_by_label("Recording").select_option(RECORDINGS[0])
    assert "precision low" not in numbers_of(page, "precision-recall")[0]
    assert page.locator("#precision-recall polygon.band").count() == 0


@pytest.fixture
def crowded(run_folder, tmp_path):
    """Eight trackers, each a little better than the one before, with intervals."""

    def into_eight(summary):
        good = summary["trackers"]["good"]
        summary["trackers"] = {f"tracker {n}": copy.deepcopy(good) for n in range(8)}
        summary["differences"] = summary["pairs"] = []
        for n in range(8):
            shutil.copytree(run_folder / "good@crossing", tmp_path / "run" / f"tracker {n}@crossing")
            area = 0.2 + 0.1 * n
            put(trial_of(summary, f"tracker {n}"), "in-motion", "pr_auc.area", area, area - 0.1, area + 0.1)

    return render_report([edited(run_folder, tmp_path / "run", into_eight)])


def test_only_the_band_of_the_line_next_to_the_pointer_is_drawn_if_there_are_many(browser, crowded):
    with opened(browser, crowded) as page:
        figure = page.locator("#curves")
        bands = figure.locator(".band")
        assert bands.count() == 8
        assert figure.locator(".band:visible").count() == 0
        assert "of the line next to the pointer" in figure.locator(".note").inner_text()
        drawing = figure.locator("svg.figure-drawing")
        line = figure.locator("g.line", has=page.locator("title", has_text="tracker 5"))
        x, y = line.locator("polyline").evaluate("(line) => line.getAttribute('points').split(' ').at(-1).split(',')")
        drawing.hover(position={"x": float(x) - 3, "y": float(y)})
        assert [b.get_attribute("visibility") for b in line.locator(".band").all()] == ["visible"]
        assert figure.locator('.band[visibility="visible"]').count() == 1
        page.mouse.move(0, 0)
        assert figure.locator('.band[visibility="visible"]').count() == 0
        page.get_by_role("button", name="tracker 0").click()
        page.get_by_role("button", name="tracker 1").click()
        assert figure.locator('.band[visibility="hidden"]').count() == 0, "six can be distinguished"


def test_a_browser_draws_ranking_groups_and_curves_without_an_error(page):
    assert page.locator("#ranking .whisker").count() == 4
    assert page.locator("#ranking circle.tier").count() == 2
    assert page.locator("#curves .band").count() == 4
    assert page.locator('[aria-pressed="true"]').count() == 5
