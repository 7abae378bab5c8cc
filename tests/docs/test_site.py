"""The documentation site is built strictly, has every public name, and loads nothing from elsewhere."""

import os
import re
import subprocess
import sys

import pytest

import gridtrack

from docs.pages import ROOT

pytest.importorskip("mkdocs", reason="needs the extra `docs`")
LOADED = re.compile(r"<(?:script|img|iframe|source)\b[^>]*\bsrc=\"?([^\"\s>]+)|<link\b[^>]*\bhref=\"?([^\"\s>]+)")


def build(out, config=ROOT / "mkdocs.yml"):
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "-f", str(config), "--site-dir", str(out)]
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    return subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The built site."""
    out = tmp_path_factory.mktemp("site")
    done = build(out)
    assert done.returncode == 0, done.stderr
    return out


def test_every_public_name_has_its_docstring(site):
    page = (site / "docs/api.html").read_text("utf-8")
    assert [name for name in gridtrack.__all__ if f'id="gridtrack.{name}"' not in page] == []


def test_a_page_loads_nothing_from_elsewhere(site):
    loaded = {
        (page.name, address)
        for page in site.rglob("*.html")
        for pair in LOADED.findall(page.read_text("utf-8"))
        for address in pair
        if re.match(r"(?:https?:)?//", address)
    }
    assert loaded == set()


def test_the_search_knows_the_words_of_the_pages(site):
    index = (site / "search/search_index.js").read_text("utf-8")
    assert "Reading the report" in index
    assert "fractions skill score" in index


def test_a_page_from_disk_has_its_style_and_every_page_of_the_navigation_and_finds_words(site, browser):
    page, faults = browser.new_page(viewport={"width": 1280, "height": 800}), []
    page.on("requestfailed", lambda request: faults.append(request.url))
    page.on("pageerror", lambda error: faults.append(str(error)))
    page.goto((site / "index.html").as_uri())
    header = page.locator(".md-header")
    assert header.evaluate("one => getComputedStyle(one).position") == "sticky"
    assert page.locator(".md-nav__link", has_text="Its example in Python").count() == 1
    page.locator("input[name=query]").click()
    page.keyboard.type("fractions skill")
    page.locator(".md-search-result__item", has_text="Scores").first.wait_for()
    page.close()
    assert faults == []


@pytest.mark.parametrize(
    ("name", "width", "scheme", "palette"),
    [
        ("index.html", 1280, "light", "default"),
        ("index.html", 400, "dark", "slate"),
        ("docs/importing.html", 1280, "dark", "slate"),
        ("docs/importing.html", 400, "light", "default"),
    ],
)
def test_axe_finds_nothing_serious(site, browser, serious_findings, name, width, scheme, palette):
    page = browser.new_page(viewport={"width": width, "height": 900}, color_scheme=scheme)
    page.goto((site / name).as_uri())
    page.locator(f"body[data-md-color-scheme={palette}]").wait_for()
    assert serious_findings(page) == []
    page.close()
