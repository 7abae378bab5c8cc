"""The data of the figures of the page: curves of probability, conditions, times, classes; and their explanations."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from gridtrack.evaluation.runs.passes import Quantiles
from gridtrack.evaluation.runs.result_files import RunError
from gridtrack.evaluation.runs.sums import SUMS_FILE, TrialSums
from gridtrack.evaluation.scores.cells import PROBABILITY_EDGES
from gridtrack.evaluation.scores.definition import Sums
from gridtrack.recordings.degradation import Degradation
from gridtrack.reports.measurements import DEGRADATION_TEXTS, keeps_up
from gridtrack.reports.page import meanings, render_page
from gridtrack.reports.run import read_runs
from gridtrack.reports.score_figures import score_figures
from gridtrack.reports.scripts import ASSETS
from gridtrack.reports.table import headline_tables

from scenes.edited_run import deadline, edited, robustness, trial_of, value_of
from scenes.report_page import data_of
from scenes.synthetic_run import write_confusion

STEPS = 20
DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture
def good_of(run_folder, tmp_path):
    """`good_of(**changes)`: the page's data of the tracker `good`, its trial changed in these keys, and all data."""

    def good_of(**changes):
        run = edited(run_folder, tmp_path / "run", lambda summary: trial_of(summary, "good").update(changes))
        data = data_of(render_page(read_runs([run])))
        (row,) = [row for row in data["recordings"][0]["rows"] if row["label"] == "good"]
        return row, data

    return good_of


def test_every_rate_has_its_f1_beside_the_untimed_one_and_its_missed_frames(good_of, run_folder, summary_of):
    row, data = good_of(deadline=deadline(1.0, 4.0))
    untimed = value_of(trial_of(summary_of(run_folder), "good"), "in-motion", "f1.f1", 4)
    rate = row["conditions"]["rate"]
    assert rate["values"] == [0.0, 1.0, 4.0]
    assert rate["scores"]["f1"]["in-motion"] == [pytest.approx(untimed), 0.4, 0.1]
    assert rate["notes"] == ["no deadline", "0 % of frames missed", "50 % of frames missed"]
    assert data["recordings"][0]["conditions_ahead_s"] == 0.5
    assert row["latency"]["highest_hz"] == 21.5


def test_a_stratum_that_was_not_scored_leaves_a_gap(good_of):
    measured = deadline(1.0, 4.0)
    del measured["rates"][1]["scores"]["f1"]["in-motion"]
    assert good_of(deadline=measured)[0]["conditions"]["rate"]["scores"]["f1"]["in-motion"][1:] == [0.4, None]


def test_degraded_input_has_its_f1_at_every_value_with_name_and_unit(good_of):
    row, data = good_of(robustness=robustness("range_noise", 0.1, "f1"))
    noise = row["conditions"]["range_noise"]
    assert noise["values"] == pytest.approx([0.0, 0.05, 0.1])
    assert noise["scores"]["f1"]["visible"] == pytest.approx([0.4, 0.35, 0.3])
    described = data["conditions"]["range_noise"]
    assert (described["name"], described["unit"]) == ("range noise", " m")


@pytest.mark.parametrize("damage", ["short", "backwards", "infinite"])
def test_invalid_conditions_are_refused_in_one_line(good_of, damage):
    timed, degraded = deadline(1.0, 4.0), robustness("range_noise", 0.1, "f1")
    if damage == "short":
        timed["rates"][0]["scores"]["f1"]["in-motion"] = [0.5]
    elif damage == "backwards":
        degraded["kinds"]["range_noise"].reverse()
    else:
        timed["rates"][0]["rate_hz"] = float("inf")
    with pytest.raises(RunError, match=r"summary\.json"):
        good_of(deadline=timed, robustness=degraded)


def test_a_score_or_condition_without_a_row_cannot_be_chosen(good_of):
    row, data = good_of()
    assert {"flow_error", "energy"}.isdisjoint(score["name"] for score in data["scores"])
    assert (row["conditions"], data["conditions"]) == ({}, {})


def test_every_kind_of_degradation_has_a_text_and_a_row_in_the_documentation():
    assert set(DEGRADATION_TEXTS) == set(Degradation.model_fields)
    page = (DOCS / "run-folder.md").read_text()
    assert [field.alias for field in Degradation.model_fields.values() if f"| `{field.alias}` |" not in page] == []


@pytest.mark.parametrize(
    ("update", "predict", "verdict"),
    [(4.0, 40.0, "yes"), (50.0, 60.0, "updates only"), (101.0, 1.0, "no")],
)
def test_a_tracker_keeps_up_when_update_and_forecast_fit_into_the_period(update, predict, verdict):
    times = [Quantiles(p50=0.1, p95=0.2, p99=ms) for ms in (update, predict)]
    assert keeps_up(*times, 100.0) == verdict


def figures_of(run):
    runs = read_runs([run])
    return score_figures(runs, headline_tables(runs))


def test_a_tracker_with_classes_has_its_confusion_matrices_now_and_at_the_steps_of_the_headline(run_folder, tmp_path):
    run = shutil.copytree(run_folder, tmp_path / "run")
    counts = {0: [[50000, 1, 0], [2, 3, 1]], 8: [[5, 1, 0], [2, 3, 1]], 9: [[1, 1, 1], [1, 1, 1]]}
    write_confusion(run / "good@crossing", ["<b>bus</b>", "car"], counts)
    figures, notices = figures_of(run)
    found = figures["crossing", "good"]["class_log_loss"]
    assert found == {"visible": {"0": {"confusion": counts[0]}, "8": {"confusion": counts[8]}}}
    assert notices == ()


def test_the_area_below_precision_over_recall_is_about_pr_auc(run_folder, summary_of):
    curves, notices = figures_of(run_folder)
    assert notices == ()
    for label in ("good", "fair", "persistence", "unlucky"):
        trial = trial_of(summary_of(run_folder), label)
        for stratum in ("in-motion", "visible"):
            curve = curves["crossing", label]["pr_auc"][stratum]["8"]
            area = sum(np.diff([0.0, *curve["recall"]]) * curve["precision"]["value"])
            assert area == pytest.approx(value_of(trial, stratum, "pr_auc.area", 8), abs=0.02)
            assert curve["p"] == sorted(curve["p"], reverse=True)
            assert len(curve["p"]) <= 80


def test_a_forecast_of_zeros_and_ones_has_one_precision_and_recall_at_every_threshold(run_folder):
    curve = figures_of(run_folder)[0]["crossing", "persistence"]["pr_auc"]["visible"]["8"]
    assert curve["p"] == pytest.approx([PROBABILITY_EDGES[-2], PROBABILITY_EDGES[1], 0.0], rel=1e-3)
    assert curve["recall"][0] == curve["recall"][1] < curve["recall"][2] == 1.0
    precision = curve["precision"]["value"]
    assert precision[0] == precision[1] > precision[2]


def test_a_calibrated_forecast_lies_on_the_diagonal(run_folder, monkeypatch):
    plain = TrialSums.by_unit

    def calibrated(self, score, units, *at):
        sums = plain(self, score, units, *at)
        if score == "calibration":
            cells, p = (np.array([part.startswith(name) for part in sums.parts]) for name in ("cells ", "p "))
            sums.values[..., cells] = 1000
            sums.values[..., [part.startswith("occupied ") for part in sums.parts]] = sums.values[..., p] = np.linspace(
                0, 1000, cells.sum()
            )
        return Sums(sums.values, sums.parts)

    monkeypatch.setattr(TrialSums, "by_unit", calibrated)
    curve = figures_of(run_folder)[0]["crossing", "good"]["calibration"]["dynamic"]["8"]
    assert curve["mean_p"] == pytest.approx(curve["share"], abs=1e-3)
    assert len(curve["share"]) > 50


def test_sums_that_cannot_be_read_have_a_notice_and_the_page_is_complete(run_folder, tmp_path):
    run = shutil.copytree(run_folder, tmp_path / "run")
    (run / "good@crossing" / SUMS_FILE).write_bytes(b"not")
    curves, notices = figures_of(run)
    assert ("crossing", "good") not in curves
    assert ("crossing", "fair") in curves
    assert notices[0].startswith("good: no curves of its probabilities")


def test_every_figure_and_table_of_the_page_is_explained_under_its_own_heading():
    headings = re.findall(r"^## (.*)$", (DOCS / "figures.md").read_text(), re.MULTILINE)
    titles = [title for path in ASSETS.glob("*.js") for title in re.findall(r'title: "([^"]+)"', path.read_text())]
    assert len(titles) >= 8
    assert [title for title in [*titles, "Ranking", "Over the horizon", "Moments"] if title not in headings] == []
    templates = "".join(path.read_text() for path in (ASSETS.parent / "templates").glob("*.j2"))
    slugs = {heading.lower().replace(" ", "-") for heading in headings}
    named = set(re.findall(r'draw\.meaning\("([\w-]+)"\)', templates))
    assert named
    assert named <= slugs


@pytest.mark.parametrize("meaning", meanings(), ids=lambda meaning: meaning.name)
def test_a_meaning_reads_without_its_links_and_pictures(meaning):
    """The page opens from disk, where no link into the documentation works."""
    assert meaning.paragraphs
    for paragraph in meaning.paragraphs:
        assert re.fullmatch(r"[A-Z].*\.", paragraph)
        assert not re.search(r"[\[\]`*!]|\((definition|see)\)|\.md|: [a-z]+\.$", paragraph)
