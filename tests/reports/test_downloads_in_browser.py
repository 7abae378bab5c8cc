"""The numbers of a figure as a file, with the words of its axis."""

import csv

import pytest

from gridtrack.reports.page import render_report

from scenes.edited_run import edited, put, trial_of
from scenes.report_page import downloaded, opened

STEPS = 20
AGES = ["to 0.5 s", "0.5-1 s", "over 4 s"]
TIMES = {"p50": 41.0, "p95": 44.0, "p99": 46.5}
RATE = {"frames": 120, "missed": 0, "age_frames": {"p50": 1.0, "p95": 2.0, "p99": 2.0}}


def deadline(*rates):
    f1 = {"in-motion": [0.4] * (STEPS + 1)}
    return {
        **dict.fromkeys(("update_ms", "predict_ms", "busy_ms"), TIMES),
        "highest_rate_hz": 21.5,
        "forecast_steps": 22,
        "rates": [{"rate": rate, "rate_hz": 8.0 * rate, **RATE, "scores": {"f1": f1}} for rate in rates],
    }


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


def test_hidden_cells_have_the_time_in_words(page):
    heading, *rows = numbers_of(page, "hidden-time")
    assert heading[0] == "time since the cell was last seen"
    assert [row[0] for row in rows] == AGES
    assert [float(row[heading.index("good")]) for row in rows] == pytest.approx([0.5, 0.4, 0.3])


def test_a_side_of_squares_is_a_number_of_cells(page):
    heading, *rows = numbers_of(page, "scale")
    assert heading[0] == "side in cells"
    assert [row[0] for row in rows] == ["1", "3", "5", "9"]


def test_a_rate_is_a_number_but_where_there_was_none(page):
    heading, *rows = numbers_of(page, "conditions")
    assert heading[0] == "rate of frames"
    assert [row[0] for row in rows] == ["untimed", "1", "4"]


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
    (fair,) = [dict(zip(heading, row, strict=True)) for row in rows if row[0] == "fair"]
    assert fair["p50, ms"] == p50
    assert (fair["peak memory, MiB"], fair["keeps up"], fair["device"]) == ("123", "yes", "processor")
    (good,) = [dict(zip(heading, row, strict=True)) for row in rows if row[0] == "good"]
    assert good["device"] == "NVIDIA H100"
    assert "good · NVIDIA H100" in page.locator("#latency svg.figure-drawing").text_content()
    assert (fair["recording"], fair["call"]) == ("crossing", call)
    assert sum(bool(fair[f"p{p}, ms"]) for p in range(0, 101, 5) if p not in (50, 95)) == spread


def test_f1_of_a_forecast_of_zeros_and_ones_is_flat(page):
    page.locator("#threshold").get_by_label("Cells").select_option("visible")
    heading, *rows = numbers_of(page, "threshold")
    own = [row for row in rows if row[0] == "persistence"]
    f1 = {float(row[heading.index("threshold")]): float(row[heading.index("F1")]) for row in own}
    assert len(f1) == 3
    assert len({value for threshold, value in f1.items() if threshold > 0.0}) == 1
