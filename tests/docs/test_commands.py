"""Commands, tracker options and files that the pages name exist."""

import re
import shlex
import subprocess
import tomllib
from functools import cache
from itertools import pairwise

import pytest
import typer

from gridtrack.cli import LazyCommand, app
from gridtrack.common.config import validated
from gridtrack.common.errors import ConfigurationError
from gridtrack.evaluation.engines.slurm_cluster import parse_slurm
from gridtrack.evaluation.runs.settings import CompareSettings
from gridtrack.trackers import registry
from gridtrack.trackers.selection import parse_selection

from docs.pages import PAGES, ROOT, commands, name_of, prose

MODULES = ("gridtrack.trackers.serve", "pip", "build", "venv")
HISTORY = ("CHANGELOG.md", "docs/notebook/")
PAST = [page for page in PAGES if name_of(page).startswith(HISTORY)]
CURRENT = [page for page in PAGES if page not in PAST]
FOLDERS = (
    r"(?:common|recordings|simulation|trackers|evaluation|reports|cli|tests|benchmarks|studies|examples|docs|data)"
)
ENTRY_POINTS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["entry-points"]
BUILT_IN = ENTRY_POINTS["gridtrack.trackers"] | ENTRY_POINTS["gridtrack.floors"]
PACKAGES = ("common", "recordings", "simulation", "trackers", "evaluation", "reports", "cli")
FILE = re.compile(rf"`({FOLDERS}/[\w./-]+\.(?:py|md|toml|json|tracks|mcap|xml|svg))`")


def targets():
    return set(re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text("utf-8"), re.MULTILINE))


def problem_of(line):
    """The fault of a command line, or ""."""
    program, *words = shlex.split(line)
    if program == "make":
        return "" if not words or words[0] in targets() else f"{line}: no such target"
    if program == "python":
        if words[0] == "-m" and words[1] in MODULES:
            return ""
        script = words[1].replace(".", "/") + ".py" if words[0] == "-m" else words[0]
        return "" if (ROOT / script).is_file() else f"{line}: no such module or script"
    return next(wrong_words(line, words), "")


@cache
def whole_command():
    """The command `gridtrack` with its sub-commands and their options."""
    return typer.main.get_command(app)


def wrong_words(line, words):
    command = whole_command()
    rest = list(words)
    while rest and not rest[0].startswith("-") and (commands_of := getattr(command, "commands", None)) is not None:
        name = rest.pop(0)
        if name not in commands_of:
            yield f"{line}: no such command '{name}'"
            return
        command = commands_of[name]
        command = command.load() if isinstance(command, LazyCommand) else command
    known = {option for parameter in command.params for option in parameter.opts} | {"--debug", "--help"}
    for word in rest:
        if word.startswith("--") and word.partition("=")[0] not in known:
            yield f"{line}: no such option {word}"
    named = [("--tracker", word) for word in rest[:1] if words[0] == "train" and not word.startswith("-")]
    for option, value in [*pairwise(rest), *named]:
        try:
            VALUES.get(option, str)(value)
        except ConfigurationError as error:
            yield f"{line}: {error}"


def known_tracker(text):
    """Check the options in `NAME:key=value,...` of a built-in tracker; `key=value,...` stands for any."""
    selection = parse_selection(text.replace(",...", ""))
    if selection.name in registry.entries():
        options = {key: value for key, value in selection.options.items() if key != "key"}
        validated(registry.load(selection.name).Options, options, selection.name)


def known_engine(text):
    validated(CompareSettings, {"recordings": ("a",), "engine": text}, "--engine")


VALUES = {"--tracker": known_tracker, "--engine": known_engine, "--slurm": parse_slurm}
"""Options with values that are checked; a wrong value raises ConfigurationError."""


def test_the_commands_of_the_pages_exist():
    lines = {line: page for page in CURRENT for line in commands(page)}
    assert [f"{name_of(page)}: {problem}" for line, page in lines.items() if (problem := problem_of(line))] == []


def test_the_files_that_the_pages_name_exist():
    modules = {path.name for package in PACKAGES for path in (ROOT / package).rglob("*.py")}
    for page in CURRENT:
        text = prose(page)
        missing = [file for file in FILE.findall(text) if not (ROOT / file).exists()]
        missing += [name for name in re.findall(r"`(\w+\.py)`", text) if name not in modules]
        assert missing == [], name_of(page)


def test_the_options_that_a_page_on_a_tracker_sets_exist():
    known = {"points", "weights"}.union(*(registry.load(name).Options.model_fields for name in BUILT_IN))
    pages = [page for page in CURRENT if page.parent.name == "trackers"]
    assert {key for page in pages for key in re.findall(r"`(\w+)=[^`]+`", prose(page))} - known == set()


@pytest.mark.parametrize(
    ("line", "problem"),
    [
        ("make absent", "no such target"),
        ("python -m benchmarks.absent 1", "no such module or script"),
        ("gridtrack absent", "no such command 'absent'"),
        ("gridtrack compare a.mcap --absent 1", "no such option --absent"),
        ("gridtrack compare a.mcap --tracker x=kalman:absent=1", "kalman: there is no option 'absent'"),
        ("gridtrack compare a.mcap --engine absent", "--engine: 'engine' = 'absent': Input should be"),
        ("gridtrack compare a.mcap --slurm absent=1", "--slurm: there is no option 'absent'"),
        ("gridtrack train kalman:association=absent a.mcap", "kalman: 'association' = 'absent': Input should be"),
    ],
)
def test_a_wrong_command_is_found(line, problem):
    assert problem_of(line).startswith(f"{line}: {problem}")


@pytest.mark.parametrize(("words", "index"), [([], False), (["TORCH_CPU=1"], True)])
def test_make_installs_the_requested_pytorch(words, index, tmp_path):
    printed = ["make", "--dry-run", "demo", f"VENV={tmp_path}", *words]
    said = subprocess.run(printed, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    (install,) = [line for line in said.splitlines() if "/bin/pip install" in line]
    assert ("--extra-index-url https://download.pytorch.org/whl/cpu" in install) == index
