"""The command line: results on stdout; an error of the user is one line on stderr and exit code 2."""

import json
import re
import shutil
import signal
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from gridtrack.cli import ENDS, app
from gridtrack.cli.options import settings_options
from gridtrack.common.config import validated
from gridtrack.common.field_docs import field_docs
from gridtrack.common.options import option_fields, option_words
from gridtrack.evaluation.hosting.limits import Limits
from gridtrack.evaluation.regression.settings import MARGIN, SPEED_MARGIN, TURNS_MARGIN
from gridtrack.evaluation.runs.recipe import Recipe
from gridtrack.evaluation.runs.settings import CompareSettings
from gridtrack.evaluation.statistics.jackknife import LEAST_UNITS
from gridtrack.recordings import packaged_recording
from gridtrack.recordings.degradation import Degradation

from scenes.command_line import gridtrack

DEMO = str(packaged_recording("leg_tracker"))
VALIDATION = ("--validation", f"{DEMO}@75s-79s")
"""Shorter than the stretch of its own."""
PACKAGE = str(Path(DEMO).parents[2])
NOT_OF_A_COMPARISON = "points= and weights= are for rows of a comparison"


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("compare", "nowhere.mcap"), "nowhere.mcap: no such recording"),
        (("compare", DEMO, "--tracker", "kalmann"), "there is no tracker 'kalmann'; did you mean 'kalman'?"),
        (("compare", DEMO, "--tracker", "static-map:prior_frame=1"), "did you mean 'prior_frames'?"),
        (("compare", DEMO, "--tracker", "static-map:prior_frames=1e999"), "'prior_frames'"),
        (("compare", DEMO, "--score", "mine"), "--score: no score 'mine' is installed"),
        (("compare", DEMO, "--format", "mine"), "no recording format 'mine'; known: carmen"),
        (("train", "static-map:points=raw", DEMO), NOT_OF_A_COMPARISON),
        (("regress", "run", "--baseline", "b.json", "--update", "--json"), "--json: --update judges nothing"),
        (("regress", "run", "--baseline", "b.json", "--margin", "2"), "--margin 2.0: it should be less than 1"),
        (("recording", "info", "no\x1b[31m\nwhere.bag"), "no [31m where.bag: no such recording"),
        (("recording", "info", DEMO, "--no-return", "no"), "--no-return no: it should be 'max', 'zero' or 'nan'"),
        (("compare", DEMO, "--out", "runs/hall\udce9"), r"runs/hall\xe9: this path is not UTF-8"),
        (("compare", DEMO, "--horizon", "soon"), "--horizon 'soon': expected seconds, such as 2.5s"),
        (("compare", DEMO, "--grid", "100"), "grid '100': expected CELLSxMETRES"),
        (("compare", DEMO, "--every", "0"), "--every 0: it should be greater than 0"),
        (("compare", DEMO, "--engine", "cloud"), "--engine cloud: it should be 'local', 'ray' or 'slurm'"),
        (("compare", DEMO, "--trackers", "kalman"), "No such option: --trackers (Possible options: "),
        (("compare",), "Missing argument 'RECORDING[@RANGE]' (see `gridtrack compare --help`)"),
        (("compare", DEMO, "--seed", "x"), "Invalid value for '--seed': Input should be a valid integer"),
        (("regres", "run"), "No such command 'regres'. Did you mean 'regress'? (see `gridtrack --help`)"),
        (("train", DEMO), "name the tracker before the recordings: gridtrack train NAME "),
        (("trackers", "check", "kalman", "--weights", PACKAGE), f"{PACKAGE}: has no weights of kalman"),
        (("train", "persistence", DEMO), "tracker 'persistence' has nothing to learn"),
        (("trackers", "check", "static-map:card=site"), "'static-map' needs weights, and there are none here: name a"),
        (("trackers", "check", "persistence:points=raw"), NOT_OF_A_COMPARISON),
        (("trackers", "new", "My Tracker"), "'My Tracker' is not a valid name of a tracker package: use a-z, 0-9 and"),
        (("trackers", "show", "blnk"), "did you mean 'blank'?"),
        (("recording", "import", DEMO, "--out", "demo.bag"), "demo.bag: a recording is written as .mcap"),
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


def test_debug_shows_the_traceback_of_an_error_and_keeps_its_exit_code():
    command = [sys.executable, "-m", "gridtrack.cli", "--debug", "recording", "info", "nowhere.bag"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr.count("Traceback")) == (2, 1)


@pytest.mark.parametrize("number", ENDS)
def test_a_signal_that_ends_a_job_or_a_session_has_the_effect_of_ctrl_c(number, monkeypatch):
    found = []
    monkeypatch.setattr("gridtrack.cli.app", lambda *_, **how: found.append(signal.getsignal(number)))
    before = signal.signal(number, signal.SIG_DFL)  # one that the shell ignores stays ignored
    try:
        gridtrack("--version")
    finally:
        signal.signal(number, before)
    assert found == [signal.default_int_handler]


def test_a_broken_library_has_another_exit_code_than_a_worse_tracker(tmp_path):
    (tmp_path / "pyarrow.py").write_text("raise AttributeError('built for another numpy')")
    command = f"import sys; sys.path.insert(0, {str(tmp_path)!r}); from gridtrack.cli import main; main()"
    given = [sys.executable, "-c", command, "regress", "runs/now", "--baseline", "baseline.json"]
    done = subprocess.run(given, capture_output=True, text=True, check=False)
    assert (done.returncode, "built for another numpy" in done.stderr) == (3, True)


@pytest.mark.usefixtures("trackers_here")
def test_the_undamaged_part_of_a_truncated_recording_can_be_used(tmp_path):
    cut, out = tmp_path / "cut.mcap", ("--out", tmp_path / "out")
    content = Path(DEMO).read_bytes()
    cut.write_bytes(content[: len(content) // 2])
    broken = r"the recording is 63\.6 s long \(cut off in the middle of a record\): name a range .* \(.*@0s-63s\)"
    compare = ["compare", "--no-floors", f"{cut}@0s-8s", "--tracker", "persistence", "--every", "0.5s"]
    commands = (compare, ["train", "static-map", f"{cut}@0s-8s"])
    for command in commands:
        refused = gridtrack(*command, *out, code=2).stderr
        own = r"gridtrack: cut\.mcap@validation \(75s-90s\): "
        assert re.fullmatch(own + broken + r" with --validation RECORDING@range\n", refused)
        gridtrack(*command, *out, "--validation", f"{cut}@30s-36s")
    refused = gridtrack("train", "static-map", cut, code=2).stderr
    assert re.fullmatch(r"gridtrack: cut\.mcap@train \(0s-75s\): " + broken + r"\n", refused)


def test_the_version_is_the_one_of_the_installed_distribution():
    assert gridtrack("--version").stdout == f"gridtrack {metadata.version('gridtrack')}\n"


def commands(command=None, words=()):
    """Every command and group: its words and typer's object."""
    command = command or typer.main.get_command(app)
    yield words, command
    for name, one in getattr(command, "commands", {}).items():
        yield from commands(one.load() if hasattr(one, "load") else one, (*words, name))


COMMANDS = dict(commands())


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_the_help_of_a_command_cuts_nothing_at_80_columns(words, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    shown = gridtrack(*words, "--help").stdout
    assert "…" not in shown
    metavars = {word for parameter in COMMANDS[words].params for word in (parameter.metavar or "").split(" ")}
    assert [metavar for metavar in metavars if metavar not in shown] == []


def test_the_help_of_all_commands_has_the_help_of_each():
    lazy = typer.main.get_command(app)
    for (name, *_), command in [(words, one) for words, one in COMMANDS.items() if len(words) == 1]:
        assert command.help.split("\n\n")[0] == lazy.commands[name].help
    assert {"--debug", "--version"} <= set(re.findall(r"--\w+", gridtrack("--help").stdout))


@pytest.mark.parametrize(("command", "model"), [("compare", CompareSettings), ("train", Recipe)])
def test_the_defaults_in_the_help_come_from_the_settings_and_the_command_has_none_of_its_own(
    command, model, monkeypatch
):
    monkeypatch.setenv("COLUMNS", "240")
    lines = gridtrack(command, "--help").stdout.splitlines()
    shown = {found[1]: found[2] for line in lines if (found := re.search(r"--([\w-]+) .*\[default: (.*?)\]", line))}
    fields = {option.name: option.field for option in option_fields(model) if not option.own.argument}
    options = {name: field.get_default(call_default_factory=True) for name, field in fields.items()}
    own = {name for name, default in options.items() if default not in (None, (), {}, "") and default is not False}
    assert shown.keys() == own
    for name, text in shown.items():
        default = options[name]
        assert default == (type(default)(text) if isinstance(default, Path | str) else float(text.removesuffix("s")))
    assert {parameter.default for parameter in COMMANDS[command,].params} <= {None, False}


def test_the_help_of_the_gate_names_its_default_margins(monkeypatch):
    monkeypatch.setenv("COLUMNS", "300")
    shown = gridtrack("regress", "--help").stdout
    assert f"default: {MARGIN:g} with {LEAST_UNITS} units or more, 0 with fewer" in shown
    assert f"default: {SPEED_MARGIN:g} for a ratio to the reference, {TURNS_MARGIN:g} for a time measured" in shown


@pytest.mark.parametrize(
    "values",
    [
        {"recordings": ["a.mcap@3s-9s", "b.bag"], "trackers": ["x=kalman:association=jcbb"], "out": Path("runs/a b")},
        {"recordings": ["a"], "every_s": 0.25, "segment_s": "30s", "rate_hz": 12.5, "seed": 0, "resume": True},
        {"recordings": ["a"], "limits": {"threads": 2, "start_s": 3.5, "sandbox": True}, "grid": "100x0.2@-1,-4"},
        {"recordings": ["a"], "limits": Limits(memory_mb=300), "degrade": Degradation(beam_dropout=0.2)},
        {"recordings": ["a"], "slurm": {"partition": "long", "mem_gb": 7.5}, "scores": ["1", "2"], "format": "mine"},
    ],
)
def test_the_words_of_settings_give_the_same_settings_again(values):
    given = []
    one = typer.Typer()

    @one.command()
    @settings_options(CompareSettings)
    def command(values):
        given.append(values)

    CliRunner().invoke(one, option_words(CompareSettings, values), catch_exceptions=False)
    assert validated(CompareSettings, given[0], "") == validated(CompareSettings, values, "")


def test_the_help_of_degraded_input_names_every_kind():
    described = field_docs(CompareSettings)["degrade"]
    assert [field.alias for field in Degradation.model_fields.values() if field.alias not in described] == []


@pytest.mark.usefixtures("trackers_here")
def test_every_registered_tracker_is_listed_with_its_sites_or_as_untrained(tmp_path):
    toml = tmp_path / "trackers.toml"
    toml.write_text(
        f'[elsewhere]\npython = "{sys.executable}"\ntracker = "static-map"\n[broken]\ncommand = "./absent"\n'
    )
    rows = json.loads(gridtrack("trackers", "list", "--json", "--trackers-toml", toml).stdout)
    listed = {row["name"]: (row["state"], row["sites"]) for row in rows}
    assert list(listed) == [*sorted(listed.keys() - {"elsewhere", "broken"}), "elsewhere", "broken"]
    built_in = {"blank", "deep-tracking-rnn", "dilated-convgru", "kalman", "persistence", "static-map"}
    assert {listed[name][0] for name in built_in} == {"ready"}
    assert listed["static-map"][1] == "general, junction, leg_tracker"
    assert listed["persistence"][1] == ""
    assert (listed["elsewhere"], listed["broken"]) == (("untrained", ""), ("unavailable", ""))


@pytest.mark.usefixtures("trackers_here")
def test_show_lists_the_options_and_their_defaults():
    shown = json.loads(gridtrack("trackers", "show", "static-map", "--json").stdout)
    assert shown["learns"] is True
    assert [option["option"] for option in shown["options"]] == ["prior_frames"]


@pytest.mark.usefixtures("trackers_here")
def test_a_tracker_with_learned_weights_for_the_site_is_checked_on_the_recording():
    rows = json.loads(gridtrack("trackers", "check", "static-map", "--recording", DEMO, "--json").stdout)
    assert {row["verdict"] for row in rows} == {"passed", "not applicable"}
    assert list(rows[0]) == ["clause", "verdict", "observed", "mend", "requirement", "reason"]


@pytest.mark.usefixtures("trackers_here")
def test_a_check_with_weights_alone_has_the_stream_of_their_card(tmp_path):
    folder = tmp_path / "static-map"
    folder.mkdir()
    for file in (Path(PACKAGE) / "data/weights/static-map").glob("leg_tracker.*"):
        shutil.copy(file, folder)
    rows = json.loads(gridtrack("trackers", "check", "static-map", "--weights", tmp_path, "--json").stdout)
    assert {row["verdict"] for row in rows} == {"passed", "not applicable"}
    shutil.copy(folder / "leg_tracker.toml", folder / "elsewhere.toml")
    refused = gridtrack("trackers", "check", "static-map", "--weights", tmp_path, code=2).stderr
    assert "has weights of static-map for several sites, elsewhere, leg_tracker: name a recording of one" in refused


@pytest.mark.usefixtures("trackers_here")
def test_a_check_gives_a_verdict_on_each_clause_and_exit_code_1_for_a_violation(bad_trackers):
    lines = gridtrack("trackers", "check", "counts-predictions", code=1).stdout.splitlines()
    assert [line.split()[0] for line in lines[:2]] == ["passed", "passed"]
    assert "not applicable  gives-its-classes        names no classes" in lines
    (at,) = [number for number, line in enumerate(lines) if line.startswith("failed")]
    assert "predict-keeps-the-state  predicted twice in a row: after frame 1" in lines[at]
    assert "requires: `predict` does not change the state." in lines[at + 1]
    assert "to mend:  Copy the state" in lines[at + 2]
    assert lines[-1].startswith("counts-predictions does not keep the contract: 13 passed, 2 not applicable, 1 failed")


def test_an_import_prints_the_content_of_its_file_as_json(tmp_path):
    imported = gridtrack("recording", "import", DEMO, "--out", tmp_path / "again.mcap", "--json").stdout
    info = json.loads(gridtrack("recording", "info", tmp_path / "again.mcap", "--json").stdout)
    assert json.loads(imported) == info
    assert info["info"]["site"] == "leg_tracker"
    assert info["sensors"]["scan"]["scans"] == 1265


@pytest.mark.usefixtures("trackers_here")
def test_a_training_without_a_writable_place_for_weights_does_not_start(tmp_path):
    (tmp_path / "file").write_text("not a folder")
    done = gridtrack("train", "kalman", DEMO, "--out", tmp_path / "file", code=2)
    assert f"{tmp_path / 'file' / 'kalman'}: cannot be made (Not a directory); name a folder" in done.stderr
    assert "trial" not in done.stdout


@pytest.mark.usefixtures("trackers_here")
def test_a_trial_that_did_not_complete_is_exit_code_3(tmp_path):
    done = gridtrack(
        "compare", "--no-floors", f"{DEMO}@114s-118s", "--tracker", "blank", "--tracker", "static-map:card=site",
        "--grid", "60x0.15", "--horizon", "0.5s", *VALIDATION, "--out", tmp_path / "run", code=3,
    )  # fmt: skip
    assert re.search("static-map@leg_tracker@114s-118s: (not-applicable|untrained)", done.stderr)
    assert "blank@leg_tracker@114s-118s: ok" in done.stderr
    assert "| blank |" in done.stdout
    assert (tmp_path / "run" / "report" / "index.html").exists()
