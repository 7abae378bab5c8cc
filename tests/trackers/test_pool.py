"""The tracker `pool`: members are found by name, their weights are carried along, and the best ones get the weight."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from safetensors.numpy import load_file, save

from gridtrack.common.config import validated
from gridtrack.common.errors import ConfigurationError, PluginError, WeightsError
from gridtrack.common.grid import GridFrame, GridSpec
from gridtrack.evaluation.hosting.contract_suite import check_tracker
from gridtrack.trackers.contract import FitTask, StreamSpec
from gridtrack.trackers.pool import PoolOptions, PoolTracker
from gridtrack.trackers.selection import launch
from gridtrack.trackers.training.card import Card, TrainingData, card_for
from gridtrack.trackers.training.weights import card_text, read_card, save_weights
from tests.conftest import Install

from scenes.frames import Frames, frame_of

GRID = GridSpec(12, 0.5)
RATES = np.random.default_rng(7).uniform(0.02, 0.9, GRID.shape).astype(np.float32)
"""P(occupied) of each cell, in every frame."""
SEEN = TrainingData(recording="old.mcap", sha256="cd", source_sha256="ef", start_ns=1, end_ns=2)
MEMBERS = '''
import numpy as np
from gridtrack.trackers.contract import Forecast, Tracker
from gridtrack.trackers.training.weights import array, load_weights

class Rates(Tracker):
    """Knows the rate of each cell."""

    moving_sensor = True

    def reset(self, seed):
        self.seed = seed

    def update(self, frame):
        pass

    @property
    def recoveries(self):
        return 1

    def rates(self):
        return np.random.default_rng(7).uniform(0.02, 0.9, self.stream.grid.shape).astype(np.float32)

    def predict(self, steps):
        return Forecast(np.repeat(self.rates()[None], steps + 1, axis=0))

class Shuffled(Rates):
    """Is wrong about each cell."""

    moving_sensor = False

    def rates(self):
        return Rates.rates(self)[::-1, ::-1]

class Level(Rates):
    """Has learned one rate for all cells."""

    learns = learns_general = True

    def __init__(self, stream, options):
        super().__init__(stream, options)
        self.level = float(array(load_weights(stream, "level"), "level", (1,))[0])

    @property
    def device(self):
        return "a coprocessor"

    @property
    def recoveries(self):
        return 2

    def rates(self):
        return np.full(self.stream.grid.shape, self.level, np.float32)

    @classmethod
    def fit(cls, task):
        pass
'''


@pytest.fixture(autouse=True)
def members(install: Install) -> None:
    points = {name.lower(): f"pool_members:{name}" for name in ("Rates", "Shuffled", "Level")}
    install("pool-members", points, {"pool_members.py": MEMBERS})


def source(count: int = 400, seed: int = 0) -> Frames:
    draw = np.random.default_rng(seed)
    frames = [frame_of(draw.random(GRID.shape) < RATES, grid=GRID, second=0.1 * n) for n in range(count)]
    return Frames(frames, GRID, name=f"rec@{seed}")


def task(tmp_path: Path, *names: str, **fields: Any) -> FitTask:
    given = {"general": True, "validation": [source(seed=1)]} | fields
    options = PoolOptions(members=names)
    stem = "general" if given["general"] else "here"
    out = tmp_path / "pool" / f"{stem}.toml"
    return FitTask([source()], objective=None, out=out, options=options, log_dir=tmp_path, **given)


def with_level(folder: Path, site: str = "general") -> Path:
    """Weights of the member `level` in `folder`."""
    learned = card_for("level", task(folder, general=site == "general"), {}).model_copy(update={"train": (SEEN,)})
    path = folder / "level" / f"{site}.toml"
    save_weights(path, learned, {"level": np.array([0.3], np.float32)})
    return path


def fitted(tmp_path: Path, *names: str, **fields: Any) -> PoolTracker:
    found = task(tmp_path, *names, **fields)
    PoolTracker.fit(found)
    return PoolTracker(StreamSpec(GRID, 0.1, "here", weights=found.out), PoolOptions())


def log_loss(p: np.ndarray, occupied: np.ndarray) -> float:
    return float(-np.where(occupied, np.log(p), np.log1p(-p)).mean())


def test_a_pool_of_one_calibrated_member_is_this_member(tmp_path: Path) -> None:
    pool = fitted(tmp_path, "rates")
    forecast = pool.predict(30).occupancy
    assert forecast.dtype == np.float32
    assert forecast == pytest.approx(np.repeat(RATES[None], 31, axis=0), abs=0.03)


def test_the_better_member_dominates_and_the_pool_is_no_worse_than_it(tmp_path: Path) -> None:
    lines: list[str] = []
    pool = fitted(tmp_path, "shuffled", "rates", report=lines.append)
    for one in source():
        pool.update(one)
    shuffled, rates = np.moveaxis(load_file(tmp_path / "pool" / "general.safetensors")["weights"], -1, 0)
    assert (shuffled < 0.1).all()
    assert rates == pytest.approx(1.0, abs=0.1)
    outcomes = np.array([one.occupied for one in source(seed=1)])
    assert log_loss(pool.predict(5).occupancy[5], outcomes) < log_loss(RATES, outcomes) + 0.002
    scores = read_card(tmp_path / "pool" / "general.toml").results["validation"]
    assert list(scores) == ["shuffled", "rates", "mean", "pool"]
    assert scores["pool"]["0.5s"] < scores["mean"]["0.5s"] < scores["shuffled"]["0.5s"]
    assert [line for line in lines if line.startswith("log loss on validation, pool: ")]


def test_the_card_carries_the_members_and_names_what_they_were_trained_on(tmp_path: Path) -> None:
    path = with_level(tmp_path)
    pool = fitted(tmp_path, "rates", "level")
    path.unlink()
    pool = PoolTracker(pool.stream, PoolOptions())
    assert pool.device == "a coprocessor"
    assert pool.recoveries == 3
    card = read_card(tmp_path / "pool" / "general.toml")
    assert SEEN in card.train, "for the leak check"
    assert card.train[0].recording == "rec@0"
    assert card.settings == {"members": ["rates", "level"]}
    assert list(card.members or {}) == ["level"]


def test_the_weights_of_the_site_come_before_general_ones_and_a_line_says_which(tmp_path: Path) -> None:
    lines: list[str] = []
    with_level(tmp_path)
    fitted(tmp_path, "level", general=False, report=lines.append)
    assert "member level: general weights" in lines
    with_level(tmp_path, "here")
    fitted(tmp_path, "level", general=False, report=lines.append)
    assert "member level: site weights" in lines


def test_weights_of_a_member_are_missing(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"level/here.toml: missing, .* `gridtrack train level RECORDING"):
        fitted(tmp_path, "level", general=False)


def test_exchanged_arrays_of_a_member_are_refused(tmp_path: Path) -> None:
    with_level(tmp_path)
    stream = fitted(tmp_path, "level").stream
    card = read_card(tmp_path / "pool" / "general.toml")
    exchanged = load_file(tmp_path / "pool" / "general.safetensors")
    exchanged["members/level"] = np.frombuffer(save({"level": np.array([0.9], np.float32)}), np.uint8)
    save_weights(tmp_path / "pool" / "general.toml", card, exchanged)
    with pytest.raises(WeightsError, match=r"member level: .*sha256 is not the one on its card"):
        PoolTracker(stream, PoolOptions())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"members": {"../level": None}}, "members"),
        ({"settings": {}}, "it names no members"),
        ({"settings": {"members": ["no-such"]}}, "there is no tracker 'no-such'"),
        ({"settings": {"members": ["pool"]}}, "pool cannot be a member: it has members itself"),
        ({"members": None}, "member level: .*no weights"),
    ],
)
def test_other_members_on_a_card_are_refused(tmp_path: Path, change: dict[str, Any], message: str) -> None:
    with_level(tmp_path)
    stream = fitted(tmp_path, "level").stream
    path = tmp_path / "pool" / "general.toml"
    card = read_card(path)
    if isinstance(change.get("members"), dict):
        change = {"members": {"../level": (card.members or {})["level"]}}
    path.write_text(card_text(card.model_copy(update=change)))
    with pytest.raises((WeightsError, PluginError, ConfigurationError), match=message):
        PoolTracker(stream, PoolOptions())


def test_members_of_members_are_refused(tmp_path: Path) -> None:
    card = card_for("pool", task(tmp_path), {})
    nested = card.model_copy(update={"members": {"a": card.model_copy(update={"members": {"b": card}})}})
    with pytest.raises(ConfigurationError, match="a member has members of its own"):
        validated(Card, nested.model_dump(exclude_none=True), "card")


def test_members_are_named_at_the_training_alone(tmp_path: Path) -> None:
    assert validated(PoolOptions, {"members": "[kalman,dogma]"}, "pool").members == ("kalman", "dogma")
    for names, message in ((["a", "a"], "named twice"), (["../a"], "should match pattern")):
        with pytest.raises(ConfigurationError, match=message):
            validated(PoolOptions, {"members": names}, "pool")
    with pytest.raises(ConfigurationError, match="pool: name its members"):
        PoolTracker.fit(task(tmp_path))
    with pytest.raises(WeightsError, match="no weights for site"):
        PoolTracker(StreamSpec(GRID, 0.1, "here"), PoolOptions())
    pool = fitted(tmp_path, "persistence")
    with pytest.raises(ConfigurationError, match="its members are persistence"):
        PoolTracker(pool.stream, PoolOptions(members=("blank",)))


def test_the_window_moves_with_the_members_and_one_that_does_not_follow_is_named(tmp_path: Path) -> None:
    corner = np.zeros(GRID.shape, bool)
    corner[3, 5] = True
    pool = fitted(tmp_path, "persistence")
    pool.reset(0)
    pool.update(frame_of(corner))
    pool.update(frame_of(corner, ~corner & corner, second=0.1, x=1.0))
    assert pool.predict(3).occupancy[3].argmax() == np.ravel_multi_index((3, 3), GRID.shape)
    pool = fitted(tmp_path, "rates", "shuffled")
    pool.update(frame_of(corner))
    with pytest.raises(ConfigurationError, match="the sensor moves, and the member shuffled does not follow it"):
        pool.update(frame_of(corner, second=0.1, x=1.0))


class Interrupted(Frames):
    def __iter__(self) -> Iterator[GridFrame]:
        raise KeyboardInterrupt


def test_after_an_interrupt_the_places_so_far_are_kept(tmp_path: Path) -> None:
    found = task(tmp_path, "rates", general=True)
    found = replace(found, validation=[Interrupted([], GRID)])
    with pytest.raises(KeyboardInterrupt):
        PoolTracker.fit(found)
    assert read_card(found.out).interrupted == "place 1 of 1"
    assert PoolTracker(StreamSpec(GRID, 0.1, weights=found.out), PoolOptions()).predict(1)


@pytest.mark.usefixtures("trackers_here")
def test_a_pool_satisfies_the_contract(tmp_path: Path) -> None:
    fitted(tmp_path, "persistence", "blank")
    stream = StreamSpec(GridSpec(40, 0.2), 0.125, "here", weights=tmp_path / "pool" / "general.toml")
    assert [result for result in check_tracker(launch("pool"), stream) if not result.kept] == []
