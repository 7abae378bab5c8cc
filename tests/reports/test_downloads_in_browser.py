"""The numbers of a figure as a file: what the axis says stands in the file too."""

import csv
import json
import shutil

import pytest

from gridtrack.reports.page import render_report

from scenes.report_page import opened

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
        "rates": [{"rate": rate, "rate_hz": 8.0 * rate, **RATE, "f1": f1} for rate in rates],
    }


@pytest.fixture(scope="module")
def report(run_folder, tmp_path_factory):
    """A report with hidden cells by the time since they were seen, and with scores at higher rates of frames."""
    run = shutil.copytree(run_folder, tmp_path_factory.mktemp("downloads") / "run")
    summary = json.loads((run / "summary.json").read_text())
    for entry in summary["trackers"].values():
        (trial,) = entry["recordings"].values()
        for at, age in enumerate(AGES):
            trial["strata"][f"occluded {age}"] = {**trial["strata"]["visible"], "f1": [0.5 - 0.1 * at] * (STEPS + 1)}
    summary["trackers"]["good"]["recordings"]["crossing"]["deadline"] = deadline(1.0, 4.0)
    (run / "summary.json").write_text(json.dumps(summary))
    return render_report([run])


@pytest.fixture
def numbers_of(browser, report):
    """`numbers_of(figure)`: the rows of its CSV file."""
    with opened(browser, report) as page:

        def numbers_of(figure):
            with page.expect_download() as saved:
                page.locator(f"#{figure}").get_by_role("button", name="CSV").click()
            return list(csv.reader(saved.value.path().read_text().splitlines()))

        yield numbers_of


def test_hidden_cells_have_the_time_in_words(numbers_of):
    heading, *rows = numbers_of("hidden-time")
    assert heading[0] == "time since the cell was last seen"
    assert [row[0] for row in rows] == AGES
    assert [float(row[heading.index("good")]) for row in rows] == pytest.approx([0.5, 0.4, 0.3])


def test_a_rate_is_a_number_but_where_there_was_none(numbers_of):
    heading, *rows = numbers_of("conditions")
    assert heading[0] == "rate of frames"
    assert [row[0] for row in rows] == ["untimed", "1", "4"]


@pytest.mark.parametrize(
    ("figure", "told"),
    [
        ("ranking", {"recording": "crossing", "stratum": "in-motion", "score": "pr_auc", "horizon, s": "1"}),
        ("curves", {"recording": "crossing", "stratum": "in-motion", "score": "pr_auc"}),
        ("every-score", {"recording": "crossing", "stratum": "in-motion", "horizon, s": "1"}),
        ("conditions", {"recording": "crossing", "stratum": "in-motion", "score": "f1", "horizon, s": "0.5"}),
    ],
)
def test_a_file_says_in_every_row_what_its_numbers_are_of(numbers_of, figure, told):
    heading, *rows = numbers_of(figure)
    assert rows
    for row in rows:
        assert dict(zip(heading, row, strict=True)).items() >= told.items()
    assert len(set(heading)) == len(heading)
