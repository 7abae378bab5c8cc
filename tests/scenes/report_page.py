"""The data for the scripts of a report page."""

import base64
import json
import re
import zlib
from contextlib import closing, contextmanager

HOSTILE = "<script>alert(1)<\\script><img src=x onerror=alert(1)>, & %2C"
"""A name of a tracker that would run, were it HTML."""


@contextmanager
def opened(browser, report, fragment="", **options):
    """The page of a report in the browser, drawn, with all figures; it had no error, no dialog and no request.

    `options` of the page, such as its viewport.
    """
    faults = []
    with closing(browser.new_page(**options)) as page:
        page.set_default_timeout(60_000)
        page.on("console", lambda message: message.type == "error" and faults.append(message.text))
        page.on("pageerror", lambda error: faults.append(str(error)))
        page.on("dialog", lambda dialog: (faults.append(dialog.message), dialog.dismiss()))
        page.on("request", lambda one: one.url.startswith(("file:", "data:")) or faults.append(one.url))
        page.goto(report.as_uri() + fragment)
        page.locator("#every-score table").wait_for()
        page.locator("#details").evaluate("one => { one.open = true; }")
        yield page
    assert faults == []


def downloaded(page, figure, kind="CSV"):
    """The text of the file that a button of a figure, or of another part of the page, saves."""
    with page.expect_download() as saved:
        page.locator(figure).get_by_role("button", name=kind).click()
    return saved.value.path().read_text("utf-8")


def data_of(page):
    """The data of a page, its HTML, without its moments."""
    (packed,) = re.findall(r'id="page-data">(.*?)</script>', page, re.DOTALL)
    return json.loads(zlib.decompress(base64.b64decode(packed)))


def moments_of(page):
    """The moments of each recording that has a player."""
    return [json.loads(text) for text in re.findall(r'id="moments-\d+">(.*?)</script>', page, re.DOTALL)]
