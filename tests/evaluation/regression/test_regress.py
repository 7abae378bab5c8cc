"""`gridtrack regress`: runs that pass, runs that are worse, and runs that never pass."""

from __future__ import annotations

import json
import shutil
from xml.etree import ElementTree

import pytest

from gridtrack.evaluation.regression.baseline import digest_of
from gridtrack.evaluation.regression.judging import VerdictRow
from gridtrack.reports.verdict_text import sentence_of

from scenes.edited_run import edit

MIDDLE = slice(5, 13)
NAMES = {"kalman": {}, "persistence": {"recall": 0.4, "seed": 7}}


@pytest.fixture
def baseline(baseline_of):
    """A baseline of two trackers on twenty recordings."""
    return baseline_of(NAMES)


@pytest.fixture
def short_baseline(baseline_of):
    """A baseline of two trackers on two recordings: too few for significance."""
    return baseline_of(NAMES, recordings=2)


@pytest.fixture
def run(run_of):
    """A run as the one of `short_baseline`; tests must not change it."""
    return run_of(NAMES, recordings=2)


@pytest.fixture
def judged(short_baseline, run_of, regress):
    """`judged(trackers, *options)`: the outcome of a run of these trackers against `short_baseline`."""

    def judged(trackers, *options, recordings=2):
        return regress(run_of(trackers, recordings=recordings), "--baseline", short_baseline, *options)

    return judged


NO_BASELINES = ["", "{", "[1]", "not JSON", "[" * 100_000, '{"schema": 1e999}', "\x00", '{"schema": 2, "trackers": {}}']


@pytest.mark.parametrize("content", NO_BASELINES)
def test_a_file_that_is_no_baseline_is_refused_in_one_line_and_not_replaced(content, run, regress, tmp_path):
    mine = tmp_path / "mine.json"
    mine.write_text(content)
    for update in ((), ("--update",)):
        done = regress(run, "--baseline", mine, *update)
        assert (done.code, done.err.count("\n")) == (2, 1)
        assert "make it again with --update" not in done.err
        assert mine.read_text() == content


def test_an_update_lists_the_scores_that_are_worse_than_in_the_replaced_baseline(baseline, write_run, regress):
    again = regress(write_run("same", NAMES), "--baseline", baseline, "--update")
    assert again.out.splitlines()[0] == "no worse than the baseline that it replaces"
    lower = regress(write_run("lower", {**NAMES, "kalman": {"recall": 0.3}}), "--baseline", baseline, "--update")
    worse = [
        line for line in lower.out.splitlines() if line.startswith("worse than in the baseline that it replaces: ")
    ]
    assert any(": kalman, visible, " in line and " F1 " in line for line in worse)
    assert not any("persistence" in line for line in worse)
    fewer = regress(write_run("fewer", {"kalman": {}}, recordings=2), "--baseline", baseline, "--update")
    assert fewer.out.startswith("not compared with the baseline that it replaces: ")
    assert (again.code, lower.code, fewer.code) == (0, 0, 0), "it is an update all the same"


def test_a_run_compared_with_itself_passes_and_every_count_is_equal(baseline, write_run, regress):
    done = regress(write_run("now", NAMES), "--baseline", baseline, "--json")
    verdict = json.loads(done.out)
    assert (done.code, verdict["verdict"], verdict["units"]) == (0, "no worse", 20)
    assert {row["standing"] for row in verdict["rows"]} == {"equal"}
    assert {row["p"] for row in verdict["rows"]} == {1.0}
    assert list(verdict["rows"][0]) == [
        *("label", "score", "title", "stratum", "band", "recording", "baseline", "run", "fall", "margin", "smallest"),
        *("p", "spread", "criterion", "relative", "higher_is_better", "default_margin", "since", "standing"),
    ]
    assert {(r["label"], r["score"], r["stratum"], r["band"]) for r in verdict["rows"]} == {
        (label, score, stratum, band)
        for label in NAMES
        for score in ("f1.f1", "log_loss.mean")
        for stratum in ("visible", "dynamic", "static")
        for band in ("short", "middle", "long")
    }


def test_the_baseline_of_twenty_recordings_and_two_trackers_is_small_and_has_no_pickle_in_it(baseline):
    assert baseline.stat().st_size < 300_000 / 3
    assert json.loads(baseline.read_text())["schema"] == 4


def test_a_tracker_that_lost_on_dynamic_cells_at_one_second_is_worse_there_and_only_there(baseline, write_run, regress):
    run = write_run("now", {**NAMES, "kalman": {"seed": 1, "loss": 0.05, "at": MIDDLE}})
    done = regress(run, "--baseline", baseline, "--json")
    worse = [(r["label"], r["stratum"], r["band"]) for r in json.loads(done.out)["rows"] if r["standing"] == "worse"]
    assert (done.code, worse) == (1, [("kalman", "dynamic", "middle")])
    said = regress(run, "--baseline", baseline).out
    assert "worse: kalman, dynamic, 0.5 to 1.5 s: F1 0." in said
    assert said.endswith("worse than the baseline: kalman\n")


@pytest.mark.parametrize("kalman", [{"seed": 1}, {"loss": -0.1}], ids=["another seed", "better"])
def test_another_seed_and_a_better_tracker_are_no_worse(baseline, write_run, regress, kalman):
    assert regress(write_run("now", {**NAMES, "kalman": kalman}), "--baseline", baseline).code == 0


def test_a_significant_fall_within_the_margin_or_the_tolerance_passes(baseline, write_run, regress):
    run = write_run("now", {**NAMES, "kalman": {"loss": 0.05}})
    assert regress(run, "--baseline", baseline).code == 1
    assert regress(run, "--baseline", baseline, "--margin", "0.1").code == 0
    assert regress(run, "--baseline", baseline, "--tolerance", "kalman=0.1").code == 0
    assert regress(run, "--baseline", baseline, "--tolerance", "persistence=0.1").code == 1


def test_a_small_fall_on_one_recording_of_twenty_is_printed_as_no_collapse(baseline, write_run, regress):
    run = write_run("now", {**NAMES, "kalman": {"loss": 0.05, "only": ("junction-07",)}})
    done = regress(run, "--baseline", baseline)
    assert done.code == 0
    assert "change on one recording, no collapse: kalman on junction-07, dynamic" in done.out


def test_on_too_few_units_any_fall_is_worse_unless_a_tolerance_or_margin_is_given(judged):
    fallen = {**NAMES, "kalman": {"loss": 0.01}}
    done = judged(fallen)
    assert done.code == 1
    assert "2 paired units, too few for significance, which needs 20" in done.out
    assert "persistence: every count is as in the baseline" in done.out
    for tolerated in (("--tolerance", "kalman=0.05"), ("--margin", "0.05")):
        assert judged(fallen, *tolerated).code == 0


def test_no_stated_fall_is_larger_than_the_score_itself(baseline_of, write_run, regress):
    path = baseline_of({"net": {"recall": 0.1}}, recordings=2)
    run = write_run("now", {"net": {"recall": 0.1, "loss": 0.05}}, recordings=2)
    rows = json.loads(regress(run, "--baseline", path, "--json").out)["on_recordings"]
    assert [row["smallest"] for row in rows] == [None, None]
    assert regress(run, "--baseline", path, "--margin", "0.9").code == 0


@pytest.mark.parametrize(
    ("recording", "baseline", "margin", "verdict", "says"),
    [
        ("", 0.2, 0.005, "no worse", "no fall could be found with so few units"),
        ("", 0.2, 0.3, "no worse", "no fall is beyond the margin of 0.3000"),
        ("", 0.0, 0.005, "no worse", "no fall is possible"),
        ("", 0.2, 0.005, "worse", "no fall alike in all units could be found"),
        ("hall", 0.2, 0.005, "no worse", "no fall on one recording could be found with so few cells"),
    ],
)
def test_a_row_says_why_no_fall_is_large_enough(recording, baseline, margin, verdict, says):
    where = "net", "f1.f1", "F1", "dynamic", "long", recording
    row = VerdictRow(*where, baseline, baseline, 0.0, margin, float("inf"), 1.0, None, "", verdict)
    assert sentence_of(row).split("; ")[-1] == says


def test_a_new_tracker_and_a_new_recording_are_noted_and_not_judged(judged):
    done = judged({**NAMES, "newcomer": {"recall": 0.1}}, recordings=3)
    assert done.code == 0
    assert "tracker newcomer is not in the baseline: not judged" in done.out
    assert "recording junction-02 is not in the baseline: not judged" in done.out


@pytest.mark.parametrize(
    ("then", "now", "relative", "says"),
    [
        (0.0111123, 0.0111346, True, "F1 0.011112 to 0.011135, a fall of 0.20%"),
        (0.61231, 0.58731, False, "F1 0.6123 to 0.5873, a fall of 0.0250"),
        (0.5, 0.49999998, False, "F1 0.500000000 to 0.499999980, a fall of 0.000000020"),
    ],
)
def test_a_change_is_printed_with_digits_that_show_it(then, now, relative, says):
    fall = abs(then - now) / (then if relative else 1.0)
    where = "net", "f1.f1", "F1", "dynamic", "long", ""
    row = VerdictRow(*where, then, now, fall, 0.0, 0.0, 1e-6, None, "significant", "worse", relative)
    assert says in sentence_of(row)
    assert ", p < 0.0001;" in sentence_of(row)


def test_worse_rows_are_listed_from_the_worst_down(judged):
    said = judged({"kalman": {"recall": 0.58}, "persistence": {**NAMES["persistence"], "recall": 0.1}}).out
    worse = [
        line for line in said.splitlines() if line.startswith("worse: ") and "F1" in line and " on junction" not in line
    ]
    falls = [float(line.partition("a fall of ")[2].partition(";")[0].split(",")[0]) for line in worse]
    assert (len(falls) > 6, falls) == (True, sorted(falls, reverse=True))


def other(key, value):
    return lambda run_file: run_file["configuration"]["recordings"]["junction-01"].update({key: value})


def drop_recording(run_file):
    configuration = run_file["configuration"]
    del configuration["recordings"]["junction-01"]
    configuration["trials"] = {k: v for k, v in configuration["trials"].items() if "junction-01" not in k}


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda r: r.update(status="running"), "the run is 'running', not complete"),
        (lambda r: r.update(status="interrupted"), "the run is 'interrupted', not complete"),
        (lambda r: r["configuration"].update(trials={}), "the run has no trials"),
        (
            lambda r: r["configuration"]["trials"].pop("kalman@junction-01"),
            "kalman was not measured on every recording",
        ),
        (drop_recording, "recording junction-01 of the baseline is missing in the run"),
        (other("sha256", "a"), "junction-01: not run as for the baseline (sha256: 'hash of junction-01' in"),
        (other("stretch_s", [0.0, 30.0]), "junction-01: not run as for the baseline (stretch_s: '(0.0, 60.0)' in the"),
        (other("forecast_every_frames", 4), "(forecast_every_frames: '8' in the baseline, '4' in the run)"),
        (other("validation_sha256", ""), "(validation_sha256: 'hash of another' in the baseline, '' in the run)"),
    ],
)
def test_a_run_that_is_not_complete_or_not_the_same_never_passes(short_baseline, write_run, regress, change, says):
    run = edit(write_run("now", NAMES, recordings=2), change, "run.json")
    done = regress(run, "--baseline", short_baseline)
    assert (done.code, says in done.err) == (3, True)


@pytest.mark.parametrize(
    ("made", "says"),
    [
        ({"outcome": "crashed", "scored": 4}, "junction-00: crashed"),
        ({"outcome": "untrained", "scored": 0}, "junction-00: untrained"),
        ({"outcome": "ok", "scored": 0}, "junction-00: nothing was scored"),
        ({"outcome": "ok", "scored": 7}, "junction-00: partial, 7 of 8 forecasts were scored"),
    ],
)
@pytest.mark.parametrize("label", ["kalman", "newcomer"])
def test_a_run_in_which_a_tracker_failed_or_nothing_was_scored_never_passes(
    short_baseline, run_of, regress, label, made, says
):
    run, before = run_of({**NAMES, label: made}, recordings=2), short_baseline.read_bytes()
    for update in ((), ("--update",)):
        done = regress(run, "--baseline", short_baseline, *update)
        assert (done.code, f"{label}@{says}" in done.err) == (3, True)
        assert short_baseline.read_bytes() == before


def test_a_run_without_a_tracker_of_the_baseline_never_passes(judged):
    done = judged({"kalman": {}})
    assert (done.code, "tracker persistence of the baseline is missing in the run" in done.err) == (3, True)


def cut(path):
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


@pytest.mark.parametrize(
    ("harm", "says"),
    [
        (lambda trial: cut(trial / "sums.parquet"), ""),
        (lambda trial: cut(trial / "outcome.json"), ""),
        (lambda trial: (trial / "sums.parquet").unlink(), ""),
        (lambda trial: (trial / "outcome.json").unlink(), ""),
        (
            lambda trial: edit(trial, lambda one: one.update(thresholds={}), "outcome.json"),
            "its record has no thresholds",
        ),
        (
            lambda trial: shutil.copy(f"{trial.parent}/kalman@junction-00/sums.parquet", trial),
            "other frames were delivered",
        ),
    ],
)
def test_a_trial_with_damaged_missing_or_exchanged_files_never_passes(short_baseline, write_run, regress, harm, says):
    run = write_run("now", NAMES, recordings=2)
    harm(run / "kalman@junction-01")
    done = regress(run, "--baseline", short_baseline)
    assert (done.code, "junction-01" in done.err, says in done.err) == (3, True, True)


@pytest.mark.parametrize("error", [ZeroDivisionError("division\nby zero"), MemoryError(), BrokenPipeError(32, "pipe")])
@pytest.mark.parametrize("update", [[], ["--update"]])
def test_a_crash_is_not_measured_in_one_line_and_debug_shows_its_traceback(
    short_baseline, run, regress, monkeypatch, error, update, tmp_path
):
    def crash(*_, **__):
        raise error

    monkeypatch.setattr("gridtrack.cli.regress.measure_run", crash)
    asked = update or ["--junit", tmp_path / "junit.xml"]
    done = regress(run, "--baseline", short_baseline, *asked)
    assert (done.code, done.err.count("\n")) == (3, 1)
    assert f"not measured: regress failed ({type(error).__name__}" in done.err
    assert update or "regress failed" in (tmp_path / "junit.xml").read_text()
    debugged = regress("--debug", run, "--baseline", short_baseline, *update)
    assert (debugged.code, "Traceback" in debugged.err) == (3, True)


def kalman_of(baseline):
    return baseline["runs"][0]["trackers"]["kalman"]


def unit_of(baseline):
    return kalman_of(baseline)["recordings"]["junction-00"]["units"][0]


def add_zeros(baseline):
    unit_of(baseline)["sums"]["log_loss"]["dynamic"]["short"] += ["99999*0"] * 99


def count_others(baseline):
    unit_of(baseline)["sums"]["log_loss"]["dynamic"]["short"][1] += 1


@pytest.mark.parametrize(
    ("change", "code", "says"),
    [
        (lambda b: b.update(schema=5), 2, "schema '5' of a baseline; this gridtrack reads schema 4"),
        (lambda b: b.update(schema=3), 2, "schema '3' of a baseline; this gridtrack reads schema 4"),
        (lambda b: b.pop("schema"), 2, "is not a baseline"),
        (lambda b: b.update(runs=[]), 3, "the baseline is empty"),
        (lambda b: b["runs"][0].update(trackers={}), 3, "the baseline is empty"),
        (lambda b: b["runs"].append(b["runs"][0]), 2, "2 runs of 2 units: the spread between trainings needs 20"),
        (lambda b: b.update(extra=1), 2, "not a baseline (extra: "),
        (lambda b: kalman_of(b)["recordings"].pop("junction-00"), 2, "kalman was not measured on every"),
        (lambda b: kalman_of(b)["recordings"]["junction-00"].update(units=[]), 2, "units"),
        (lambda b: b["runs"][0].update(recordings={"a": {}}), 2, "not a baseline"),
        (lambda b: unit_of(b).update(delivered="0" * 32), 3, "junction-00: other frames were delivered than for the"),
        (count_others, 3, "other strata or cells were scored"),
        (add_zeros, 2, "more than 10000 parts"),
        (lambda b: b["runs"][0].update(scoring_rules=2), 3, "scored by other rules (number 2, the run by number 1)"),
    ],
)
def test_a_baseline_that_cannot_be_used_is_one_clear_line(short_baseline, run, regress, change, code, says):
    edit(short_baseline.parent, change, short_baseline.name)
    edit(short_baseline.parent, lambda b: b.update(digest=digest_of(b.get("runs"))), short_baseline.name)
    done = regress(run, "--baseline", short_baseline)
    assert (done.code, says in done.err, done.err.count("\n")) == (code, True, 1)


def test_a_baseline_edited_by_hand_is_not_measured(short_baseline, run, regress):
    edit(short_baseline.parent, count_others, short_baseline.name)
    done = regress(run, "--baseline", short_baseline)
    assert (done.code, "changed since it was written (its digest does not match its runs)" in done.err) == (3, True)


BOM = "\ufeff"
CONFLICT = "{\n<<<<<<< HEAD\n"


@pytest.mark.parametrize(
    ("before", "encoding", "says"),
    [
        (BOM, "utf-8", "(it begins with a byte order mark (BOM): save it as UTF-8 without one)"),
        (BOM, "utf-16-le", "(it is UTF-16: save it as UTF-8)"),
        (CONFLICT, "utf-8", "(line 2 is the mark of a merge conflict: choose a side with `git checkout --ours` or"),
        ("version https://git-lfs.github.com/spec/v1\n", "utf-8", "(it is a Git LFS pointer: run `git lfs pull`"),
    ],
)
def test_a_baseline_damaged_by_an_editor_or_git_is_refused_with_the_cause(
    short_baseline, run, regress, before, encoding, says
):
    spoilt = (before + short_baseline.read_text()).encode(encoding)
    short_baseline.write_bytes(spoilt)
    for update in ((), ("--update",)):
        done = regress(run, "--baseline", short_baseline, *update)
        assert (done.code, says in done.err, done.err.count("\n")) == (2, True, 1)
    assert short_baseline.read_bytes() == spoilt


def test_a_run_without_an_occupied_cell_is_not_measured_and_makes_no_baseline(write_run, regress, tmp_path):
    run = write_run("now", {"kalman": {"occupied": False}}, recordings=2)
    for update in ((), ("--update",)):
        done = regress(run, "--baseline", tmp_path / "new.json", *update)
        assert done.code == (3 if update else 2)
    assert "now: no cell was occupied in any stratum and step band: nothing was measured" in done.err
    assert not (tmp_path / "new.json").exists()


def test_the_error_of_a_missing_baseline_names_the_option_that_makes_it(run, regress, tmp_path):
    done = regress(run, "--baseline", tmp_path / "none.json")
    assert (done.code, "--update makes one of the run" in done.err) == (2, True)
    debugged = regress("--debug", run, "--baseline", tmp_path / "none.json")
    assert (debugged.code, "Traceback" in debugged.err) == (2, True), "wrong use keeps its exit code"


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--tolerance", "kalmann=0.1"], "the baseline has no tracker 'kalmann'; did you mean 'kalman'?"),
        (["--speed-reference", "blank"], "the baseline has no tracker 'blank'"),
        (["--speed-margin", "0.1"], "speed is judged only with --speed-reference LABEL or --speed-base"),
        (["--margin", "nan"], "--margin nan: it should be a finite number"),
    ],
)
def test_wrong_use_is_one_clear_line(judged, arguments, says):
    done = judged(NAMES, *arguments)
    assert (done.code, says in done.err) == (2, True)


def test_a_folder_that_is_no_run_is_wrong_use_and_one_without_results_is_not_measured(
    short_baseline, regress, tmp_path
):
    assert regress(tmp_path / "nowhere", "--baseline", short_baseline).code == 2
    (tmp_path / "empty").mkdir()
    assert regress(tmp_path / "empty", "--baseline", short_baseline).code == 3


def timed(kalman_ms, persistence_ms=1.0):
    return {"kalman": {"ms": kalman_ms}, "persistence": {**NAMES["persistence"], "ms": persistence_ms}}


def test_speed_is_judged_as_a_ratio_so_a_slower_machine_passes_and_a_slower_tracker_does_not(
    write_run, regress, tmp_path
):
    path = tmp_path / "baseline.json"
    regress(write_run("then", timed(5.0), recordings=2), "--baseline", path, "--update")
    asked = ["--baseline", path, "--speed-reference", "persistence"]
    assert regress(write_run("slow-machine", timed(10.0, 2.0), recordings=2), *asked).code == 0
    slower = write_run("slow-tracker", timed(8.0), recordings=2)
    done = regress(slower, *asked)
    assert done.code == 1
    assert "kalman: update takes 8 times as long as persistence's, in the baseline 5: +60%, margin 50%" in done.out
    assert regress(slower, *asked, "--speed-margin", "0.7").code == 0


def test_unmeasured_speed_never_passes_if_requested(judged):
    plain = judged(NAMES)
    assert (plain.code, "speed" in plain.out) == (0, False)
    requested = judged(NAMES, "--speed-reference", "persistence")
    assert (requested.code, "speed cannot be judged" in requested.err) == (3, True)


def test_junit_and_markdown_list_worse_rows_and_escape_every_name(write_run, regress, tmp_path):
    hostile = "a-b.c_d e"
    path, junit, markdown = (tmp_path / name for name in ("b.json", "junit.xml", "page.md"))
    regress(write_run("then", {hostile: {"options": {"x": "<script>|"}}}, recordings=2), "--baseline", path, "--update")
    run = write_run("now", {hostile: {"loss": 0.1, "options": {"x": "<script>|"}}, "new\x1b": {}}, recordings=2)
    assert regress(run, "--baseline", path, "--junit", junit, "--markdown", markdown).code == 1
    suite = ElementTree.fromstring(junit.read_text())
    assert int(suite.get("failures")) == len(suite.findall("testcase/failure")) > 0
    assert int(suite.get("tests")) == len(suite.findall("testcase")) == 18
    page = markdown.read_text()
    assert "<script>" not in page
    assert "\x1b" not in page + junit.read_text()
    assert "| worse | a-b.c\\_d e | F1 | dynamic | 0 to 0.5 s |" in page


def test_a_device_without_space_is_one_line_with_the_remedy(judged):
    done = judged(NAMES, "--markdown", "/dev/full")
    assert done.code == 2
    assert "/dev/full: No space left on device: free space there, or write to another disk" in done.err


def test_junit_and_markdown_of_a_run_that_was_not_measured_hold_errors(judged, tmp_path):
    junit, markdown = tmp_path / "junit.xml", tmp_path / "page.md"
    judged({**NAMES, "kalman": {"outcome": "crashed", "scored": 2}}, "--junit", junit, "--markdown", markdown)
    suite = ElementTree.fromstring(junit.read_text())
    assert (suite.get("errors"), suite.get("failures")) == ("2", "0")
    assert "not measured" in markdown.read_text()
