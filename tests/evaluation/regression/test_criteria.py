"""`gridtrack regress`: falls that a significance test over units misses, and measurements that do not compare."""

from __future__ import annotations

import dataclasses
import json
import re
from xml.etree import ElementTree

import numpy as np
import pytest

from gridtrack.evaluation.regression.judging import judged_recordings, judged_row
from gridtrack.evaluation.regression.rows import PairedRow, row_tests
from gridtrack.evaluation.regression.settings import GateSettings
from gridtrack.evaluation.scores.definition import TrialFacts
from gridtrack.evaluation.scores.f1 import F1
from gridtrack.evaluation.scores.thresholds import half

FEW = tuple(f"junction-{number:02}" for number in range(4))


@pytest.fixture
def judged(baseline_of, write_run, regress):
    """`judged(then, now)`: the exit code, the rows that are worse, and the output."""

    def judged(then, now, *options, **run):
        path = baseline_of({"net": then}, **run)
        made = write_run("now", {"net": now}, **run)
        done = regress(made, "--baseline", path, "--json", *options)
        found = json.loads(done.out)
        worse = [row for row in (*found.get("rows", ()), *found.get("on_recordings", ())) if row["standing"] == "worse"]
        return done, worse

    return judged


def test_a_collapse_on_four_of_twenty_recordings_is_worse_without_significance(judged):
    then = {"recall": 0.7}
    done, worse = judged(then, {**then, "loss": 0.7, "only": FEW})
    pooled = [row for row in json.loads(done.out)["rows"] if (row["score"], row["stratum"]) == ("f1.f1", "dynamic")]
    assert done.code == 1
    assert min(row["p"] for row in pooled) > 0.05
    assert {(row["recording"], row["criterion"]) for row in worse} == {(name, "collapse") for name in FEW}


@pytest.mark.parametrize("now", [{}, {"seed": 5}])
def test_a_collapse_on_a_single_recording_is_worse(judged, now):
    done, worse = judged({"recall": 0.7}, {"recall": 0.7, **now, "loss": 0.5, "only": ("junction-07",)})
    assert done.code == 1
    assert {row["recording"] for row in worse if row["criterion"] == "collapse"} == {"junction-07"}


@pytest.mark.parametrize("blurred", [(), ("junction-03",)])
def test_a_ruined_log_loss_is_worse_though_f1_is_the_same(judged, blurred):
    now = {"blurred": blurred} if blurred else {"nats": 0.35}
    done, worse = judged({}, now)
    assert done.code == 1
    assert {row["score"] for row in worse} == {"log_loss.mean"}
    assert {row["recording"] for row in worse if row["criterion"] == "collapse"} >= set(blurred)


def test_a_log_loss_within_the_margin_is_no_worse(judged):
    done, worse = judged({}, {"nats": 0.104})
    assert (done.code, worse) == (0, [])


def test_worse_classes_are_worse_and_lost_ones_are_not_measured(judged, write_run, regress, tmp_path):
    done, worse = judged({"class_nats": 0.2}, {"class_nats": 1.5})
    assert (done.code, {row["score"] for row in worse}) == (1, {"class_log_loss.per_scan"})
    assert {row["stratum"] for row in worse} == {"visible"}
    lost = regress(write_run("lost", {"net": {}}), "--baseline", tmp_path / "baseline.json")
    assert lost.code == 3
    assert "class_log_loss was scored for the baseline, and is not in the run" in lost.err


@pytest.mark.parametrize(
    ("now", "says"),
    [
        ({"tracker": "other"}, "(tracker: 'net' in the baseline, 'other' in the run)"),
        ({"options": {"gate": 3}}, "(options: none in the baseline, gate=3 in the run)"),
        ({"points": "raw"}, "(points: 'centres' in the baseline, 'raw' in the run)"),
        ({"argv": ("/home/me/net", "--slow")}, "(program: 'net --fast' in the baseline, 'net --slow' in the run)"),
    ],
)
def test_another_tracker_under_the_label_is_not_measured(judged, now, says):
    then = {"argv": ("/somewhere/net", "--fast")}
    done, _ = judged(then, {**then, **now}, recordings=2)
    assert done.code == 3
    assert f"net is not the tracker of the baseline {says}" in done.err


def test_the_same_program_in_another_folder_or_interpreter_is_the_same_tracker(judged):
    serve = ("-P", "-m", "gridtrack.trackers.serve", "net")
    done, _ = judged({"argv": serve}, {"argv": ("/other/bin/python3", *serve)}, recordings=2)
    assert done.code == 0


def test_another_seed_is_not_measured_unless_the_baseline_has_several(judged, write_run, regress, tmp_path):
    done, _ = judged({}, {"run_seed": 3})
    assert done.code == 3
    assert "net: seed 0 in the baseline, 3 in the run: compare with --seed 0" in done.err
    seeds = [write_run(f"seed-{n}", {"net": {"seed": n, "run_seed": n}}) for n in range(3)]
    several = tmp_path / "several.json"
    assert regress(*seeds, "--baseline", several, "--update").code == 0
    assert regress(write_run("other", {"net": {"seed": 9, "run_seed": 9}}), "--baseline", several).code == 0


def test_more_recoveries_are_worse_and_as_many_are_not(judged, write_run, regress, tmp_path):
    done, _ = judged({"recoveries": 1}, {"recoveries": 2}, recordings=2)
    assert done.code == 1
    done = regress(tmp_path / "now", "--baseline", tmp_path / "baseline.json", "--junit", tmp_path / "junit.xml")
    assert "worse: net: continued after 4 failures inside it, in the baseline after 2\n" in done.out
    assert ElementTree.parse(tmp_path / "junit.xml").find("testcase[@name='recoveries']/failure") is not None
    same = regress(
        write_run("same", {"net": {"recoveries": 1}}, recordings=2), "--baseline", tmp_path / "baseline.json"
    )
    assert same.code == 0


def test_a_degradation_of_another_strength_is_not_measured(judged):
    done, _ = judged({"degradations": (0.1, 0.2)}, {"degradations": (0.1, 0.4)}, recordings=2)
    assert done.code == 3
    assert "net@junction-00: measured with --degrade with other values in the run" in done.err


def test_twenty_stretches_of_one_recording_are_one_recording(judged):
    done, worse = judged({"recall": 0.7}, {"recall": 0.69}, source="one")
    assert done.code == 1
    assert {row["p"] for row in worse} == {None}
    assert json.loads(done.out)["units"] < 20


def test_overlapping_stretches_of_one_recording_are_not_measured(write_run, regress, tmp_path):
    run = write_run("then", {"net": {}}, recordings=3, source="one", apart_s=5)
    done = regress(run, "--baseline", tmp_path / "baseline.json", "--update")
    assert done.code == 3
    assert "junction-00 and junction-01 are of one source and overlap" in done.err


def test_each_verdict_has_the_smallest_fall_that_would_have_been_found(judged, write_run, regress, tmp_path):
    done, _ = judged({"recall": 0.7}, {"recall": 0.7, "seed": 4, "noise": 0.03})
    rows = json.loads(done.out)["rows"]
    smallest = {row["stratum"]: row["smallest"] for row in rows if row["score"] == "f1.f1" and row["band"] == "middle"}
    assert 0.005 <= smallest["visible"] < smallest["dynamic"] < 0.05
    junit, page = tmp_path / "junit.xml", tmp_path / "page.md"
    done = regress(tmp_path / "now", "--baseline", tmp_path / "baseline.json", "--junit", junit, "--markdown", page)
    assert "net: the smallest fall in F1 that this baseline could have shown: 0.0" in done.out
    assert "| worse by | found from | margin |" in page.read_text()
    cases = ElementTree.parse(junit).findall("testcase/system-out")
    assert len(cases) == len(rows)
    limit = r"; a (fall|rise) of more than \S+, alike in all units, is worse( \(margin \S+\))?$"
    assert all(re.search(limit, case.text) for case in cases), "a fall that differs between units has another limit"


def test_a_fall_of_several_times_the_smallest_is_found_and_a_third_of_it_is_not(judged, write_run, regress, tmp_path):
    noisy = {"recall": 0.7, "seed": 4, "noise": 0.03}
    done, worse = judged({"recall": 0.7}, noisy)
    (row,) = [
        row
        for row in json.loads(done.out)["rows"]
        if (row["score"], row["stratum"], row["band"]) == ("f1.f1", "dynamic", "middle")
    ]
    assert 0.01 < row["smallest"] < 0.02
    codes = []
    for share in (1 / 3, 3.0):
        now = {**noisy, "loss": share * row["smallest"] + row["fall"], "at": slice(5, 13)}
        codes.append(regress(write_run(f"{share}", {"net": now}), "--baseline", tmp_path / "baseline.json").code)
    assert (worse, codes) == ([], [0, 1])


UNITS = 20


def fallen_row(recalls, now, recordings):
    """F1 of trainings with these recalls and a run with the recall `now`, alike in all units but for a little noise."""
    rng = np.random.default_rng(0)
    tp = 1000 * (np.array([*recalls, now])[:, None] + 0.002 * rng.standard_normal((len(recalls) + 1, UNITS)))
    parts = F1.parts(TrialFacts(0.2, 1, ("visible",), half(1, ("visible",))))
    sums = np.stack([tp, 0 * tp, 1000 - tp, *13 * [0 * tp]], axis=-1)
    return PairedRow(
        "net", F1, F1.output("f1"), "visible", "middle", parts, sums[:-1], sums[-1], np.arange(UNITS), recordings
    )


@pytest.mark.parametrize(("recalls", "worse"), [((0.3, 0.6, 0.9), False), ((0.6,), True)])
def test_a_single_recording_is_judged_over_all_units_with_the_test_over_trainings_and_has_no_list(recalls, worse):
    row = fallen_row(recalls, 0.4, ("one",) * UNITS)
    (test,) = row_tests([row])
    found = judged_row(row, test, GateSettings())
    assert found.fall > 0.1
    assert (found.verdict == "worse") == worse
    assert judged_recordings([row], [test], GateSettings()) == ()


def test_equal_rows_have_p_1_beside_a_fallen_one():
    recordings = ("one",) * UNITS
    equal, fallen = fallen_row((0.6,), 0.6, recordings), fallen_row((0.6,), 0.4, recordings)
    equal = dataclasses.replace(equal, run=equal.trainings[0])
    assert [test.p for test in row_tests([equal])] == [1.0]
    alone, beside = row_tests([fallen])[0].p, row_tests([equal, fallen])[1].p
    assert alone == beside < 0.01


def test_a_collapse_on_either_of_two_recordings_is_listed():
    row = fallen_row((0.3, 0.6, 0.9), 0.4, ("one", "two") * (UNITS // 2))
    found = judged_recordings([row], row_tests([row]), GateSettings())
    assert {(one.recording, one.criterion) for one in found} == {("one", "collapse"), ("two", "collapse")}
