"""The commands of the pages run in this process: a theme is a folder, and the blocks of pages that share its files.

Equal commands of a theme run once, and long ones on less: SMALLER. `make`, `python -m studies...` and `ros2` do nothing
here; test_commands.py checks that targets and modules exist, and tests/studies runs the modules. The engines Ray and
Slurm are tested in tests/evaluation/engines. docs/ci.md has a test of its own.
"""

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from gridtrack.cli import app

from docs import places
from docs.pages import name_of, shell_blocks
from docs.test_commands import CURRENT
from scenes.programs_here import programs_here

THEMES = {
    "hall": (
        *("README.md", "docs/export.md", "docs/export.md 2", "docs/importing.md", "docs/importing.md 2"),
        *("docs/scale.md", "docs/scale.md 2", "docs/scale.md 3", "docs/weights.md 2", "docs/statistics.md"),
        *("docs/viewers.md", "docs/viewers.md 2", "docs/follow.md", "docs/recorded.md"),
    ),
    "formats": (
        *(f"docs/importing.md {number}" for number in range(3, 8)),
        *("docs/junction.md 3", "data/leg_tracker/README.md"),
    ),
    "own tracker": (
        *(
            "docs/own-tracker.md",
            "docs/own-tracker.md 2",
            "docs/first-comparison.md",
            "docs/contract.md",
            "docs/junction.md",
        ),
        *("data/junction/README.md", "docs/regress.md", "docs/regress.md 2", "docs/suites.md"),
        *("examples/example_tracker/README.md", "examples/cpp_tracker/README.md"),
    ),
    "training": (
        *("docs/weights.md", "docs/weights.md 3", "docs/scale.md 4", "docs/trackers/floor.md"),
        "docs/trackers/pool.md",
        *("docs/trackers/model-free.md", "docs/trackers/one-shot.md", "docs/onnx.md"),
    ),
    "outputs": ("docs/recorded-bags.md", "docs/recorded-bags.md 2"),
    "simulation": (
        *("docs/junction.md 2", "docs/drives.md", "data/drives/README.md"),
        *("docs/worlds.md", "docs/worlds.md 2", "data/worlds/README.md"),
    ),
}
"""The blocks of each theme, in order: the page, and the number of the block on it from the second on."""

SMALLER = (
    ("train=0s-600s", "train=0s-14s"),
    ("validation=600s-700s --stretch test=700s-", "validation=14s-20s --stretch test=20s-"),
    ("train=0s-75s --stretch validation=75s-90s --stretch test=90s-", "train=0s-20s"),
    ("data/junction/validation.tracks@0s-90s", "data/junction/validation.tracks"),
    ("data/junction/validation.tracks@0s-60s", "data/junction/validation.tracks"),
    ("compare my.bag ", "compare my.bag@0s-9s "),
    ("--validation 0s-60s --out tracks.npz", "--validation 0s-1s --out tracks.npz"),
    ("my.bag@60s- --validation my.bag@0s-60s", "my.bag@20s- --validation my.bag@0s-8s"),
    ("RECORDING...", "my.bag@0s-9s"),
    ("RECORDING", "my.bag@0s-9s"),
    ("train kalman my.mcap", "train static-map my.mcap"),
    ("train kalman places", "train static-map places"),
    ("site=kalman:card=site --tracker general=kalman:", "site=static-map:card=site --tracker general=static-map:"),
    ("train dilated-convgru:devices=4,batch=32", "train static-map"),
    ("--tracker kalman --weights", "--tracker static-map --weights"),
    ("--tracker kalman --deadline", "--tracker blank --deadline"),
    ("drive_0.mcap --tracker kalman", "drive_0.mcap --tracker persistence --tracker kalman"),
    ("dilated-convgru:stage=classes,class_layers=1", "kalman:stage=classes"),
    ("stage=classes", "stage=classes,labelled_scans=20"),
    ("linear=dilated-convgru:weights=FOLDER --tracker dilated-convgru", "linear=kalman:weights=FOLDER"),
    ("--tracker persistence --tracker static-map --engine", "--tracker blank --engine"),
    ("--tracker static-map --engine", "--tracker blank --engine"),
    ("--engine ray --address head:6379", "--engine local"),
    ("--engine slurm --slurm partition=long,timeout_min=240", "--engine local"),
    ("--engine ray", "--engine local"),
    ("my.mcap --tracker persistence --tracker static-map --segment 20s", "my.bag --tracker blank --segment 10s"),
    ("export dilated-convgru --grid 100x0.2 ", "export kalman --grid 20x0.2 "),
    ("weights=DIR", "weights=data/weights"),
    ("FOLDER", "data/weights"),
    ("--minutes 75", "--minutes 0.2 --start 30s"),
    ("junction --minutes 1", "junction --minutes 0.2 --start 30s"),
    ("--count 400 --minutes 1.5", "--count 1 --minutes 0.2"),
    ("--count 20 --minutes 1", "--count 1 --minutes 0.2"),
    ("--count 10 --minutes 1", "--count 1 --minutes 0.2"),
    ("runs/hall runs/other-day", "runs/hall runs/cluster"),
    ("runs/fleet --recordings 'hall-*,street-7'", "runs/hall --recordings 'my*'"),
    ("regress runs/seed-*", "regress runs/now"),
    ("train my-tracker", "train static-map"),
    ("pool:members=[kalman,my-tracker]", "pool:members=[static-map,blank]"),
    ("suite run worlds-1 ", "suite run hall-1 "),
    ("--suite worlds-1 ", "--suite hall-1 "),
    ("suite page worlds-1 ", "suite page hall-1 "),
    (
        "train my-network data/leg_tracker/leg_tracker.mcap",
        "train my-network:updates=2,channels=2 data/leg_tracker/leg_tracker.mcap@0s-10s"
        " --validation data/leg_tracker/leg_tracker.mcap@75s-79s",
    ),
    (
        "data/leg_tracker/leg_tracker.mcap@114s-124s",
        "data/leg_tracker/leg_tracker.mcap@114s-120s --validation data/leg_tracker/leg_tracker.mcap@75s-79s",
    ),
    ("test-*.mcap --tracker my-tracker", "test-*.mcap --tracker static-map"),
    ("drive.bag --out drive.mcap --pose-topic", "poses.bag --out drive.mcap --pose-topic"),
    ("compare drive.bag --ego-motion", "compare no-poses.bag --ego-motion"),
    ("drive.bag --out drive.mcap --ego-motion", "no-poses.bag --out drive.mcap --ego-motion"),
    ("hall.bag --out hall.mcap --topic", "clouds.bag --out hall.mcap --topic"),
    ("gridtrack compare ", "gridtrack compare --no-floors --horizon 1s --every 1s "),
)  # fmt: skip
"""Texts of the pages and their replacements: the same commands on seconds, each on a file of its own."""

LONG = ("gridtrack simulate drive-set",)
"""Commands that take an hour and cannot be made shorter."""


def named_blocks():
    """Every block with its name."""
    for page in CURRENT:
        for number, block in enumerate(shell_blocks(page), start=1):
            yield f"{name_of(page)} {number}" if number > 1 else name_of(page), block


BLOCKS = dict(named_blocks())


def commands_of(theme):
    """The commands of a theme in order, each once: the command -> the block that has it first."""
    found = {}
    for name in THEMES[theme]:
        for line in BLOCKS[name].replace("\\\n", " ").splitlines():
            command = " ".join(re.split(r"\s+#\s", line)[0].split()) + " "
            for old, new in SMALLER:
                command = command.replace(old, new)
            if command.strip() and not command.startswith(LONG):
                found.setdefault(command.strip(), name)
    return found


@pytest.mark.parametrize("theme", THEMES)
def test_the_commands_of_the_pages_run(theme, tmp_path, monkeypatch):
    if theme == "simulation":
        pytest.importorskip("sumolib", reason="needs the extra sim")
    site = tmp_path / "site"
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(site))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, (str(site), os.environ.get("PYTHONPATH")))))
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "home"))
    places.PLACES[theme](tmp_path)
    with programs_here():
        for command, name in commands_of(theme).items():
            run(command, f"{name}: {command}")


def test_every_block_is_run_and_every_replacement_used():
    blocks = [name for theme in THEMES.values() for name in theme]
    assert sorted([*blocks, "docs/ci.md"]) == sorted(BLOCKS)
    text = "\n".join(f"{BLOCKS[name]} " for name in blocks).replace("\\\n", " ")
    text = re.sub(r" +", " ", re.sub(r"\s+#\s.*", " ", text))
    for old, new in SMALLER:
        assert old in text, old
        text = text.replace(old, new)
    assert [command for command in LONG if command not in text] == []


def run(command, where):
    """Run a command in the working folder. Raises AssertionError with its output where it fails."""
    command, _, to = command.partition(" > ")
    program, *words = (found for typed in shlex.split(command, posix=False) for found in expanded(typed))
    if program == "gridtrack":
        output = gridtrack(words, where)
        if to:
            Path(to).write_text(output)
    elif command.startswith("pip install --editable my-"):
        pip_install(f"./{words[-1]}")
    elif program == "printf":
        Path(to).write_text(words[0].replace("\\n", "\n"))


def expanded(typed):
    """A word as a shell passes it on: without its quotes, else the files that it names."""
    (word,) = shlex.split(typed)
    return sorted(map(str, Path().glob(word))) or [word] if "*" in word and word == typed else [word]


def gridtrack(words, where):
    """The output of a gridtrack command that ends well, with its trackers and trainings in this process."""
    if words[0] in ("compare", "recording"):
        remove(Path(words[words.index("--out") + 1] if "--out" in words else "runs/latest"))  # of an earlier page
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0, f"{where}\n{result.output[-2000:]}\n{result.exception!r}"
    return result.stdout


def remove(path):
    if path.is_dir():
        shutil.rmtree(path)
    path.unlink(missing_ok=True)


def pip_install(package):
    """Install a package into the folder `site`, which is on the path."""
    options = ("--quiet", "--no-index", "--no-deps", "--no-build-isolation", "--target", "site")
    subprocess.run([sys.executable, "-m", "pip", "install", *options, package], check=True)
