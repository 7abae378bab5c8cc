"""`gridtrack regress`: falls that a significance test over units misses, and measurements that do not compare."""

from __future__ import annotations

import json
import re
from xml.etree import ElementTree

import pytest

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


def test_a_baseline_edited_by_hand_is_not_measured(baseline_of, write_run, regress, edit):
    path = baseline_of({"net": {}}, recordings=2)

    def lower(content):
        for unit in content["runs"][0]["trackers"]["net"]["recordings"]["junction-00"]["units"]:
            unit["sums"]["f1"]["visible"]["short"][0] -= 100
            unit["sums"]["f1"]["visible"]["short"][2] += 100

    edit(path, lower)
    done = regress(write_run("now", {"net": {}}, recordings=2), "--baseline", path)
    assert done.code == 3
    assert "changed since it was written (its digest does not match its runs)" in done.err


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
    (line,) = [line for line in done.out.splitlines() if "could have shown: " in line]
    size = r"0\.0\d+ \(\w+, [^()]+ s\)"
    assert re.fullmatch(
        rf"net: the smallest fall in F1 that this baseline could have shown: {size} at best, {size} at worst", line
    )
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


def test_an_equal_limit_in_all_places_is_printed_once(baseline_of, write_run, regress):
    baseline = baseline_of({"net": {"recall": 0.7}})
    done = regress(write_run("now", {"net": {"recall": 0.7}}), "--baseline", baseline)
    lines = [line for line in done.out.splitlines() if "could have shown: " in line]
    assert lines == ["net: the smallest fall in F1 that this baseline could have shown: 0.0050 (visible, 0 to 0.5 s)"]
