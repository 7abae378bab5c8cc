"""Bands of the figures beside the curves over the horizon: precision over recall, and hidden cells by time."""

import copy
import csv
import shutil

import pytest

from gridtrack.evaluation.scores.cells import PROBABILITY_EDGES
from gridtrack.reports.run import read_runs
from gridtrack.reports.score_figures import score_figures
from gridtrack.reports.table import headline_tables

from scenes import synthetic_run as synthetic
from scenes.edited_run import put, trial_of
from scenes.report_page import data_of, downloaded, opened
from scenes.synthetic_run import RECORDINGS

SKILLS = {"persistence": 0.6, "good": 0.8}
STEP = "2"
"""The step 1 s ahead."""
TOP_BIN = 5
"""Bins from the last one to that of the cells that are called occupied at a threshold of 0.5."""


def written(run, recordings, steps, skills=SKILLS, **trial):
    """A run on `recordings`, by name their descriptions."""
    trials = [
        synthetic.write_trial(run, label, name, skill, seed=seed, steps=steps, **trial)
        for seed, name in enumerate(recordings)
        for label, skill in skills.items()
    ]
    return synthetic.write_results(run, recordings, trials)


@pytest.fixture
def page(browser, twenty_report):
    with opened(browser, twenty_report) as page:
        yield page


def curves_of(run):
    runs = read_runs([run])
    curves, notices = score_figures(runs, headline_tables(runs))
    assert notices == ()
    return curves


def assert_agrees_at_half(curve, scope, stratum, step=int(STEP)):
    """Precision of the cells that are called occupied at 0.5 has the value and the interval of the summary."""
    at = curve["p"].index(pytest.approx(PROBABILITY_EDGES[-1 - TOP_BIN], rel=1e-3))
    point = scope.at(stratum, "f1", "precision", step)
    ends = [curve["precision"][end][at] for end in ("value", "low", "high")]
    assert ends == pytest.approx([point.value, point.low, point.high], rel=1e-3)


def test_precision_at_the_threshold_in_use_has_the_interval_of_the_summary(twenty):
    summary, curves = read_runs([twenty])[0].summary, curves_of(twenty)
    for label in SKILLS:
        for stratum in ("in-motion", "visible"):
            curve = curves["all recordings", label]["pr_auc"][stratum][STEP]
            assert_agrees_at_half(curve, summary.trackers[label].pooled, stratum)


@pytest.fixture(scope="module")
def long_run(tmp_path_factory):
    """One recording that is long enough for twenty blocks."""
    described = {"long": synthetic.description(steps=4)}
    return written(tmp_path_factory.mktemp("runs") / "long", described, 4, frames=500, every_s=5)


def test_blocks_of_one_long_recording_agree_with_the_summary(long_run):
    trial = read_runs([long_run])[0].summary.trackers["good"].recordings["long"]
    assert trial.interval == ""
    assert_agrees_at_half(curves_of(long_run)["long", "good"]["pr_auc"]["in-motion"]["4"], trial, "in-motion", 4)


def test_without_blocks_the_curves_have_no_bands_and_a_notice_says_why(long_run, tmp_path):
    """They depend on the scores of every tracker."""
    run = shutil.copytree(long_run, tmp_path / "run")
    (run / "persistence@long" / "sums.parquet").write_bytes(b"not")
    runs = read_runs([run])
    curves, notices = score_figures(runs, headline_tables(runs))
    assert ("long", "persistence") not in curves
    assert "low" not in curves["long", "good"]["pr_auc"]["in-motion"]["4"]["precision"]
    assert {notice.partition(": ")[0] for notice in notices} == {"persistence", "no intervals of precision over recall"}


def test_recordings_of_unlike_periods_have_pooled_curves_if_their_scores_are_pooled(tmp_path):
    described = {
        name: synthetic.description(period_s=0.125 if k < 10 else 0.25, steps=8) for k, name in enumerate(RECORDINGS)
    }
    run = written(tmp_path / "run", described, 8, {"good": 0.8}, frames=2)
    summary = read_runs([run])[0].summary
    assert summary.pooled_horizons_s == (0.0, 0.5, 1.0)
    curve = curves_of(run)["all recordings", "good"]["pr_auc"]["in-motion"][STEP]
    assert_agrees_at_half(curve, summary.trackers["good"].pooled, "in-motion")


def numbers_of(page, figure):
    return list(csv.DictReader(downloaded(page, f"#{figure}").splitlines()))


def test_hidden_cells_by_time_have_bands_and_their_ends_in_the_file(page, twenty):
    section = page.locator("#hidden-time")
    assert section.locator("polygon.band").count() == 4
    assert "a band is a 95 % interval" in section.locator(".note").inner_text()
    first = numbers_of(page, "hidden-time")[0]
    point = read_runs([twenty])[0].summary.trackers["good"].pooled.at("occluded to 0.5 s", "f1", "f1", int(STEP))
    assert float(first["good low"]) == pytest.approx(point.low, rel=1e-4)
    assert float(first["good high"]) == pytest.approx(point.high, rel=1e-4)
    section.locator(".chart").focus()
    page.keyboard.press("ArrowRight")
    low, high = (f"{float(first[name]):.3f}" for name in ("good low", "good high"))
    assert f"[{low}, {high}]" in section.locator(".readout").inner_text()


def test_precision_over_recall_has_bands_and_their_ends_in_the_file(page, twenty_report):
    section = page.locator("#precision-recall")
    assert section.locator("polygon.band").count() == 4
    assert "a band is a 95 % interval" in section.locator(".note").inner_text()
    rows = [row for row in numbers_of(page, "precision-recall") if row["tracker"] == "good"]
    (pooled,) = [
        row["figures"]["pr_auc"]
        for recording in data_of(twenty_report.read_text())["recordings"]
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


def test_only_the_band_of_the_line_next_to_the_pointer_is_drawn_if_there_are_many(opened_with, run_folder, tmp_path):
    """Eight trackers, each a little better than the one before, with intervals."""

    def into_eight(summary):
        good = summary["trackers"]["good"]
        summary["trackers"] = {f"tracker {n}": copy.deepcopy(good) for n in range(8)}
        summary["differences"] = summary["pairs"] = []
        for n, label in enumerate(summary["trackers"]):
            shutil.copytree(run_folder / "good@crossing", tmp_path / "run" / f"{label}@crossing")
            area = 0.2 + 0.1 * n
            put(trial_of(summary, label), "in-motion", "pr_auc.area", area, area - 0.1, area + 0.1)

    page = opened_with(into_eight)
    figure = page.locator("#curves")
    bands = figure.locator(".band")
    assert bands.count() == 8
    assert figure.locator(".band:visible").count() == 0
    assert "of the line next to the pointer" in figure.locator(".note").inner_text()
    line = figure.locator("g.line", has=page.locator("title", has_text="tracker 5"))
    x, y = line.locator("polyline").evaluate("(line) => line.getAttribute('points').split(' ').at(-1).split(',')")
    figure.locator("svg.figure-drawing").hover(position={"x": float(x) - 3, "y": float(y)})
    assert [band.get_attribute("visibility") for band in line.locator(".band").all()] == ["visible"]
    assert figure.locator('.band[visibility="visible"]').count() == 1
    page.mouse.move(0, 0)
    assert figure.locator('.band[visibility="visible"]').count() == 0
    page.get_by_role("button", name="tracker 0").click()
    page.get_by_role("button", name="tracker 1").click()
    assert figure.locator('.band[visibility="hidden"]').count() == 0, "six can be distinguished"
