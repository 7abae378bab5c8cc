"""Size and opening time of a report of many trackers on many recordings.

`python -m benchmarks.report_size RUN [--trackers 20] [--recordings 20]` (minutes): the trials of a finished run are
repeated under other names, so that moments, curves and histograms come from real forecasts. It prints the size of the
page, its share of the kept moments, the time to render it, and the time from the request until a browser has run the
scripts and painted. Opening needs Chromium (Debian: apt install chromium).
"""

from __future__ import annotations

import json
import shutil
import tempfile
import time
from collections.abc import Sequence
from itertools import cycle, islice
from pathlib import Path
from typing import Any

from gridtrack.evaluation.runs.run_record import RUN_FILE
from gridtrack.evaluation.runs.summary import SUMMARY_FILE
from gridtrack.reports.page import render_report

from studies.support.results_file import study_parser

MIB = 2.0**20


def repeated_run(run: Path, out: Path, trackers: int, recordings: int) -> Path:
    """Make the folder of a run at `out` with these numbers of trackers and recordings, which repeat those of `run`."""
    summary, record = (json.loads((run / name).read_text("utf-8")) for name in (SUMMARY_FILE, RUN_FILE))
    names = {f"{name} {i}": name for i, name in enumerate(islice(cycle(summary["recordings"]), recordings))}
    rows = [label for label, row in summary["trackers"].items() if row["role"] != "ceiling"]
    labels = {f"{label} {i}": label for i, label in enumerate(islice(cycle(rows), trackers))}
    out.mkdir(parents=True)
    for label, of_label in labels.items():
        for name, of_name in names.items():
            (out / f"{label}@{name}").symlink_to((run / f"{of_label}@{of_name}").resolve())
    repeated = {new: _repeated_row(summary["trackers"][old], names) for new, old in labels.items()}
    tests: dict[str, Any] = {key: [] for key, value in summary.items() if isinstance(value, list) and key != "notices"}
    tests["pooled_horizons_s"] = summary["pooled_horizons_s"]
    described = {new: summary["recordings"][old] for new, old in names.items()}
    changed = summary | tests | {"recordings": described, "trackers": repeated, "reference": ""}
    record["configuration"]["recordings"] = {
        new: record["configuration"]["recordings"][old] for new, old in names.items()
    }
    (out / SUMMARY_FILE).write_text(json.dumps(changed), "utf-8")
    (out / RUN_FILE).write_text(json.dumps(record), "utf-8")
    return out


def _repeated_row(row: dict[str, Any], names: dict[str, str]) -> dict[str, Any]:
    return row | {"recordings": {new: row["recordings"][old] for new, old in names.items()}}


def opened_s(page: Path, chromium: str) -> tuple[float, float, str]:
    """Seconds until the last figure and until the first moment are drawn, and the page's note on its moments."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        tab = browser.new_page(viewport={"width": 1280, "height": 900})
        tab.set_default_timeout(300_000)
        begun = time.perf_counter()
        tab.goto(page.as_uri(), timeout=300_000)
        tab.locator("#every-score table").wait_for()
        figures = time.perf_counter() - begun
        tab.locator(".player[data-ready]").wait_for()
        moment = time.perf_counter() - begun
        words = tab.locator(".player .note").inner_text()
        browser.close()
    return figures, moment, words


def main(arguments: Sequence[str] | None = None) -> None:
    parser = study_parser(__doc__)
    parser.add_argument("run", type=Path, metavar="RUN")
    parser.add_argument("--trackers", type=int, default=20)
    parser.add_argument("--recordings", type=int, default=20)
    given = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        run = repeated_run(given.run, Path(folder) / "run", given.trackers, given.recordings)
        begun = time.perf_counter()
        page = render_report([run])
        print(f"rendered in {time.perf_counter() - begun:.1f} s: {page.stat().st_size / MIB:.1f} MiB", flush=True)
        chromium = shutil.which("chromium")
        if chromium is None:
            print("chromium is not installed: opening was not measured")
            return
        figures, moment, words = opened_s(page, chromium)
        print(f"figures drawn after {figures:.1f} s, the first moment after {moment:.1f} s; {words}")


if __name__ == "__main__":
    main()
