"""Pictures of a report at two widths, light and dark, as a browser shows it.

`python -m studies.report_screenshots RUN --out DIR` (half a minute) renders the report of a run and writes the first
screen, every section and the whole page, in each of WIDTHS and SCHEMES, as `WIDTH-SCHEME-NAME.png`. `--only NAME`
writes the pictures of that name alone. It needs Chromium (Debian: apt install chromium).
"""

from __future__ import annotations

import shutil
import sys
from collections.abc import Collection, Sequence
from pathlib import Path

from playwright.sync_api import Page, sync_playwright

from gridtrack.common.errors import GridtrackError
from gridtrack.reports.page import render_report

from studies.support.results_file import study_parser

WIDTHS = (1280, 400)
SCHEMES = ("light", "dark")
HEIGHT = 860
FIRST, WHOLE = "first-screen", "whole"


def take_pictures(report: Path, out: Path, chromium: str, only: Collection[str] = ()) -> list[Path]:
    """Write the pictures of a page into `out` and return their paths; `only`: names, empty for all."""
    out.mkdir(parents=True, exist_ok=True)
    taken: list[Path] = []
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        for width in WIDTHS:
            for scheme in SCHEMES:
                page = browser.new_page(viewport={"width": width, "height": HEIGHT}, color_scheme=scheme)  # type: ignore[arg-type]
                page.goto(report.resolve().as_uri())
                page.wait_for_load_state()
                page.wait_for_timeout(500)  # a player draws its first moment after the page has loaded
                taken += _of_page(page, out, f"{width}-{scheme}", only)
                page.close()
        browser.close()
    return taken


def _of_page(page: Page, out: Path, prefix: str, only: Collection[str]) -> list[Path]:
    taken = []

    def path_of(name: str) -> Path:
        taken.append(out / f"{prefix}-{name}.png")
        return taken[-1]

    if not only or FIRST in only:
        page.screenshot(path=path_of(FIRST))
    if not only or WHOLE in only:
        page.screenshot(path=path_of(WHOLE), full_page=True)
    # the bar of trackers follows the window: in a picture of a tall section it would cover the middle
    page.locator(".trackers").evaluate_all("bars => bars.forEach(bar => (bar.style.position = 'static'))")
    for section in page.locator("section[id], .player").all():
        name = section.get_attribute("id") or "player"
        if section.is_visible() and (not only or name in only) and out / f"{prefix}-{name}.png" not in taken:
            section.screenshot(path=path_of(name))
    return taken


def main(arguments: Sequence[str] | None = None) -> None:
    parser = study_parser(__doc__)
    parser.add_argument("run", type=Path, metavar="RUN")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    parser.add_argument("--only", action="append", default=[], metavar="NAME")
    given = parser.parse_args(arguments)
    chromium = shutil.which("chromium")
    if chromium is None:
        sys.exit("chromium is not installed; Debian: apt install chromium")
    try:
        report = render_report([given.run])
    except GridtrackError as error:
        sys.exit(f"{error} (`make demo` makes runs/demo)")
    for path in take_pictures(report, given.out, chromium, given.only):
        print(path)


if __name__ == "__main__":
    main()
