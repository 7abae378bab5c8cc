"""`gridtrack regress --history`: a file for each verdict, checked when it is read, and drawn over commits."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path
from xml.etree import ElementTree

import pytest

from gridtrack.evaluation.regression.history import read_history

from scenes.edited_run import edit

GOOD, FALLEN = {"kalman": {"seed": 1}, "<b>&": {"seed": 2}}, {"kalman": {"seed": 1, "loss": 0.3}, "<b>&": {"seed": 2}}


@pytest.fixture
def check(baseline_of, write_run, regress, tmp_path, monkeypatch):
    """`check(name, trackers)` judges a run of these trackers with a history, in a git repository."""
    monkeypatch.chdir(tmp_path)
    git("init", "--quiet")
    git("commit", "--quiet", "--allow-empty", "--message", "one")
    baseline = baseline_of(GOOD)

    def check(name, trackers):
        run = tmp_path / name
        if not run.exists() and trackers:
            write_run(name, trackers)
        run.mkdir(exist_ok=True)
        return regress(run, "--baseline", baseline, "--history", tmp_path / "history")

    return check


def git(*arguments: str) -> str:
    identity = ["-c", "user.name=t", "-c", "user.email=t@example.org"]
    return subprocess.run(["git", *identity, *arguments], check=True, capture_output=True, text=True).stdout.strip()


def entries(tmp_path: Path) -> list[Path]:
    return sorted((tmp_path / "history").glob("*.json"))


def test_each_verdict_is_added_with_its_commit_and_scores_and_drawn(check, tmp_path):
    assert check("one", GOOD).code == 0
    kept = entries(tmp_path)[0].read_bytes()
    git("commit", "--quiet", "--allow-empty", "--message", "two")
    assert check("two", FALLEN).code == 1
    assert check("three", None).code == 3
    history = [entry for _, entry in read_history(tmp_path / "history")]
    assert [entry.verdict for entry in history] == ["no worse", "worse", "not measured"]
    assert [entry.commit for entry in history[1:]] == [git("rev-parse", "HEAD")] * 2
    assert history[0].commit == git("rev-parse", "HEAD~1")
    assert "so nothing was measured" in history[2].reasons[0]
    assert entries(tmp_path)[0].read_bytes() == kept
    fallen = [s for s in history[1].scores if s.standing == "worse"]
    assert {(s.label, s.score, s.stratum) for s in fallen} == {("kalman", "F1", "dynamic")}
    drawing = ElementTree.parse(tmp_path / "history" / "history.svg").getroot()
    texts = ["".join(element.itertext()) for element in drawing.iter()]
    assert any(text.startswith(f"{history[1].commit[:7]}: kalman 0.") and text.endswith(", worse") for text in texts)
    assert any("not measured: " in text for text in texts)
    assert "<b>&" in "".join(texts)
    linked = [element.get("{http://www.w3.org/1999/xlink}href", "#") for element in drawing.iter()]
    assert all(target.startswith("#") for target in linked), "the drawing loads nothing"


def test_a_score_that_was_worse_has_a_panel_with_a_cross_and_a_line_through_all_panels_that_names_it(
    baseline_of, write_run, regress, tmp_path
):
    then = {"persistence": {"seed": 2}, "kalman": {"seed": 1}}
    baseline = baseline_of(then, recordings=2)
    for name, nats in (("one", 0.1), ("two", 0.4)):
        run = write_run(name, {**then, "kalman": {"seed": 1, "nats": nats}}, recordings=2)
        regress(run, "--baseline", baseline, "--history", tmp_path / "history")
    drawing = (tmp_path / "history" / "history.svg").read_text()
    panels = re.findall(r">([^<>]+, [\d.]+ to [\d.]+ s[^<>]*)</text>", drawing)
    assert panels[:2] == ["F1, dynamic, 0.5 to 1.5 s", "F1, visible, 0.5 to 1.5 s"]
    assert "log loss, dynamic, 0.5 to 1.5 s (lower is better)" in panels
    assert drawing.count(": worse: kalman in log loss, visible, 0 to 0.5 s") >= len(panels)


def test_a_run_that_was_worse_on_one_recording_alone_is_marked_too(baseline_of, write_run, regress, tmp_path):
    baseline, history = baseline_of({"net": {}}, recordings=2), tmp_path / "history"
    now = write_run("now", {"net": {"recoveries": 1}}, recordings=2)
    assert regress(now, "--baseline", baseline, "--history", history).code == 1
    assert ": worse: a tracker on one recording, or its recoveries<" in (history / "history.svg").read_text()


def test_a_history_that_was_changed_or_shortened_is_refused(check, tmp_path):
    for name in ("one", "two"):
        assert check(name, GOOD).code == 0
    first, second = entries(tmp_path)
    text = first.read_text()
    edit(first.parent, lambda content: content.update(verdict="worse"), first.name)
    done = check("three", GOOD)
    assert (done.code, "changed since it was written" in done.err) == (2, True)
    first.unlink()
    done = check("three", GOOD)
    assert (done.code, "the entry before 20" in done.err) == (2, True)
    first.write_text(text)
    edit(second.parent, lambda content: content.update(schema=9), second.name)
    done = check("three", GOOD)
    assert (done.code, "schema '9' of a history; this gridtrack reads schema 1" in done.err) == (2, True)


@pytest.fixture
def drift(write_run, regress, tmp_path):
    """`drift(n, *options)`: `n` updates in one history, each with a log loss higher by half a margin; then `regress` on
    a run with one more rise, which passes without the history."""

    def drift(updates, *options):
        asked = ["--baseline", tmp_path / "baseline.json"]
        with_history = [*asked, "--history", tmp_path / "history"]
        runs = [write_run(f"run-{n}", {"net": {"nats": 0.1 * 1.025**n}}, recordings=2) for n in range(updates + 1)]
        for run in runs[:-1]:
            updated = regress(run, *with_history, "--update")
            assert updated.code == 0
        assert regress(runs[-1], *asked, "--margin", "0.005").code == 0
        return updated, regress(runs[-1], *with_history, "--margin", "0.005", *options)

    return drift


def test_ten_small_falls_with_an_update_after_each_are_worse_than_the_best_entry(drift, tmp_path):
    updated, done = drift(10, "--junit", tmp_path / "junit.xml", "--markdown", tmp_path / "said.md")
    assert done.code == 1
    said = [line for line in done.out.splitlines() if line.startswith("worse: net, static, 0.5 to 1.5 s: log loss ")]
    since = r"log loss 0\.\d+ to 0\.\d+, a rise of 2\d\.\d% since the best entry of the history \(\d{8}.*\); a rise of"
    assert re.search(since, said[0])
    since = [line for line in updated.out.splitlines() if line.endswith(", its largest change to the worse")]
    assert [re.search("since the (first|best) entry", line)[1] for line in since] == ["first", "best"]
    assert " since the best entry of the history (" in (tmp_path / "junit.xml").read_text()
    assert "### Since the best entry of the history" in (tmp_path / "said.md").read_text()
    history = [entry for _, entry in read_history(tmp_path / "history")]
    assert [entry.update for entry in history] == [True] * 10 + [False]
    assert history[-1].verdict == "worse"


@pytest.mark.parametrize(("updates", "options"), [(1, ()), (4, ("--tolerance", "net=0.1"))])
def test_a_fall_since_the_best_entry_within_the_margin_or_the_tolerance_is_no_worse(drift, updates, options):
    assert drift(updates, *options)[1].code == 0


def test_a_missing_entry_is_noticed_also_if_it_is_the_newest(drift, regress, tmp_path):
    drift(2)
    entries(tmp_path)[-1].unlink()
    asked = [tmp_path / "run-1", "--baseline", tmp_path / "baseline.json", "--margin", "0.1", "--history"]
    history, another = tmp_path / "history", tmp_path / "another"
    assert regress(*asked, history).code == 0
    for entry in entries(tmp_path)[1:]:
        entry.unlink()
    done = regress(*asked, history)
    assert (done.code, "the entry that was the newest when the baseline was made is missing" in done.err) == (2, True)
    assert regress(*asked[:3], "--update").code == 0
    assert regress(*asked, history).code == 2, "an update without the history keeps the name of its entry"
    assert regress(*asked, another, "--update").code == 0
    assert regress(*asked, another).code == 0


def test_entries_of_other_frames_are_not_compared(drift, write_run, regress, tmp_path):
    drift(1)
    fewer, baseline = write_run("fewer", {"net": {"recall": 0.3}}, recordings=1), tmp_path / "fewer.json"
    regress(fewer, "--baseline", baseline, "--update")
    done = regress(fewer, "--baseline", baseline, "--history", tmp_path / "history")
    assert (done.code, "no entry of the history is of these frames: the baseline alone judges" in done.out) == (0, True)
