"""The commands of the pages run, block by block, where the files are that a page takes for granted.

A command that would take long runs on less: SMALLER. `make`, `python -m studies...` and `ros2` do nothing here;
test_commands.py checks that targets and modules exist, and tests/studies/test_modules.py runs the modules.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from pathlib import Path

import pytest

from gridtrack.recordings import packaged_recording

from docs import places
from docs.pages import ROOT, name_of, shell_blocks
from docs.test_commands import CURRENT
from studies.support.slurm_machine import missing_programs, slurm_machine

SHELL = """set -euo pipefail
gridtrack() { "$PYTHON" -m gridtrack.cli "$@"; }
pip() { if [ "$*" = "install --editable my-tracker" ]; then install ./my-tracker; fi; }
install() { "$PYTHON" -m pip install --quiet --no-index --no-deps --no-build-isolation --target "$SITE" "$1"; }
make() { :; }
python() { :; }
ros2() { :; }
ray() { :; }
pytest() { :; }
"""
OWN = "gridtrack trackers new my-tracker\npip install --editable my-tracker\n"
BEFORE = {
    "docs/ci.md": OWN,
    "docs/contract.md": OWN,
    "docs/export.md": "gridtrack compare my.bag@0s-12s --tracker persistence --tracker kalman --out runs/hall\n",
    "docs/junction.md": OWN,
    "docs/regress.md": OWN,
    "docs/export.md 2": "gridtrack compare my.bag@0s-12s --tracker persistence --out runs/fleet\n",
    "docs/viewers.md 2": "gridtrack compare my.bag@0s-12s --tracker kalman --out runs/hall\n",
    "examples/example_tracker/README.md": f"install '{ROOT}/examples/example_tracker'\n",
    "examples/cpp_tracker/README.md": f"cp '{ROOT}'/examples/cpp_tracker/[Mf]* . && command make --silent\n",
}
"""What a reader of a page has done before its commands."""

SMALLER = (
    ("train=0s-600s", "train=0s-14s"),
    ("validation=600s-700s --stretch test=700s-", "validation=14s-20s --stretch test=20s-"),
    ("train=0s-75s --stretch validation=75s-90s --stretch test=90s-", "train=0s-20s"),
    ("data/junction/test-*.tracks", "data/junction/test-101.tracks@0s-12s data/junction/test-102.tracks@0s-12s"),
    ("data/junction/train.tracks", "data/junction/validation.tracks@20s-80s"),
    ("data/junction/validation.tracks ", "data/junction/validation.tracks@0s-8s "),
    ("data/junction/validation.tracks@0s-90s", "data/junction/validation.tracks@0s-8s"),
    ("data/junction/validation.tracks@0s-60s", "data/junction/validation.tracks@0s-8s"),
    ("my.bag@60s- --validation my.bag@0s-60s", "my.bag@8s- --validation my.bag@0s-8s"),
    ("train kalman places", "train static-map places"),
    ("devices=4,batch=32", "devices=2,updates=2,channels=2,repetitions=1"),
    ("my.bag --tracker kalman --weights", "my.bag --tracker static-map --weights"),
    ("stage=classes", "stage=classes,labelled_scans=20"),
    ("compare my.mcap --tracker site", "compare my.mcap@114s-124s --validation my.mcap@75s-81s --tracker site"),
    ("my.mcap --tracker persistence --tracker static-map --engine", "my.mcap@90s-102s --tracker blank --engine"),
    ("--engine ray --address head:6379", "--engine ray --address local"),
    ("partition=long,timeout_min=240", "partition=low"),
    ("my.mcap --tracker static-map --engine ray", "my.mcap --tracker blank --engine ray --address local"),
    ("RECORDING...", "my.bag@0s-12s"),
    ("RECORDING", "my.bag@0s-12s"),
    ("weights=DIR", "weights=data/weights"),
    ("FOLDER", "data/weights"),
    ("--minutes 75", "--minutes 0.5"),
    ("--count 400 --minutes 1.5", "--count 1 --minutes 0.2"),
    ("--count 20 --minutes 1", "--count 1 --minutes 0.2"),
    ("--count 10 --minutes 1", "--count 1 --minutes 0.2"),
    ("gridtrack report runs/hall runs/other-day", "cp -r runs/hall runs/other-day; gridtrack report runs/*"),
    ("gridtrack report runs/fleet --recordings 'hall-*,street-7'", "gridtrack report runs/fleet --recordings 'my*'"),
    ("gridtrack regress runs/hall --baseline hall.json", "gridtrack regress runs/hall --baseline hall.json --update"),
    ("gridtrack regress runs/seed-*", 'gridtrack regress "$(ls -d runs/* | head -1)"'),
    ("train my-tracker", "train static-map"),
    ("test-*.mcap --tracker my-tracker", "test-*.mcap --tracker static-map"),
)  # fmt: skip
"""Texts of the pages, and what runs in their place: the same commands on seconds in place of minutes."""

LONG = ("gridtrack simulate drive-set", "gridtrack train --recipe")
"""Commands that take an hour and have nothing to make them shorter."""

Prepare = Callable[[Path], object]


def my_bag(folder: Path) -> None:
    places.hall_bag(folder / "my.bag")


def readme(folder: Path) -> None:
    my_bag(folder)
    places.recorded_drive(folder)


def two_places(folder: Path) -> None:
    my_bag(folder)
    places.hall_recordings(folder, "places/one.mcap", "places/two.mcap", "other_places/hall.mcap")


def bag_and_clone(folder: Path) -> None:
    my_bag(folder)
    places.clone(folder)


def log_and_drive(folder: Path) -> None:
    places.carmen_log(folder / "log.clf")
    places.drive_bag(folder / "drive.bag", places.LASER, poses=places.no_poses)


PLACES: dict[str, Prepare] = {
    "README.md": readme,
    "data/junction/README.md": places.clone,
    "data/leg_tracker/README.md": lambda folder: places.hall_bag(folder / "demo_stationary_simple_environment.bag"),
    "docs/ci.md": lambda folder: places.hall_recordings(folder, "recordings/one.mcap", "recordings/two.mcap"),
    "docs/contract.md": my_bag,
    "docs/export.md": my_bag,
    "docs/export.md 2": my_bag,
    "docs/first-comparison.md": places.clone,
    "docs/follow.md": places.recorded_drive,
    "docs/importing.md": my_bag,
    "docs/importing.md 2": my_bag,
    "docs/importing.md 3": lambda folder: places.drive_bag(
        folder / "drive.bag", places.FRONT, places.REAR, poses=places.odometry
    ),
    "docs/importing.md 4": lambda folder: places.drive_bag(folder / "drive.bag", places.LASER, poses=places.ego_poses),
    "docs/importing.md 5": log_and_drive,
    "docs/importing.md 6": lambda folder: places.hall_bag(folder / "hall.bag"),
    "docs/importing.md 7": lambda folder: places.cloud_bag(folder / "hall.bag"),
    "docs/junction.md": places.clone,
    "docs/junction.md 3": lambda folder: places.annotations(folder / "annotations.txt"),
    "docs/own-tracker.md": places.clone,
    "docs/regress.md": places.clone,
    "docs/regress.md 2": lambda folder: places.hall_recordings(
        folder, "train.mcap", "validation.mcap", "test-1.mcap", "test-2.mcap"
    ),
    "docs/scale.md": lambda folder: shutil.copyfile(packaged_recording("leg_tracker"), folder / "my.mcap"),
    "docs/scale.md 2": lambda folder: shutil.copyfile(packaged_recording("leg_tracker"), folder / "my.mcap"),
    "docs/scale.md 3": lambda folder: shutil.copyfile(packaged_recording("leg_tracker"), folder / "my.mcap"),
    "docs/scale.md 4": two_places,
    "docs/statistics.md": bag_and_clone,
    "docs/trackers/floor.md": places.clone,
    "docs/trackers/model-free.md": places.clone,
    "docs/trackers/one-shot.md": places.clone,
    "docs/viewers.md": my_bag,
    "docs/viewers.md 2": my_bag,
    "docs/weights.md": two_places,
    "docs/weights.md 2": lambda folder: shutil.copyfile(packaged_recording("leg_tracker"), folder / "my.mcap"),
    "docs/weights.md 3": two_places,
    "examples/cpp_tracker/README.md": my_bag,
    "examples/example_tracker/README.md": my_bag,
}
"""What makes the files that the blocks of a page take for granted."""


def named_blocks() -> Iterator[tuple[str, str]]:
    """Every block with its name: the page, and which one of it from the second on."""
    for page in CURRENT:
        for number, block in enumerate(shell_blocks(page), start=1):
            yield f"{name_of(page)} {number}" if number > 1 else name_of(page), block


BLOCKS = dict(named_blocks())


@pytest.mark.parametrize("name", BLOCKS)
def test_the_commands_of_a_page_run(name: str, tmp_path: Path) -> None:
    block = BLOCKS[name]
    if any(command in block for command in LONG):
        pytest.skip("takes an hour")
    if "gridtrack simulate" in block and "gridtrack simulate tracks" not in block:
        pytest.importorskip("sumolib", reason="needs the extra sim")
    if "--engine slurm" in block and missing_programs():
        pytest.skip(f"not installed: {', '.join(missing_programs())}")
    PLACES.get(name, lambda folder: None)(tmp_path)
    with slurm_machine() if "--engine slurm" in block else nullcontext() as configuration:
        run(BEFORE.get(name, "") + block, tmp_path, SLURM_CONF=str(configuration))


def test_every_block_is_run_and_every_replacement_used() -> None:
    text = "\n".join(BLOCKS.values())
    assert [name for name in {*PLACES, *BEFORE} if name not in BLOCKS] == []
    assert [old for old, _ in SMALLER if old not in text] == []
    assert [command for command in LONG if command not in text] == []


def run(block: str, folder: Path, **more: str) -> None:
    """Run a block in `folder` by bash, which ends it at the first command that fails; `more` is of its environment."""
    for old, new in SMALLER:
        block = block.replace(old, new)
    environment = {
        **os.environ,
        "PYTHON": sys.executable,
        "SITE": str(folder / "site"),
        "PYTHONPATH": str(folder / "site"),
        "XDG_DATA_HOME": str(folder / "home"),
        **more,
    }
    done = subprocess.run(
        ["bash", "-c", SHELL + block], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, f"{block}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}"
