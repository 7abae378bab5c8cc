"""The numbers of a figure as a file, with the words of its axis."""

import csv

import pytest

from gridtrack.reports.page import render_report

from scenes.edited_run import deadline, edited, put, trial_of
from scenes.report_page import downloaded, opened

AGES = ["to 0.5 s", "0.5-1 s", "over 4 s"]


@pytest.fixture(scope="module")
def report(run_folder, tmp_path_factory):
    """A report with hidden cells by the time since they were seen, and with scores at higher rates of frames."""

    def add(summary):
        for label in summary["trackers"]:
            for at, age in enumerate(AGES):
                put(trial_of(summary, label), f"occluded {age}", "f1.f1", 0.5 - 0.1 * at)
        trial_of(summary, "good")["deadline"] = deadline(1.0, 4.0)

    return render_report([edited(run_folder, tmp_path_factory.mktemp("downloads") / "run", add)])


@pytest.fixture(scope="module")
def page(browser, report):
    """One page for all tests: they make the choices that they depend on."""
    with opened(browser, report) as page:
        yield page


def numbers_of(page, figure):
    """The rows of the CSV file of a figure."""
    return list(csv.reader(downloaded(page, f"#{figure}").splitlines()))


@pytest.mark.parametrize(
    ("figure", "axis", "positions"),
    [
        ("hidden-time", "time since the cell was last seen", AGES),
        ("scale", "side in cells", ["1", "3", "5", "9"]),
        ("conditions", "rate of frames", ["untimed", "1", "4"]),
    ],
)
def test_the_first_column_of_a_file_has_the_positions_on_the_axis(page, figure, axis, positions):
    heading, *rows = numbers_of(page, figure)
    assert heading[0] == axis
    assert [row[0] for row in rows] == positions
    if figure == "hidden-time":
        assert [float(row[heading.index("good")]) for row in rows] == pytest.approx([0.5, 0.4, 0.3])


@pytest.mark.parametrize(
    ("figure", "choices"),
    [
        ("ranking", {"recording": "crossing", "stratum": "in-motion", "score": "pr_auc", "horizon, s": "1"}),
        ("curves", {"recording": "crossing", "stratum": "in-motion", "score": "pr_auc"}),
        ("scale", {"recording": "crossing", "stratum": "in-motion", "score": "fss", "horizon, s": "1"}),
        ("every-score", {"recording": "crossing", "stratum": "in-motion", "horizon, s": "1"}),
        ("conditions", {"recording": "crossing", "stratum": "in-motion", "score": "f1", "horizon, s": "0.5"}),
    ],
)
def test_a_file_has_the_choices_in_every_row(page, figure, choices):
    heading, *rows = numbers_of(page, figure)
    assert rows
    for row in rows:
        assert dict(zip(heading, row, strict=True)).items() >= choices.items()
    assert len(set(heading)) == len(heading)


def test_one_tracker_has_the_same_f1_at_a_threshold_as_among_others(browser, report):
    """The thresholds of a line fall, and the rows of a file rise."""
    with opened(browser, report) as page:
        page.locator("#threshold").get_by_label("Cells").select_option("visible")
        heading, *rows = numbers_of(page, "threshold")
        among_others = {
            (float(row[heading.index("threshold")]), float(row[heading.index("F1")]))
            for row in rows
            if row[0] == "fair"
        }
        for name in ("good", "persistence", "blank", "unlucky"):
            page.locator("#trackers").get_by_role("button", name=name, exact=True).click()
        heading, *rows = numbers_of(page, "threshold")
    assert heading[:2] == ["threshold", "fair"]
    assert len({f1 for _, f1 in among_others}) > 1
    assert {(float(row[0]), float(row[1])) for row in rows} == among_others


@pytest.mark.parametrize(("call", "p50", "spread"), [("update", "2", 19), ("predict", "20", 0)])
def test_the_file_of_times_has_memory_and_keeps_up_and_each_percentile_once(page, call, p50, spread):
    """Of the forecasts the spread was not kept."""
    page.locator("#latency").get_by_label("Call").select_option(call)
    heading, *rows = numbers_of(page, "latency")
    assert len(set(heading)) == len(heading)
    good, fair = (dict(zip(heading, row, strict=True)) for row in rows[:2])
    assert fair["p50, ms"] == p50
    assert (fair["peak memory, MiB"], fair["keeps up"], fair["device"]) == ("123", "yes", "processor")
    assert good["device"] == "NVIDIA H100"
    assert "good · NVIDIA H100" in page.locator("#latency svg.figure-drawing").text_content()
    assert (fair["recording"], fair["call"]) == ("crossing", call)
    assert sum(bool(fair[f"p{p}, ms"]) for p in range(0, 101, 5) if p not in (50, 95)) == spread
