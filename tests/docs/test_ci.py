"""The workflows of docs/ci.md run as they stand: each line by the shell of its service, the gridtrack in it here."""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml

from docs.pages import ROOT, blocks, commands
from scenes.room import write_room

PAGE = ROOT / "docs/ci.md"
(TRACKER,) = blocks(ROOT / "README.md", "python")
UPDATE = "np.copyto(self.last, frame.occupied, where=frame.visible)"
"""The line of TRACKER that takes in a frame."""


def steps(number):
    """The shell lines of a YAML block for GitHub: the workflow, or the steps that time in turns."""
    found = yaml.safe_load(blocks(PAGE, "yaml")[number])
    if isinstance(found, dict):
        found = found["jobs"]["regression"]["steps"]
    return [(step["run"], "if" in step) for step in found if "run" in step]


@pytest.fixture
def repository(tmp_path, install, monkeypatch):
    """A repository with a recording and the tracker `my-tracker`; `pip` installs nothing there: it is installed."""
    install("my-tracker", {"my-tracker": "mine:MyTracker"}, {"mine.py": TRACKER})
    folder = tmp_path / "repository"
    (folder / "recordings").mkdir(parents=True)
    write_room(folder / "recordings/one.mcap", 8, stretches={}, grid="20x0.4@-1,-4")
    programs = tmp_path / "bin"
    programs.mkdir()
    write_program(programs / "pip", 'test "$*" = "install ."')
    write_program(programs / "gridtrack", 'printf "%s\\0" "$@" > ../words')
    monkeypatch.setenv("PATH", f"{programs}:{os.environ['PATH']}")
    monkeypatch.setenv("GITHUB_STEP_SUMMARY", str(folder / "summary.md"))
    monkeypatch.chdir(folder)
    return folder


def write_program(path, line):
    path.write_text(f"#!/bin/sh\n{line}\n")
    path.chmod(0o755)


def run_lines(gridtrack, lines):
    """The exit code of the first line that fails; after it only the lines run that always do."""
    words, code = Path("../words"), 0
    for line, always in lines:
        if always or not code:
            words.unlink(missing_ok=True)
            done = subprocess.run(["bash", "-e", "-c", line], check=False).returncode
            if words.exists():  # of the gridtrack in the line
                command, *typed = words.read_text().split("\0")[:-1]
                done = gridtrack(command, *(["--no-floors"] if command == "compare" else []), *typed).code
            code = code or done
    return code


def gitlab():
    """The shell lines for GitLab, which one shell runs."""
    script = yaml.safe_load(blocks(PAGE, "yaml")[2])["regression"]["script"]
    return script


def test_both_services_run_the_same_lines():
    lines = [line.removesuffix(" || compared=$?") for line in gitlab()]
    assert lines == [*(line for line, _ in steps(0)[:3]), "exit ${compared:-0}"]


@pytest.mark.parametrize(("compared", "judged", "code"), [(0, 0, 0), (3, 3, 3), (3, 0, 3), (0, 1, 1)])
def test_gitlab_judges_a_run_that_crashed_and_the_job_fails(repository, compared, judged, code):
    write_program(
        repository.parent / "bin/gridtrack", f"echo $1 >> said; test $1 = compare && exit {compared}; exit {judged}"
    )
    assert subprocess.run(["bash", "-e", "-c", "\n".join(gitlab())], check=False).returncode == code
    assert (repository / "said").read_text().split() == ["compare", "regress"]


@pytest.mark.usefixtures("trackers_here")
def test_a_job_passes_with_its_baseline_times_in_turns_and_fails_once_the_tracker_is_broken(repository, gridtrack):
    made = [(line, False) for line in commands(PAGE)]
    assert (len(made), run_lines(gridtrack, made)) == (2, 0)
    shutil.rmtree(repository / "runs")
    assert run_lines(gridtrack, steps(0)) == 0
    assert ElementTree.parse(repository / "junit.xml").getroot().get("failures") == "0"
    assert (repository / "regress.md").read_text().startswith("## gridtrack regress: no worse")
    assert (repository / "runs/now/report/index.html").is_file()

    offer_base(repository)
    code = run_lines(gridtrack, steps(1))
    timed = (repository / "regress.md").read_text()
    assert "| my-tracker | update | base |" in timed
    assert code == int("| worse | my-tracker |" in timed)  # by chance: the machine of a test may be busy

    shutil.rmtree(repository / "runs")
    (repository.parent / "site/mine.py").write_text(TRACKER.replace(UPDATE, "pass"))
    assert run_lines(gridtrack, steps(0)) == 1
    assert int(ElementTree.parse(repository / "junit.xml").getroot().get("failures", "0")) > 0
    assert "## gridtrack regress: worse" in (repository / "summary.md").read_text()

    shutil.rmtree(repository / "runs")
    (repository.parent / "site/mine.py").write_text(TRACKER.replace(UPDATE, "1 / 0"))
    assert run_lines(gridtrack, steps(0)) == 3
    (case,) = ElementTree.parse(repository / "junit.xml").iterfind("testcase/error")
    assert "my-tracker@one: crashed: update with frame 1: ZeroDivisionError" in case.get("message", "")
    assert "## gridtrack regress: not measured" in (repository / "summary.md").read_text()


def offer_base(repository):
    """`base.toml`, and programs with which `python -m venv base-env` makes an environment that has everything."""
    (repository / "base.toml").write_text(blocks(PAGE, "toml")[0])
    programs = repository.parent / "bin"
    write_program(programs / "base-python", f'exec "{sys.executable}" "$@"')
    write_program(programs / "base-pip", 'test "$*" = "install ./base"')
    copies = " && ".join(f"cp ../bin/base-{name} base-env/bin/{name}" for name in ("python", "pip"))
    write_program(programs / "python", f'test "$*" = "-m venv base-env" && mkdir -p base-env/bin && {copies}')
