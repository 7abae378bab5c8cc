"""The package of `trackers new NAME --learned`: it trains, resumes, is compared, and ends in the gate."""

from __future__ import annotations

import importlib
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gridtrack import FitTask, Tracker, load_weights, open_stream
from gridtrack.cli.trackers import new_tracker
from gridtrack.common.config import validated
from gridtrack.common.errors import ConfigurationError
from gridtrack.evaluation.hosting.contract_suite import check_tracker
from gridtrack.trackers.contract import StretchScore, stream_of
from gridtrack.trackers.selection import launch
from gridtrack.trackers.training.weights import read_card

from scenes.room import write_room

pytest.importorskip("torch", reason="needs the extra deep")

TINY = {"updates": 3, "validate_every": 1, "batch": 2, "channels": 2, "horizon_s": 0.5}
QUICK = ("--no-floors", "--horizon", "0.5s", "--every", "0.5s", "--tracker", "my-network")


@pytest.fixture
def module(tmp_path: Path, install: Callable[..., Path]) -> Path:
    """The module of a new package, which is registered."""
    path = new_tracker("my-network", tmp_path / "my-network", learned=True)
    install("my-network", {"my-network": "my_network:MyNetworkTracker"}, {path.name: path.read_text()})
    return path


@pytest.fixture
def tracker(module: Path) -> Iterator[type[Tracker]]:
    """Its class, in this process."""
    importlib.invalidate_caches()
    yield importlib.import_module("my_network").MyNetworkTracker
    importlib.sys.modules.pop("my_network")


@pytest.fixture
def task(tracker: type[Tracker], tmp_path: Path) -> Callable[..., FitTask]:
    """`task(folder, **options)`: a tiny training on the room, with a score that improves with every update."""
    room, scored = write_room(tmp_path / "room.mcap"), iter(range(99))

    def score(tracker: Tracker, source: Any, steps: int) -> StretchScore:
        loss = np.full(steps + 1, 1.0 / (1 + next(scored)))
        return StretchScore({"visible": loss}, {"visible": loss}, loss)

    def task(folder: str, **options: Any) -> FitTask:
        train, validation = (open_stream(f"{room}@{use}") for use in ("train", "validation"))
        settings = validated(tracker.Options, TINY | options, "test")
        out = tmp_path / folder / "room.toml"
        return FitTask([train], [validation], score, out, settings, out.parent / "logs", 3, device="cpu")

    return task


def test_the_tracker_has_about_sixty_lines_and_uses_public_names_only(module: Path) -> None:
    text = module.read_text()
    tracker = text.partition("class MyNetworkTracker")[2].partition("\n\n\n")[0]
    lines = re.sub(r'""".*?"""', "", tracker, flags=re.DOTALL).splitlines()
    assert len([line for line in lines if line.strip()]) <= 65
    assert set(re.findall(r"^(?:from|import) (\S+)", text, re.MULTILINE)) == {
        *("__future__", "collections", "collections.abc", "copy", "math", "typing"),
        *("numpy", "pydantic", "torch", "torch.nn.functional", "gridtrack"),
    }
    written = [path.read_text() for path in module.parent.rglob("*") if path.is_file()]
    assert len(written) == 5
    assert not re.search("learned[-_]tracker|LearnedTracker", "".join(written))


def test_an_interrupted_training_keeps_its_best_weights_and_resumes_to_those_of_an_uninterrupted_one(
    tracker: type[Tracker], task: Callable[..., FitTask]
) -> None:
    whole = task("whole")
    tracker.fit(whole)
    interrupt(tracker, task("parts"), after="update 2")
    card = task("parts").out
    assert read_card(card).interrupted == "update 2 of 3"
    lines: list[str] = []
    tracker.fit(replace(task("parts"), report=lines.append))
    assert [line.split(":")[0] for line in lines] == ["update 3 of 3"]
    assert read_card(card).interrupted == ""
    one, other = (
        load_weights(replace(stream_of(whole.train[0]), weights=path), "my-network").arrays
        for path in (whole.out, card)
    )
    assert one.keys() == other.keys()
    for name, value in one.items():
        np.testing.assert_array_equal(value, other[name], name)


def interrupt(tracker: type[Tracker], task: FitTask, after: str) -> None:
    """Run a training that Ctrl-C ends at the line of progress that starts with `after`."""

    def report(text: str) -> None:
        if text.startswith(after):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        tracker.fit(replace(task, report=report))


def test_a_checkpoint_of_another_training_or_a_damaged_one_is_refused(
    tracker: type[Tracker], task: Callable[..., FitTask]
) -> None:
    interrupt(tracker, task("weights"), after="update 1")
    with pytest.raises(
        ConfigurationError,
        match="of another training: channels is 3, there 2; its own",
    ):
        tracker.fit(task("weights", channels=3))
    (checkpoint,) = (task("weights").log_dir).glob("*.ckpt")
    checkpoint.write_bytes(checkpoint.read_bytes()[:100])
    with pytest.raises(ConfigurationError, match=r"last\.ckpt: is damaged: delete the folder"):
        tracker.fit(task("weights"))


def test_an_early_interrupt_a_short_stretch_and_a_missing_device_end_in_a_line(
    tracker: type[Tracker], task: Callable[..., FitTask]
) -> None:
    interrupted = replace(task("weights"), objective=raise_interrupt)
    with pytest.raises(KeyboardInterrupt):
        tracker.fit(interrupted)
    assert not interrupted.out.exists()
    with pytest.raises(ConfigurationError, match=r"my-network learns from stretches of 1\d\d frames or more"):
        tracker.fit(task("long", horizon_s=10))
    with pytest.raises(ConfigurationError, match="device xpu: this machine has none; train on cpu"):
        tracker.fit(replace(task("device"), device="xpu"))


def raise_interrupt(*_: Any) -> StretchScore:
    raise KeyboardInterrupt


@pytest.mark.usefixtures("module", "trackers_here")
def test_it_is_trained_compared_and_judged_by_the_gate(
    gridtrack: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # beside the folder of the package, which has the name of the tracker
    room = write_room(tmp_path / "room.mcap")
    options = ",".join(f"{key}={value}" for key, value in TINY.items())
    done = gridtrack("train", f"my-network:{options}", room, "--out", tmp_path / "weights")
    assert done.code == 0, done.err
    assert "validation: room.mcap@validation" in done.out
    assert list(tmp_path.rglob("*.ckpt")) == []
    assert re.search(r"update 3 of 3: validation log loss \d", done.out), done.out

    run, baseline = tmp_path / "run", tmp_path / "baseline.json"
    done = gridtrack("compare", f"{room}@test", *QUICK, "--weights", tmp_path / "weights", "--out", run)
    assert done.code == 0, done.err
    assert gridtrack("regress", run, "--baseline", baseline, "--update").code == 0
    done = gridtrack("regress", run, "--baseline", baseline)
    assert done.code == 0, done.out + done.err

    stream = replace(stream_of(open_stream(room)), weights=tmp_path / "weights" / "my-network" / "room.toml")
    assert [one for one in check_tracker(launch("my-network"), stream) if not one.kept] == []
