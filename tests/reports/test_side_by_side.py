"""The page of several runs: rows of each run reported apart, an answer for each, and the differences near the top."""

import csv
import shutil

import pytest

from gridtrack.reports.notices import notices_of
from gridtrack.reports.page import render_report
from gridtrack.reports.run import read_runs
from gridtrack.reports.run_description import changes_of
from gridtrack.reports.styles import styles_of
from gridtrack.reports.table import headline_tables

from scenes.edited_run import edit, edited, with_again
from scenes.report_page import downloaded, opened

NO_EVIDENCE = "no evidence of a difference"


def changed(run, **fields):
    return edit(run, lambda record: record.update(fields), "run.json")


@pytest.fixture(scope="module")
def two(run_folder, tmp_path_factory):
    """Two runs of the same trackers, named before and after; only their commands differ."""
    folder = tmp_path_factory.mktemp("two")
    runs = [shutil.copytree(run_folder, folder / name) for name in ("before", "after")]
    changed(runs[1], command=["gridtrack", "another"])
    return runs


@pytest.fixture(scope="module")
def page(browser, two):
    with opened(browser, render_report(two), viewport={"width": 1280, "height": 900}) as page:
        yield page


LOOKS = """all => all.map((one) => {
  const style = getComputedStyle(one.querySelector("polyline"));
  return [one.querySelector("title").textContent, style.stroke, style.strokeDasharray];
})"""


def test_a_tracker_has_one_colour_in_both_runs_and_another_dash_in_each(page):
    looks = {name: (colour, dash) for name, colour, dash in page.locator("#curves g.line").evaluate_all(LOOKS)}
    for tracker in ("good", "fair", "blank", "persistence"):
        before, after = looks[f"before: {tracker}"], looks[f"after: {tracker}"]
        assert before[0] == after[0]
        assert before[1] != after[1]
    assert len(set(looks.values())) == len(looks)


def test_a_button_hides_the_row_of_one_run(page):
    page.get_by_role("button", name="before: good", exact=True).click()
    names = page.locator("#curves g.line title").all_text_contents()
    shown = {name: page.locator(".headline tr", has_text=name).is_visible() for name in ("before: good", "after: good")}
    page.get_by_role("button", name="before: good", exact=True).click()
    assert "before: good" not in names
    assert "after: good" in names
    assert shown == {"before: good": False, "after: good": True}
    assert page.locator(".headline tr", has_text="before: good").is_visible()


def test_each_run_has_its_answer_and_the_changes_stand_before_the_figures(page):
    answers = page.locator("header").inner_text().partition("\nbefore\n")[2].split("\nafter\n")
    assert len(answers) == 2
    for answer in answers:
        assert "good and fair have the highest PR-AUC on in-motion cells" in answer
        assert "Compared on" in answer
    headings = page.locator("h2").all_text_contents()
    assert headings.index("Changes") < headings.index("Ranking")


def trials(**options):
    return {f"{label}@crossing": {"tracker": label, "options": given} for label, given in options.items()}


@pytest.fixture
def records(two, tmp_path):
    """Two runs, the second later, with another option of `good`, without `fair`, and with a seed of all its trials."""

    def first(record):
        record["command"] = ["gridtrack", "compare", "a b"]
        record["configuration"]["trials"] = trials(good={}, fair={}, persistence={})

    def second(record):
        record |= {"command": ["gridtrack", "compare"], "started": "2026-01-01T00:00:00Z"}
        record["versions"] |= {"torch": "9.9"}
        given = trials(good={"gate": 3.0}, persistence={})
        record["configuration"]["trials"] = {name: one | {"seed": 3} for name, one in given.items()}

    before, after = (
        edited(run, tmp_path / run.name, change, "run.json") for run, change in zip(two, (first, second), strict=True)
    )
    edit(after, lambda summary: summary["trackers"].pop("fair"))
    return read_runs([before, after])


def test_each_difference_is_a_line_with_the_options_first(records):
    assert [(one.name, one.values) for one in changes_of(records)] == [
        ("trackers not in every run", ("fair", "–")),
        ("good: options.gate", ("default", "3.0")),
        ("good, persistence: seed", ("0", "3")),
        ("versions.torch", ("–", "9.9")),
        ("command", ("gridtrack compare 'a b'", "gridtrack compare")),
    ]


def with_code(run, recording="crossing", **code):
    """The run with this hash of the code in the trial of each label."""
    for label, sha256 in code.items():
        edit(run / f"{label}@{recording}", lambda record, own=sha256: record.update(code_sha256=own), "outcome.json")
    return run


def test_a_tracker_with_edited_code_has_a_line(two, tmp_path):
    before, after = (shutil.copytree(run, tmp_path / run.name) for run in two)
    with_code(before, good="1a2b3c4d5e6f" + "0" * 52, fair="c" * 64, blank="")
    with_code(after, good="9f8e7d6c5b4a" + "0" * 52, fair="c" * 64, blank="d" * 64)
    found = [(one.name, one.values) for one in changes_of(read_runs([before, after])) if "code" in one.name]
    assert found == [("code of good", ("1a2b3c4d5e6f", "9f8e7d6c5b4a"))]
    assert "<td>9f8e7d6c5b4a</td>" in render_report([before, after], tmp_path / "page").read_text("utf-8")


def test_trials_of_one_row_that_ran_with_other_code_have_a_notice(two, tmp_path):
    run = with_again(two[0], tmp_path / "run")
    expected = "good: its trials ran with 2 different versions of its code"
    runs = read_runs([run])
    assert expected not in [one.text for one in notices_of(runs, headline_tables(runs))]
    with_code(with_code(run, good="1" * 64), "again", good="2" * 64)
    assert expected in [one.text for one in notices_of(runs, headline_tables(runs))]


def test_a_tracker_is_compared_across_other_recordings(records):
    before, after = records
    for run, name in ((before, "here"), (after, "there")):
        for file in ("run.json", "summary.json"):
            text = (run.path / file).read_text()
            (run.path / file).write_text(text.replace('"crossing"', f'"{name}"').replace("@crossing", f"@{name}"))
        for folder in run.path.glob("*@crossing"):
            folder.rename(run.path / folder.name.replace("@crossing", f"@{name}"))
    names = {one.name: one.values for one in changes_of(read_runs([before.path, after.path]))}
    assert names["recordings not in every run"] == ("here", "there")
    assert names["good: options.gate"] == ("default", "3.0")
    assert len(names) == 6


def test_the_options_of_another_tracker_have_no_default(records):
    before, after = records

    def replace(record):
        record["configuration"]["trials"]["good@crossing"]["tracker"] = "another"

    edit(before.path, replace, "run.json")
    names = {one.name: one.values for one in changes_of(read_runs([before.path, after.path]))}
    assert names["good: options.gate"] == ("–", "3.0")


def test_a_notice_on_missing_intervals_names_its_run(two):
    runs = read_runs(two)
    table = headline_tables(runs)[0]
    notices = [one.text for one in notices_of(runs, [table]) if "too short for an interval" in one.text]
    assert [text.partition(": crossing: ")[0] for text in notices] == ["before", "after"]


def test_a_colour_that_two_trackers_share_has_a_mark_of_its_own(two, tmp_path):
    def into_nine(summary):
        summary["trackers"] = {f"net-{i}": summary["trackers"]["good"] for i in range(9)}
        summary["differences"] = summary["pairs"] = []

    styles = styles_of(read_runs([edited(run, tmp_path / run.name, into_nine) for run in two]))
    assert len(set(styles.values())) == len(styles) == 18
    assert styles["before: net-0"].split()[0] == styles["before: net-8"].split()[0]
    assert styles["after: net-8"].endswith("run1")


def verdicts(page):
    """Each row of the ranking with its verdict against the reference, from the file of the figure."""
    rows = csv.DictReader(downloaded(page, "#ranking").splitlines())
    return {row["tracker"]: row["verdict"] for row in rows}


def test_the_reference_is_chosen_on_the_page_and_each_row_is_marked_by_its_paired_test(browser, twenty_report):
    with opened(browser, twenty_report) as page:
        marks = page.locator("#ranking text.difference")
        assert marks.count() == 0
        page.locator("#ranking").get_by_label("Reference").select_option("persistence")
        found = verdicts(page)
        assert (found["persistence"], found["good"], found["<b>even"]) == ("", "better", NO_EVIDENCE)
        assert sum("▲" in text for text in marks.all_text_contents()) == 1
        page.locator("#ranking").get_by_label("Reference").select_option("good")
        found = verdicts(page)
        assert [found[name] for name in ("persistence", "<b>even", "unlucky")] == ["worse", "worse", NO_EVIDENCE]


def test_rows_of_several_runs_are_marked_against_the_best_row_of_the_first_run_by_their_intervals(
    browser, twenty, tmp_path
):
    runs = [shutil.copytree(twenty, tmp_path / name) for name in ("before", "after")]
    with opened(browser, render_report(runs)) as page:
        assert (
            page.locator("#ranking").get_by_label("Reference").locator("option:checked").inner_text() == "before: good"
        )
        found = verdicts(page)
    assert (found["before: good"], found["after: good"]) == ("", NO_EVIDENCE)
    assert (found["before: persistence"], found["after: persistence"]) == ("worse", "worse")
