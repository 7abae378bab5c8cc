"""The paths of virtual robots in a kept moment: contacts, foreseen or missed, and needless alarms, by row."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from gridtrack.evaluation.referee.samples import SAMPLES, read_samples
from gridtrack.evaluation.runs.summary import read_summary
from gridtrack.reports.page import render_report
from gridtrack.reports.robots import robots_of_moment

from scenes.drawn_samples import ROBOTS
from scenes.report_page import moments_of


def sample(robots):
    return SimpleNamespace(robots=robots)


def test_contacts_and_alarms_are_kept_and_clear_paths_without_an_alarm_are_not():
    """A contact of risk 0.25, a clear path of 0.75, and one of unknown risk, which is an alarm."""
    found = robots_of_moment({"low": sample(ROBOTS), "high": sample(ROBOTS)}, {"low": 0.2, "high": 0.5})
    assert found["paths"] == [
        [-0.5, 2.25, 0.5, 0.0, 0.5, 1.0],
        [0.25, 3.0, 0.0, -1.0, 1.0, 0.0],
        [0.0, 2.5, 0.0, 0.0, 1.0, 0.0],
    ]
    assert found["alarms"] == ["111", "011"]
    known = replace(ROBOTS, risks=np.array([np.nan, 0.75, 0.1], np.float32))
    found = robots_of_moment({"one": sample(known)}, {"one": 0.8})
    assert (found["paths"], found["alarms"]) == ([[-0.5, 2.25, 0.5, 0.0, 0.5, 1.0]], ["0"]), "not known: it is missed"


def test_a_row_without_a_forecast_or_a_threshold_has_no_alarms():
    samples = {"missing": None, "older": sample(None), "unscored": sample(ROBOTS), "good": sample(ROBOTS)}
    found = robots_of_moment(samples, {"unscored": None, "good": 0.2})
    assert found["alarms"] == [None, None, None, "111"]
    assert robots_of_moment({"missing": None, "older": sample(None)}, {}) is None


@pytest.fixture(scope="module")
def run(make_run, tmp_path_factory):
    return make_run(tmp_path_factory.mktemp("robots") / "run", robots=True)


@pytest.fixture(scope="module")
def report(run):
    return render_report([run])


def test_the_contacts_on_the_page_are_foreseen_as_the_score_says(run, report):
    """At the step of the samples, of every kept forecast; the score joins the points of its curve."""
    (data,) = moments_of(report.read_text("utf-8"))
    summary = read_summary(run)
    assert data["horizons_s"][data["robots_at"]] == 1.0
    for tracker, label in enumerate(data["trackers"]):
        paths = [
            (contact, alarm == "1")
            for moment in data["moments"]
            if moment["robots"]
            for (*_, contact), alarm in zip(moment["robots"]["paths"], moment["robots"]["alarms"][tracker], strict=True)
        ]
        met = [alarm for contact, alarm in paths if contact]
        kept = list(read_samples(run / f"{label}@crossing" / SAMPLES))
        assert len(met) == sum(int(one.robots.contact.sum()) for one in kept if one.robots)
        scores = summary.trackers[label].recordings["crossing"].strata["dynamic"]["contact_foresight"]
        assert sum(met) / len(met) <= scores["foreseen"].value[8] + 0.02
    assert len(data["moments"]) == data["kept"]


def test_the_player_draws_the_contacts_and_counts_them(opened, report):
    page, player = opened(report=report)
    page.get_by_label("tracker 1").select_option("good")
    small = player.locator(".moment-panel small", has_text="contacts foreseen").first
    foreseen, contacts = re.search(r"(\d+) of (\d+) contacts foreseen, \d+ needless", small.inner_text()).groups()
    assert int(contacts) >= int(foreseen)
    assert player.locator(".robots-legend:visible").inner_text().split("\n") == [
        "contact foreseen", "contact missed", "needless alarm", "contact",
    ]  # fmt: skip
    observed = player.locator("canvas").nth(1)
    before = observed.evaluate("one => one.toDataURL()")
    page.get_by_label("virtual robots").uncheck()
    player.locator(".robots-legend").wait_for(state="hidden")
    assert observed.evaluate("one => one.toDataURL()") != before
    page.get_by_label("virtual robots").check()
    page.get_by_role("slider", name="horizon").fill("0")
    player.locator(".robots-legend").wait_for(state="hidden")


def test_the_list_counts_contacts_missed_and_needless_alarms_and_sorts_by_them(opened, report):
    page, _ = opened(report=report)
    page.get_by_text("All kept moments as a list").click()
    moments = page.locator(".all-moments")
    moments.get_by_label("Row").select_option("persistence")
    page.get_by_role("button", name="missed by persistence").click()
    contacts, missed, needless = (
        [int(one) for one in moments.locator(f"td:nth-child({number})").all_text_contents() if one != "–"]
        for number in (6, 7, 8)
    )
    assert missed == sorted(missed, reverse=True)
    assert all(few <= all_of_them for few, all_of_them in zip(missed, contacts, strict=True))
    assert max(contacts) > 0
    assert len(needless) == len(contacts)


def test_axe_finds_nothing_serious_in_the_list_and_the_legend(opened, report, serious_findings):
    page, _ = opened(report=report, width=400, color_scheme="dark")
    page.get_by_text("All kept moments as a list").click()
    page.locator(".moment-list").wait_for()
    assert serious_findings(page) == []
    assert page.evaluate("document.documentElement.scrollWidth") <= 400
