"""Runs with other contents: a JSON file of a run's folder changed, and estimates and measurements for a summary."""

import copy
import json
import shutil

from gridtrack.evaluation.referee.strata import STRATA

STEPS = 20


def edit(run, change, file="summary.json"):
    """Change the content of a file of the run in place by `change(content)`."""
    content = json.loads((run / file).read_text())
    change(content)
    (run / file).write_text(json.dumps(content))
    return run


def edited(run, target, change, file="summary.json"):
    """A copy of the run in which `change(content)` changed a file."""
    return edit(shutil.copytree(run, target, dirs_exist_ok=True), change, file)


def with_again(run, target, change=lambda crossing, again: None):
    """A copy of the run with the recording `crossing` a second time, as `again`.

    `change` gets the strata of each row on both.
    """

    def add(content):
        recordings = content["recordings"] if "trackers" in content else content["configuration"]["recordings"]
        recordings["again"] = recordings["crossing"]
        for row in content.get("trackers", {}).values():
            row["recordings"]["again"] = copy.deepcopy(row["recordings"]["crossing"])
            change(*(row["recordings"][name]["strata"] for name in ("crossing", "again")))

    run = edit(edited(run, target, add), add, "run.json")
    for folder in list(run.glob("*@crossing")):
        shutil.copytree(folder, run / folder.name.replace("@crossing", "@again"))
        edit(
            run / folder.name.replace("@crossing", "@again"), lambda one: one.update(recording="again"), "outcome.json"
        )
    return run


def estimate(value, low=None, high=None, p=None, steps=STEPS):
    """An estimate with the same number at every step, or the curves that are given."""
    curves = {"value": value, "low": low, "high": high, "p": p}
    return {
        name: curve if isinstance(curve, list) else [curve] * (steps + 1)
        for name, curve in curves.items()
        if curve is not None or name == "value"
    }


def put(scope, stratum, output, *values, **options):
    """Put the estimate of `output`, SCORE.OUTPUT, into a stratum of a trial, of pooled results or of a difference."""
    score, _, name = output.partition(".")
    scope["strata"].setdefault(stratum, {}).setdefault(score, {})[name] = estimate(*values, **options)


def trial_of(summary, label, recording="crossing"):
    """A trial in a summary."""
    return summary["trackers"][label]["recordings"][recording]


def value_of(scope, stratum, output, step, end="value"):
    """A number of a scope in a summary as it is read from JSON."""
    score, _, name = output.partition(".")
    return scope["strata"][stratum][score][name][end][step]


def deadline(*rates):
    """The measurement of a trial at these multiples of the recorded rate, the last of which misses half of the frames.

    F1 is 0.4 divided by the rate everywhere.
    """
    times, ages = {"p50": 41.0, "p95": 44.0, "p99": 46.5}, {"p50": 1.0, "p95": 2.0, "p99": 2.0}
    measured = [
        {"rate": rate, "rate_hz": 8.0 * rate, "frames": 120, "missed": 60 if rate == rates[-1] else 0}
        | {"age_frames": ages, "scores": everywhere("f1", 0.4 / rate)}
        for rate in rates
    ]
    summed = {"highest_rate_hz": 21.505, "forecast_steps": 22, "rates": measured}
    return dict.fromkeys(("update_ms", "predict_ms", "busy_ms"), times) | summed


def robustness(kind, largest, score):
    """The measurement of a trial on degraded input: a score is 0.4 without, 0.35 at half and 0.3 at full strength."""
    points = [
        {"strength": at, "value": largest * at, "delivered": "", "scores": everywhere(score, 0.4 - 0.1 * at)}
        for at in (0.0, 0.5, 1.0)
    ]
    return {"degradation": {kind: largest}, "kinds": {kind: points}}


def everywhere(score, value):
    """A score with one value at every step and in every stratum."""
    return {score: {name: [value] * (STEPS + 1) for name in STRATA}}
