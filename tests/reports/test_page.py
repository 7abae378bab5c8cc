"""The page opens from disk without network access, runs its own scripts only, escapes every name, and shows the run."""

import base64
import hashlib
import re
import shutil
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from gridtrack.common.grid import GridSpec
from gridtrack.evaluation.referee.samples import SAMPLES, read_samples
from gridtrack.reports.page import render_report
from gridtrack.reports.pictures import frame_png, probability_png
from gridtrack.reports.run import ReportError

from scenes.edited_run import edit, edited, put, trial_of
from scenes.report_page import data_of

HOSTILE = '</script><script>alert(1)</script><img src="https://example.org/x">"\' & {{ 7 * 7 }}'


class Elements(HTMLParser):
    """Every element of a page with its attributes, and all text."""

    def __init__(self, page):
        super().__init__()
        self.elements, self.text, self.open = [], [], []
        self.feed(page)

    def handle_starttag(self, tag, attributes):
        self.elements.append((tag, dict(attributes)))
        self.open.append(tag)

    def handle_endtag(self, tag):
        while self.open and self.open.pop() != tag:
            pass

    def handle_data(self, data):
        if not {"style", "script"} & set(self.open):
            self.text.append(data)


def page_of(*runs, out):
    return render_report(runs, out).read_text("utf-8")


@pytest.fixture(scope="session")
def page(run_folder, tmp_path_factory):
    return page_of(run_folder, out=tmp_path_factory.mktemp("page"))


def assert_self_contained(page):
    elements = Elements(page).elements
    for tag, attributes in elements:
        assert tag not in {"link", "iframe", "object", "embed", "base", "form"}
        assert not any(name.startswith("on") or name == "style" for name in attributes)
        for name in {"src", "href", "xlink:href", "srcset", "action", "data", "poster"} & set(attributes):
            assert attributes[name].startswith("data:image/png;base64,")
    (style,) = re.findall(r"<style>(.*?)</style>", page, re.DOTALL)
    (script,) = re.findall(r'<script type="module">(.*?)</script>', page, re.DOTALL)
    *moments, data, module = [a["type"] for tag, a in elements if tag == "script"]
    assert ({*moments} <= {"application/json"}, data, module) == (True, "text/plain", "module")
    assert not re.search(r"https?://(?!www\.w3\.org/2000/svg)", script)
    assert not re.search(r"\b(import|fetch|eval|innerHTML|XMLHttpRequest|WebSocket)\b", script)
    assert "url(" not in style
    assert "@import" not in style
    (policy,) = [a["content"] for tag, a in elements if tag == "meta" and "http-equiv" in a]
    hashes = (base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() for text in (script, style))
    allowed = "default-src 'none'; img-src data:; script-src 'sha256-{}'; style-src 'sha256-{}'".format(*hashes)
    assert policy == f"{allowed}; base-uri 'none'; form-action 'none'"


def test_the_page_is_in_the_run_folder_and_refers_to_nothing_outside_itself(run_folder, page):
    assert_self_contained(page)
    path = render_report([run_folder])
    assert path == run_folder / "report" / "index.html"
    assert path.read_text("utf-8") == page
    assert path.stat().st_size < 1 << 20


def test_every_picture_and_figure_has_a_description_in_words(page):
    pictures = [a for tag, a in Elements(page).elements if tag == "svg" and a.get("role") == "img"]
    assert len(pictures) > 5
    assert all(picture.get("aria-label") for picture in pictures)
    others = [a for tag, a in Elements(page).elements if tag == "svg" and a.get("role") != "img"]
    assert all(other.get("aria-hidden") == "true" for other in others)


def test_the_data_of_the_page_has_the_summarys_numbers(page, run_folder, summary_of):
    strata = trial_of(summary_of(run_folder), "fair")["strata"]
    (fair,) = [row for row in data_of(page)["recordings"][0]["rows"] if row["label"] == "fair"]
    compared = 0
    for stratum, scores in strata.items():
        for score, outputs in scores.items():
            for output, estimate in outputs.items():
                if None not in estimate["value"]:
                    shown = fair["strata"][stratum][score][output]["value"]
                    assert shown == pytest.approx(estimate["value"], rel=1e-4, abs=1e-9)
                    compared += 1
    assert compared > 60


def test_without_a_script_the_pictures_of_one_moment_are_the_samples(page, run_folder):
    samples = {s.stamp_ns: s for s in read_samples(run_folder / "fair@crossing" / SAMPLES)}
    shown = {a["href"] for tag, a in Elements(page).elements if tag == "image"}
    (sample,) = (s for s in samples.values() if probability_png(s.forecast[1]) in shown)
    assert frame_png(sample.visible, sample.occupied) in shown
    assert frame_png(sample.observed_visible[1], sample.observed_occupied[1]) in shown


def test_the_sensor_is_marked_at_its_position_in_inputs_only(page):
    """It may have moved on before the observed frames, which are drawn in the window of the input."""
    inputs = re.findall(r'aria-label="Input at .*?</svg>', page, re.DOTALL)
    assert inputs
    # (0.0, 0.3) m on a grid from (-3.2, 0) in cells of 0.2 m: 16 cells from the left, 1.5 from the bottom of 32
    assert all('class="sensor" transform="translate(16.0 30.5)' in one for one in inputs)
    assert page.count('class="sensor" transform') == len(inputs)


def test_a_tracker_has_one_style_everywhere(page):
    styles = {}
    for found in re.finditer(r'<svg class="swatch ([^"]+)".*?</svg>(?:<span class="label">)?([\w-]+)', page):
        styles.setdefault(found[2], set()).add(found[1].split()[0])
    assert {name: len(own) for name, own in styles.items()} == dict.fromkeys(styles, 1)
    assert len({next(iter(own)) for own in styles.values()}) == len(styles) == 5


def test_a_partial_trial_has_a_notice_and_is_shown_as_not_ranked(page):
    text = " ".join("".join(Elements(page).text).split())
    assert "unlucky: crashed; ValueError: lost my way; 7 of 20 frames scored, not ranked" in text
    assert "not ranked: not every frame was scored" in text
    assert "unlucky: crashed (ValueError: lost my way)" in text.partition("Before you read the scores")[0]


def test_hostile_names_are_text_and_nothing_else(run_folder, tmp_path):
    hostile_label = HOSTILE.replace("/", "\\")
    machine = {"cpu": HOSTILE, "cores": 2, "memory_gb": 8.0, "system": HOSTILE}
    record = {"command": [HOSTILE], HOSTILE: HOSTILE, "machine": machine, "versions": {HOSTILE: HOSTILE}}

    def poison(summary):
        summary["notices"] = [{"text": HOSTILE}]
        summary["trackers"]["good"]["points"] = HOSTILE
        trial_of(summary, "unlucky").update(reason=HOSTILE, outcome=HOSTILE)
        summary["recordings"]["crossing"]["stretch"] = HOSTILE
        summary["trackers"][hostile_label] = summary["trackers"].pop("fair")

    run = edit(edited(run_folder, tmp_path / "run", poison), lambda content: content.update(record), "run.json")
    (run / "fair@crossing").rename(run / f"{hostile_label}@crossing")
    page = page_of(run, out=tmp_path / "page")
    assert_self_contained(page)
    assert "".join(Elements(page).text).count(HOSTILE) >= 5
    assert hostile_label in {tracker["label"] for tracker in data_of(page)["trackers"]}
    assert "49" not in {text.strip() for text in Elements(page).text}


def test_a_run_without_samples_has_no_player(run_folder, tmp_path):
    run = shutil.copytree(run_folder, tmp_path / "run")
    for samples in run.glob(f"*/{SAMPLES}"):
        samples.unlink()
    page = page_of(run, out=tmp_path / "page")
    assert "<h2>Moments</h2>" not in page


def test_damaged_samples_have_a_notice_and_the_rest_is_shown(run_folder, tmp_path):
    run = shutil.copytree(run_folder, tmp_path / "run")
    path = run / "fair@crossing" / SAMPLES
    path.write_bytes(path.read_bytes()[:-4000])
    page = page_of(run, out=tmp_path / "page")
    assert "fair has pictures only of the frames before the damage" in page
    assert "<h2>Moments</h2>" in page


def test_samples_of_another_grid_are_refused(run_folder, tmp_path, monkeypatch):
    samples = list(read_samples(run_folder / "fair@crossing" / SAMPLES))

    def shifted(path):
        return iter([replace(s, grid=GridSpec(32, 0.3)) for s in samples] if "fair" in str(path) else samples)

    monkeypatch.setattr("gridtrack.reports.player.read_samples", shifted)
    with pytest.raises(ReportError, match="fair: its samples have another grid"):
        render_report([run_folder])


def test_out_is_a_folder_as_elsewhere_and_a_file_is_refused(run_folder, tmp_path):
    path = render_report([run_folder], tmp_path / "page")
    assert path == tmp_path / "page" / "index.html"
    assert path.read_text("utf-8").startswith("<!doctype html>")
    for out in (tmp_path / "page" / "index.html", tmp_path / "new.html"):
        with pytest.raises(ReportError, match=r"the report is index\.html in a folder: name the folder"):
            render_report([run_folder], out)


def test_runs_side_by_side_are_named_and_the_page_is_in_the_folder_of_the_first(run_folder, tmp_path):
    first, second = (shutil.copytree(run_folder, tmp_path / name) for name in ("before", "after"))
    path = render_report([first, second])
    assert path == first / "report" / "side-by-side.html"
    page = path.read_text("utf-8")
    assert_self_contained(page)
    assert "before: good" in page
    assert "after: good" in page
    assert "<h2>Changes</h2>" not in page, "both have the same command, settings and versions"


def test_a_run_in_which_every_trial_failed_is_still_a_page(make_run, tmp_path):
    run = make_run(tmp_path / "run", trackers={}, broken=[("net", 0, "untrained", "no weights for site 'x'")])
    page = page_of(run, out=tmp_path / "page")
    assert "No tracker completed crossing" in page
    floor = {"blank": ("blank", lambda _: np.zeros((21, 32, 32), np.float32))}
    beside = make_run(tmp_path / "beside", trackers=floor, broken=[("net", 3, "interrupted", "")])
    assert "No tracker but the floors completed crossing" in page_of(beside, out=tmp_path / "other page")
    assert page.count("no weights for site") == 2, "in the answer and in the notices"


def lead_of_run(run, tmp_path):
    (lead,) = re.findall(r'<p class="lead">(.*?)</p>', page_of(run, out=tmp_path / "page"), re.DOTALL)
    return lead


def test_without_motion_the_lead_does_not_say_that_no_tracker_completed(run_folder, tmp_path):
    run = with_pr_auc_in_motion(run_folder, tmp_path / "run", good=None, persistence=None)
    assert lead_of_run(run, tmp_path).startswith("No tracker has a PR-AUC on in-motion cells 1 s ahead on crossing")


def test_the_lead_says_if_only_the_floor_ran(make_run, tmp_path):
    nothing = np.zeros((21, 32, 32), np.float32)
    run = make_run(tmp_path / "run", trackers={"blank": ("blank", lambda _: nothing)})
    assert lead_of_run(run, tmp_path) == "Only trackers of the floor were run on crossing."


def with_pr_auc_in_motion(run, target, **pr_auc):
    """The run with only these rows, each with this PR-AUC of cells in motion at every step."""

    def change(summary):
        summary["trackers"] = {label: summary["trackers"][label] for label in pr_auc}
        for label, value in pr_auc.items():
            put(trial_of(summary, label), "in-motion", "pr_auc.area", value)

    return edited(run, target, change)


UNDECIDED = (
    ": too short for an interval: 1 unit, blocks of at least 100 s, and 20 are needed: 19 more"
    " recordings, or about 32 more minutes."
)


@pytest.mark.parametrize(
    ("pr_auc", "lead"),
    [
        (
            {"good": 0.61234, "fair": 0.5, "persistence": 0.2},
            "good has the highest PR-AUC on in-motion cells 1 s ahead, 0.612. This run cannot decide whether it is"
            f" better than the floor, persistence (0.200), or than the next tracker, fair (0.500){UNDECIDED}",
        ),
        ({"good": 0.6}, "good has a PR-AUC of 0.600 on in-motion cells 1 s ahead."),
        (
            {"good": 0.60001, "fair": 0.6, "blank": 0.0, "persistence": 0.0},
            "good and fair have the highest PR-AUC on in-motion cells 1 s ahead, 0.600 each. This run cannot decide"
            f" whether each is better than the best floor, blank and persistence (0.000){UNDECIDED}",
        ),
        ({"good": 0.0, "fair": 0.0002}, "Every tracker has a PR-AUC of 0.000 on in-motion cells 1 s ahead."),
        (
            {"good": 0.2001, "fair": 0.1, "persistence": 0.2},
            "No tracker beats the floors: persistence has a PR-AUC of 0.200 on in-motion cells 1 s ahead; the best"
            " tracker, good, has 0.200. This run cannot decide whether it is better than the floor, persistence"
            f" (0.200), or than the next tracker, fair (0.100){UNDECIDED}",
        ),
        (
            {"good": 0.0, "persistence": 0.2},
            "No tracker beats the floors: persistence has a PR-AUC of 0.200 on in-motion cells 1 s ahead; good has"
            f" 0.000. This run cannot decide whether it is better than the floor, persistence (0.200){UNDECIDED}",
        ),
    ],
)
def test_the_lead_names_the_highest_score_and_calls_no_tracker_the_best(run_folder, tmp_path, pr_auc, lead):
    assert lead_of_run(with_pr_auc_in_motion(run_folder, tmp_path / "run", **pr_auc), tmp_path) == lead
