"""Scores under a deadline and on degraded input on the page: all that summary.json has, and no more."""

import copy
import json
import re
import shutil
from pathlib import Path

import pytest

from gridtrack.evaluation.results.files import RunError
from gridtrack.evaluation.scoring.strata import STRATA
from gridtrack.recordings.degradation import Degradation
from gridtrack.reports.deadline_and_robustness import DEGRADATION_TEXTS
from gridtrack.reports.page import render_page
from gridtrack.reports.run import read_runs

STEPS = 20


def constant(value):
    return {name: [value] * (STEPS + 1) for name in STRATA}


AGES = {"p50": 1.0, "p95": 2.0, "p99": 2.0}
DEADLINE = {
    "update_ms": {"p50": 10.0, "p95": 12.0, "p99": 13.0},
    "predict_ms": {"p50": 30.0, "p95": 32.0, "p99": 33.0},
    "busy_ms": {"p50": 41.0, "p95": 44.0, "p99": 46.5},
    "highest_rate_hz": 21.505,
    "forecast_steps": 22,
    "rates": [
        {"rate": 1.0, "rate_hz": 8.0, "frames": 120, "missed": 0, "age_frames": AGES, "f1": constant(0.413)},
        {"rate": 4.0, "rate_hz": 32.0, "frames": 120, "missed": 60, "age_frames": AGES, "f1": constant(0.217)},
    ],
}
ROBUSTNESS = {
    "degradation": {"range_noise": 0.1},
    "kinds": {
        "range_noise": [
            {"strength": s, "value": 0.1 * s, "delivered": "", "f1": constant(0.4 - 0.1 * s)} for s in (0.0, 0.5, 1.0)
        ]
    },
}


@pytest.fixture
def page_of(run_folder, tmp_path, summary_of):
    """`page_of(deadline, robustness)` renders the run with these under the tracker `good`."""

    def page_of(deadline=None, robustness=None, edit=lambda summary: None):
        run = tmp_path / "run"
        shutil.copytree(run_folder, run, dirs_exist_ok=True)
        summary = summary_of(run)
        edit(summary)
        summary["trackers"]["good"]["recordings"]["crossing"] |= {"deadline": deadline, "robustness": robustness}
        (run / "summary.json").write_text(json.dumps(summary))
        return render_page(read_runs([run]))

    return page_of


def text_of(html):
    return " ".join(re.sub(r"<[^>]*>", " ", html).split())


def test_without_other_conditions_the_page_has_no_section_of_them(page_of):
    assert "Under a deadline" not in page_of()
    assert "On degraded input" not in page_of()


def test_scores_under_a_deadline_are_shown_beside_the_untimed_one(page_of, run_folder, summary_of):
    text = text_of(page_of(DEADLINE)).partition("Under a deadline")[2]
    untimed = summary_of(run_folder)["trackers"]["good"]["recordings"]["crossing"]["strata"]["in-motion"]["f1"][4]
    assert f"good 41.0 44.0 46.5 21.5 {untimed:.3f} 0.413 0.217 −50 %" in text
    assert "×1, 8 Hz ×4, 32 Hz" in text


def test_the_untimed_score_is_f1_also_where_pr_auc_leads_the_table(page_of):
    def edit(summary):
        scores = summary["trackers"]["good"]["recordings"]["crossing"]["strata"]["in-motion"]
        scores["pr_auc"] = [0.25] * len(scores["pr_auc"])
        scores["f1"] = [0.75] * len(scores["f1"])

    before, _, timed = text_of(page_of(DEADLINE, edit=edit)).partition("Under a deadline")
    assert "PR-AUC, in-motion" in before
    assert "good 41.0 44.0 46.5 21.5 0.750 0.413 0.217" in timed


def test_degraded_input_is_drawn_per_kind_and_given_in_numbers(page_of):
    html = page_of(None, ROBUSTNESS).partition("On degraded input")[2]
    assert html.count("in-motion cells; range noise") >= 2
    assert "good 0.400 0.350 0.300" in text_of(html)
    assert "0.1 m" in html
    assert "scored against the undegraded frames" in text_of(html)


@pytest.mark.parametrize("damage", ["short", "backwards", "infinite"])
def test_invalid_conditions_are_refused_in_one_line(page_of, damage):
    deadline, robustness = copy.deepcopy(DEADLINE), copy.deepcopy(ROBUSTNESS)
    if damage == "short":
        deadline["rates"][0]["f1"]["in-motion"] = [0.5]
    elif damage == "backwards":
        robustness["kinds"]["range_noise"].reverse()
    else:
        deadline["rates"][0]["rate_hz"] = float("inf")
    with pytest.raises(RunError, match=r"summary\.json"):
        page_of(deadline, robustness)


def test_a_stratum_that_was_not_scored_leaves_a_gap(page_of):
    deadline = copy.deepcopy(DEADLINE)
    del deadline["rates"][1]["f1"]["in-motion"]
    assert "0.413 – −50 %" in text_of(page_of(deadline))


def test_every_kind_of_degradation_has_a_text_and_a_row_in_the_documentation():
    assert set(DEGRADATION_TEXTS) == set(Degradation.model_fields)
    page = (Path(__file__).parents[2] / "docs" / "run-folder.md").read_text()
    assert [field.alias for field in Degradation.model_fields.values() if f"| `{field.alias}` |" not in page] == []


def test_names_are_escaped(page_of):
    robustness = ROBUSTNESS | {"kinds": {"<script>": ROBUSTNESS["kinds"]["range_noise"]}}
    assert "<script>" not in page_of(None, robustness)
