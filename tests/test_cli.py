"""The command line: results on stdout; an error of the user is one line on stderr and exit code 2."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest
import typer

from gridtrack.cli import app
from gridtrack.evaluation.hosting.limits import Limits
from gridtrack.evaluation.regression.settings import MARGIN, SPEED_MARGIN, TURNS_MARGIN
from gridtrack.evaluation.runs.recipe import Recipe
from gridtrack.evaluation.runs.settings import CompareSettings
from gridtrack.recordings import packaged_recording
from gridtrack.recordings.degradation import Degradation

DEMO = str(packaged_recording("leg_tracker"))
PACKAGE = str(Path(DEMO).parents[2])


def gridtrack(*arguments: str, code: int = 0, **environment: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "gridtrack.cli", *arguments]
    done = subprocess.run(command, env=os.environ | environment, capture_output=True, text=True, check=False)
    assert done.returncode == code, done.stdout + done.stderr
    return done


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("compare", "nowhere.mcap"), "nowhere.mcap: no such recording"),
        (("compare", f"{DEMO}@tset"), "did you mean 'test'?"),
        (("compare", DEMO, "--tracker", "kalmann"), "there is no tracker 'kalmann'; did you mean 'kalman'?"),
        (("compare", DEMO, "--tracker", "static-map:prior_frame=1"), "did you mean 'prior_frames'?"),
        (("compare", DEMO, "--tracker", "static-map:prior_frames=1e999"), "'prior_frames'"),
        (("train", "static-map", DEMO, "--out", f"{DEMO}/weights"), "Not a directory"),
        (("regress", "run", "--baseline", "b.json", "--update", "--json"), "--json: --update judges nothing"),
        (
            ("regress", "run", "--baseline", "b.json", "--update", "--junit", "a.xml"),
            "--junit: --update judges nothing",
        ),
        (("recording", "info", "no\x1b[31m\nwhere.bag"), "no [31m where.bag: no such recording"),
        (("recording", "info", "hall\udce9.mcap"), r"hall\xe9.mcap: this path is not UTF-8"),
        (("compare", DEMO, "--out", "runs/hall\udce9"), r"runs/hall\xe9: this path is not UTF-8"),
        (("compare", f"{DEMO}@../../x"), "'../../x' is not the name of a stretch: expected 1 to 160 bytes"),
        (("compare", DEMO, "--horizon", "soon"), "'soon': expected seconds, such as 2.5s"),
        (("compare", DEMO, "--grid", "100"), "grid '100': expected CELLSxMETRES"),
        (("compare", DEMO, "--every", "0"), "'every_s' = 0.0: Input should be greater than 0"),
        (("compare", DEMO, "--update-timeout", "0s"), "'update_s' = 0.0: Input should be greater than 0"),
        (("compare", DEMO, "--degrade", "beam-dropuot=0.2"), "did you mean 'beam-dropout'?"),
        (("train", "persistence", DEMO), "tracker 'persistence' has nothing to learn"),
        (("train", "static-map", f"{DEMO}@0s-80s"), "shares frames with"),
        (
            ("trackers", "check", "static-map:card=site"),
            "'static-map' needs weights, and there are none here: name a recording",
        ),
        (
            ("trackers", "new", "My Tracker"),
            "'My Tracker' is not a valid name of a tracker package: use a-z, 0-9 and -",
        ),
        (("trackers", "new", "kalman"), "a tracker 'kalman' exists: choose another name"),
        (("trackers", "new", "mine", "--out", DEMO), "exists; choose another folder with --out"),
        (("trackers", "show", "blnk"), "did you mean 'blank'?"),
        (("recording", "info", "nowhere.bag"), "nowhere.bag: no such recording"),
        (("recording", "import", DEMO, "--out", "demo.bag"), "demo.bag: a recording is written as .mcap"),
        (("compare", PACKAGE), f"{PACKAGE}: a folder that is no recording (a ROS 2 bag has metadata.yaml)"),
        (("compare", f"{PACKAGE}/nope.bag"), "nope.bag: no such recording\n"),
        (("compare", f"{PACKAGE}/data/leg_tracker/demo.bag"), "demo.bag: no such recording; known: leg_tracker.mcap\n"),
        (("compare", DEMO, "--out", __file__), "test_cli.py: is a file; a run needs a folder"),
        (("report", "nowhere"), "nowhere"),
    ],
)
def test_an_error_of_the_user_is_one_line_and_exit_code_2(arguments, says):
    done = gridtrack(*arguments, code=2)
    assert says in done.stderr
    assert done.stderr.startswith("gridtrack: ")
    assert done.stderr.count("\n") == 1
    assert done.stdout == ""


def test_the_undamaged_part_of_a_truncated_recording_can_be_used(tmp_path):
    cut, out = tmp_path / "cut.mcap", ("--out", str(tmp_path / "out"))
    content = Path(DEMO).read_bytes()
    cut.write_bytes(content[: len(content) // 2])
    broken = r"the recording is 63\.6 s long \(cut off in the middle of a record\): name a range .* \(.*@0s-63s\)"
    commands = (["compare", f"{cut}@0s-20s", "--tracker", "persistence"], ["train", "static-map", f"{cut}@0s-20s"])
    for command in commands:
        refused = gridtrack(*command, *out, code=2).stderr
        own = r"gridtrack: cut\.mcap@validation \(75s-90s\): "
        assert re.fullmatch(own + broken + r" with --validation RECORDING@range\n", refused)
        gridtrack(*command, *out, "--validation", f"{cut}@30s-40s")
    refused = gridtrack("train", "static-map", str(cut), code=2).stderr
    assert re.fullmatch(r"gridtrack: cut\.mcap@train \(0s-75s\): " + broken + r"\n", refused)


def test_debug_shows_the_traceback_of_an_error_and_keeps_its_exit_code():
    assert "Traceback" in gridtrack("--debug", "recording", "info", "nowhere.bag", code=2).stderr


def test_the_help_lists_debug_and_version():
    shown = gridtrack("--help").stdout
    assert "--debug" in shown
    assert "--version" in shown


def test_the_version_is_the_one_of_the_installed_distribution():
    assert gridtrack("--version").stdout == f"gridtrack {metadata.version('gridtrack')}\n"


COMPARE = CompareSettings.model_fields
LIMITS = Limits.model_fields


@pytest.mark.parametrize(
    ("command", "fields"),
    [
        (
            "compare",
            {
                "out": COMPARE["out"],
                "engine": COMPARE["engine"],
                "horizon": COMPARE["horizon_s"],
                "every": COMPARE["every_s"],
                "seed": COMPARE["seed"],
                "threads": LIMITS["threads"],
                "memory": LIMITS["memory_mb"],
                "start-timeout": LIMITS["start_s"],
                "update-timeout": LIMITS["update_s"],
                "predict-timeout": LIMITS["predict_s"],
                "warm-up": COMPARE["warm_up_s"],
                "idle-timeout": COMPARE["idle_timeout_s"],
            },
        ),
        (
            "regress",
            {
                "margin": f"{MARGIN:g} with 20 units or more, 0 with fewer",
                "speed-margin": f"{SPEED_MARGIN:g}, with --speed-base {TURNS_MARGIN:g}",
            },
        ),
        ("train", {"seed": Recipe.model_fields["seed"]}),
    ],
)
def test_the_defaults_in_the_help_are_those_of_the_models_and_the_command_line_has_none_of_its_own(command, fields):
    lines = gridtrack(command, "--help", COLUMNS="240").stdout.splitlines()
    defaults = {found[1]: found[2] for line in lines if (found := re.search(r"--([\w-]+) .*\[default: (.*?)\]", line))}
    flags = {name for name, text in defaults.items() if text == f"no-{name}"}
    assert defaults.keys() - flags == fields.keys()
    for name, field in fields.items():
        shown = defaults[name]
        if isinstance(field, str):
            assert shown == field
            continue
        seconds = shown.removesuffix("s")
        value = type(field.default)(shown) if isinstance(field.default, Path | str) else float(seconds)
        assert value == field.default, name
    own: Any = typer.main.get_command(app)
    assert {parameter.default for parameter in own.commands[command].params} <= {None, False}


def test_the_help_of_degraded_input_names_every_kind():
    shown = gridtrack("compare", "--help", COLUMNS="240").stdout
    assert [field.alias for field in Degradation.model_fields.values() if field.alias not in shown] == []


def test_every_registered_tracker_is_listed():
    rows = json.loads(gridtrack("trackers", "list", "--json").stdout)
    assert [row["name"] for row in rows] == sorted(row["name"] for row in rows)
    built_in = {"blank", "deep-tracking-rnn", "dilated-convgru", "kalman", "persistence", "static-map"}
    assert built_in <= {row["name"] for row in rows}
    assert {row["state"] for row in rows if row["name"] in built_in} == {"ready"}


def test_a_tracker_that_learns_is_listed_with_its_sites_or_as_untrained(tmp_path):
    toml = tmp_path / "trackers.toml"
    toml.write_text(
        f'[elsewhere]\npython = "{sys.executable}"\ntracker = "static-map"\n[broken]\ncommand = "./absent"\n'
    )
    rows = json.loads(gridtrack("trackers", "list", "--json", "--trackers-toml", str(toml)).stdout)
    listed = {row["name"]: (row["state"], row["sites"]) for row in rows}
    assert listed["static-map"] == ("ready", "general, junction, leg_tracker")
    assert listed["persistence"] == ("ready", "")
    assert listed["elsewhere"] == ("untrained", "")
    assert listed["broken"] == ("unavailable", "")


def test_show_lists_the_options_and_their_defaults():
    shown = json.loads(gridtrack("trackers", "show", "static-map", "--json").stdout)
    assert shown["learns"] is True
    assert [option["option"] for option in shown["options"]] == ["prior_frames"]


def test_check_gives_a_verdict_on_each_clause():
    lines = gridtrack("trackers", "check", "persistence").stdout.splitlines()
    assert [line.split()[0] for line in lines[:2]] == ["passed", "passed"]
    assert "not applicable  gives-its-classes        names no classes" in lines
    assert lines[-1] == "persistence keeps the contract: 15 passed, 1 not applicable"


def test_settings_of_a_row_of_a_comparison_are_refused_by_other_commands():
    for command in (["check", "persistence:points=raw"], ["check", "static-map:weights=there"]):
        assert "points= and weights= are for rows of a comparison" in gridtrack("trackers", *command, code=2).stderr


def test_a_tracker_with_learned_weights_for_the_site_is_checked_on_the_recording():
    rows = json.loads(gridtrack("trackers", "check", "static-map", "--recording", DEMO, "--json").stdout)
    assert {row["verdict"] for row in rows} == {"passed", "not applicable"}
    assert list(rows[0]) == ["clause", "verdict", "observed", "mend", "requirement", "reason"]


def test_a_tracker_that_violates_the_contract_is_exit_code_1(bad_trackers):
    lines = gridtrack("trackers", "check", "counts-predictions", code=1).stdout.splitlines()
    (at,) = [number for number, line in enumerate(lines) if line.startswith("failed")]
    assert "predict-keeps-the-state  predicted twice in a row: after frame 1" in lines[at]
    assert "requires: `predict` does not change the state." in lines[at + 1]
    assert "to mend:  Copy the state" in lines[at + 2]
    assert lines[-1].startswith("counts-predictions does not keep the contract: 13 passed, 2 not applicable, 1 failed")


def test_info_lists_the_content_of_a_recording():
    info = json.loads(gridtrack("recording", "info", DEMO, "--json").stdout)
    assert info["info"]["site"] == "leg_tracker"
    assert info["sensors"]["scan"]["scans"] == 1265


def test_an_import_gives_the_content_of_what_it_wrote_as_json(tmp_path):
    written = str(tmp_path / "again.mcap")
    imported = gridtrack("recording", "import", DEMO, "--out", written, "--json").stdout
    assert json.loads(imported) == json.loads(gridtrack("recording", "info", written, "--json").stdout)


def test_a_tracker_is_trained_compared_and_reported(tmp_path):
    weights, run = tmp_path / "weights", tmp_path / "run"
    gridtrack("train", "static-map:prior_frames=3", DEMO, "--out", str(weights))
    done = gridtrack(
        "compare", DEMO, "--tracker", "persistence", "--tracker", "map=static-map:prior_frames=3",
        "--weights", str(weights), "--horizon", "1s", "--out", str(run),
    )  # fmt: skip
    assert "| persistence |" in done.stdout
    assert "map@leg_tracker: ok" in done.stderr
    summary = json.loads((run / "summary.json").read_text())
    assert summary["trackers"]["map"]["options"]["prior_frames"] == 3
    assert (run / "report" / "index.html").exists()
    assert str(run) in gridtrack("report", str(run)).stdout


def test_a_training_whose_weights_cannot_be_written_does_not_start(tmp_path):
    (tmp_path / "file").write_text("not a folder")
    done = gridtrack("train", "kalman", DEMO, "--out", str(tmp_path / "file"), code=2)
    assert f"{tmp_path / 'file' / 'kalman'}: cannot be made (Not a directory); name a folder" in done.stderr
    assert "trial" not in done.stdout


def test_a_trial_that_did_not_complete_is_exit_code_3(tmp_path):
    done = gridtrack(
        "compare", DEMO, "--tracker", "blank", "--tracker", "static-map", "--weights", str(tmp_path),
        "--grid", "60x0.15", "--horizon", "0.5s", "--out", str(tmp_path / "run"), code=3,
    )  # fmt: skip
    assert "static-map@leg_tracker: not-applicable" in done.stderr or "untrained" in done.stderr
    assert "blank@leg_tracker: ok" in done.stderr
