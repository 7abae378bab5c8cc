"""A baseline of several trainings through the command line: the spread between trainings, falls, and errors."""

from __future__ import annotations

import json

import pytest

MIDDLE = slice(5, 13)


@pytest.fixture
def baseline_of(write_run, regress, tmp_path):
    """`baseline_of(*trainings)`: a baseline of one run for each, given as fields of Made, and the output."""

    def baseline_of(*trainings, recordings=20):
        runs = [write_run(f"then-{n}", {"net": made}, recordings) for n, made in enumerate(trainings)]
        path = tmp_path / "baseline.json"
        return path, regress(*runs, "--baseline", path, "--update")

    return baseline_of


WEAKER = {"recall": 0.60, "seed": 3}


def test_a_weaker_training_is_worse_than_a_single_better_one_with_the_note_that_the_spread_is_unknown(
    baseline_of, write_run, regress
):
    path, made = baseline_of({"recall": 0.62})
    assert "the spread between trainings is unknown" in made.out
    done = regress(write_run("now", {"net": WEAKER}), "--baseline", path)
    assert done.code == 1
    assert "the spread between trainings is unknown" in done.out


def test_a_weaker_training_is_no_worse_than_two_with_the_same_spread(baseline_of, write_run, regress):
    path, made = baseline_of({"recall": 0.62, "seed": 1}, {"recall": 0.60, "seed": 2})
    assert "of 2 runs\nnet: F1 differs by up to 0.0" in made.out
    done = regress(write_run("now", {"net": WEAKER}), "--baseline", path)
    assert done.code == 0
    assert "the spread between trainings is from the 2 runs of the baseline" in done.out


def test_a_fall_beyond_the_spread_between_trainings_is_worse_and_the_spread_is_printed(baseline_of, write_run, regress):
    path, _ = baseline_of(*({"recall": 0.61 + 0.002 * seed, "seed": seed} for seed in range(4)))
    run = write_run("now", {"net": {"recall": 0.61, "seed": 9, "loss": 0.06, "at": MIDDLE}})
    done = regress(run, "--baseline", path, "--json")
    worse = [row for row in json.loads(done.out)["rows"] if row["standing"] == "worse"]
    assert (done.code, [(row["stratum"], row["band"]) for row in worse]) == (1, [("dynamic", "middle")])
    assert 0 < worse[0]["spread"] < worse[0]["fall"] / 4
    assert ", spread between trainings 0.0" in regress(run, "--baseline", path).out


def test_a_repeat_of_any_training_in_the_baseline_passes_whatever_its_difference_from_the_others(
    baseline_of, write_run, regress
):
    trainings = [{"recall": 0.7, "seed": 1}, {"recall": 0.7, "seed": 2}, {"recall": 0.2, "seed": 3}]
    path, _ = baseline_of(*trainings)
    for number, made in enumerate(trainings):
        done = regress(write_run(f"again-{number}", {"net": made}), "--baseline", path, "--json")
        assert done.code == 0
        assert {row["standing"] for row in json.loads(done.out)["rows"]} == {"equal"}


def test_a_deterministic_tracker_is_judged_by_the_margin_next_to_a_trained_one(write_run, regress, tmp_path):
    path = tmp_path / "baseline.json"
    runs = [write_run(f"then-{n}", {"net": {"seed": n}, "fixed": {}}) for n in range(3)]
    assert "fixed: F1 is the same in all runs" in regress(*runs, "--baseline", path, "--update").out
    done = regress(write_run("now", {"net": {"seed": 4}, "fixed": {"loss": 0.03}}), "--baseline", path)
    assert done.code == 1
    assert "worse than the baseline: fixed\n" in done.out


@pytest.mark.parametrize(
    ("others", "code", "says"),
    [
        (
            [{"net": {"options": {"width": 2}}}],
            2,
            "'net' is not the same in two runs (options: none in the baseline, width=2",
        ),
        ([{"else": {}}], 3, "tracker net of the baseline is missing in the run"),
        ([{"net": {}, "else": {}}], 3, "tracker else of the baseline is missing in the run"),
        ([{"net": {"outcome": "crashed", "scored": 2}}], 3, "net@junction-00: crashed"),
    ],
)
def test_runs_that_are_not_trainings_of_the_same_tracker_make_no_baseline(
    write_run, regress, tmp_path, others, code, says
):
    path = tmp_path / "baseline.json"
    runs = [write_run(f"then-{n}", given) for n, given in enumerate([{"net": {}}, *others])]
    done = regress(*runs, "--baseline", path, "--update")
    assert (done.code, says in done.err, path.exists()) == (code, True, False)


def test_trainings_on_too_few_units_a_run_given_twice_and_two_runs_to_judge_are_wrong_use(
    baseline_of, write_run, regress, tmp_path
):
    _, few = baseline_of({"seed": 1}, {"seed": 2}, recordings=2)
    assert (few.code, "2 runs of 2 units: the spread between trainings needs 20 or more" in few.err) == (2, True)
    run, path = write_run("now", {"net": {}}), tmp_path / "baseline.json"
    twice = regress(run, run, "--baseline", path, "--update")
    assert (twice.code, "a run is given twice" in twice.err) == (2, True)
    judged = regress(run, tmp_path / "then-0", "--baseline", path)
    assert (judged.code, "2 runs: one is judged at a time" in judged.err) == (2, True)
