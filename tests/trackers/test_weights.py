"""Weights are used for their tracker, site, grid and period, undamaged, or refused with the reason."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gridtrack.common.errors import WeightsError
from gridtrack.common.files import sha256_of
from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridSpec
from gridtrack.evaluation.runs.learned import LearnedWeights
from gridtrack.trackers.contract import FitTask, StreamSpec
from gridtrack.trackers.training.card import Card, CardThresholds, card_for
from gridtrack.trackers.training.weights import MAX_ARRAYS_BYTES, array, load_weights, read_card, save_weights

from scenes.frames import Frames, frame_of

GRID = GridSpec(100, 0.1, (-2.0, -4.5))


def stretch(name: str = "demo@0s-75s", sha256: str = "12ab", grid: GridSpec = GRID, x=0.0, y=0.0, **fields) -> Frames:
    """A source of one frame, in which nothing is visible, with its window at (x, y)."""
    nothing = np.zeros(grid.shape, bool)
    fields = {"site": "lab"} | fields
    return Frames([frame_of(nothing, nothing, x=x, y=y)], grid, name=name, sha256=sha256, **fields)


def card(tmp_path: Path, *train: Frames) -> Card:
    return card_for("my", fit_task(tmp_path, train or (stretch(),), [stretch("v", "cd")]), {"a": 1})


def fit_task(
    tmp_path: Path, train: Sequence[Frames], validation: Sequence[Frames] = (), *, general: bool = False
) -> FitTask:
    command = "gridtrack train my demo"
    return FitTask(train, validation, None, tmp_path / "lab.toml", None, tmp_path, 3, command, general=general)


def test_a_card_with_classes_says_of_how_many_labelled_scans_and_so_does_the_record_of_a_run(tmp_path: Path) -> None:
    trained = card(tmp_path).model_copy(update={"settings": {"labelled_scans": 50}, "classes": ("bus", "car")})
    assert trained.labelled_scans == 50
    assert trained.model_copy(update={"classes": ()}).labelled_scans is None, "its setting was not used"
    assert trained.model_copy(update={"settings": {"labelled_scans": "fifty"}}).labelled_scans is None
    path = tmp_path / "my" / "lab.toml"
    used = LearnedWeights(path, trained, "12ab", path.parent).provenance()
    assert (used.name, used.labelled_scans) == ("my/lab.toml", 50)


def test_a_general_card_names_properties_of_a_stream_beyond_its_training(tmp_path: Path) -> None:
    sources = [stretch(), stretch(grid=GridSpec(100, 0.2), period_s=0.05)]
    general = card_for("my", fit_task(tmp_path, sources, general=True), {})
    assert general.beyond_training(0.15, 0.1) == ""
    assert general.beyond_training(0.4, 0.1) == "cells of 0.1 to 0.2 m, not 0.4 m"
    assert general.beyond_training(0.2, 0.5) == "periods of 0.05 to 0.1 s, not 0.5 s"
    assert card(tmp_path).beyond_training(0.4, 0.5) == ""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    made = tmp_path / "deep" / "lab.toml"
    save_weights(made, card(tmp_path), {"w": np.arange(6, dtype=np.float32).reshape(2, 3), "n": np.array([1, 2])})
    return made


def load(path: Path | None, grid: GridSpec = GRID, period_s: float = 0.1, tracker: str = "my") -> None:
    load_weights(StreamSpec(grid, period_s, "lab", weights=path), tracker)


def test_saved_weights_are_loaded(path: Path) -> None:
    found = load_weights(StreamSpec(GRID, 0.1, "lab", weights=path), "my")
    assert array(found, "w", (2, 3)).tolist() == [[0, 1, 2], [3, 4, 5]]
    assert (found.card.site, found.card.seed, found.card.command) == ("lab", 3, "gridtrack train my demo")
    assert [(t.recording, t.sha256) for t in found.card.train] == [("demo@0s-75s", "12ab")]
    assert [(t.recording, t.sha256) for t in found.card.validation] == [("v", "cd")]


def test_the_place_of_the_maps_on_the_card_is_the_window_of_the_first_training_frame(tmp_path: Path) -> None:
    made = card(tmp_path, stretch(x=3.2, y=-1.5), stretch("b", x=9.0, y=9.0))
    save_weights(tmp_path / "lab.toml", made, {})
    assert read_card(tmp_path / "lab.toml").map_pose == SE2(3.2, -1.5)


def test_maps_keep_their_place_in_the_world_where_the_window_has_another_corner(tmp_path: Path) -> None:
    made = card(tmp_path, stretch(x=3.2, y=-1.5))
    save_weights(tmp_path / "lab.toml", made, {"a": np.zeros(2)})
    corner = GRID.origin
    moved = GridSpec(GRID.size, GRID.cell_m, (corner[0] - 3 * GRID.cell_m, corner[1] + 5 * GRID.cell_m))
    stream = StreamSpec(moved, 0.1, "lab", weights=tmp_path / "lab.toml")
    place = load_weights(stream, "my").card.map_pose
    assert (place.x + moved.origin[0], place.y + moved.origin[1]) == pytest.approx((3.2 + corner[0], -1.5 + corner[1]))


def test_the_shipped_cards_have_the_places_of_the_sensors_of_their_sites() -> None:
    places = {"junction": SE2(-8.0, 8.0), "leg_tracker": SE2(0.0, 0.0)}
    cards = [
        read_card(found) for found in sorted(Path(str(resources.files("gridtrack.data"))).rglob("weights/*/*.toml"))
    ]
    of_sites = [found for found in cards if not found.general]
    assert of_sites
    assert all(found.map_pose == places[found.site] for found in of_sites)


@pytest.mark.parametrize("position", ["[ 1e10, 0.0 ]", "[ 0.0 ]", "[ nan, 0.0 ]", '"here"'])
def test_a_place_that_is_no_position_is_refused(path: Path, position: str) -> None:
    text = path.read_text().replace("\n    0.0,\n    0.0,\n]", "REPLACED").replace("[REPLACED", position)
    path.write_text(text)
    with pytest.raises(WeightsError, match="not a weights card"):
        read_card(path)


def test_weights_of_another_place_are_refused(path: Path) -> None:
    with pytest.raises(WeightsError, match="made for site lab, but this is office"):
        load_weights(StreamSpec(GRID, 0.1, "office", weights=path), "my")


def test_a_card_without_arrays_stands_alone(tmp_path: Path) -> None:
    path = tmp_path / "lab.toml"
    save_weights(path, card(tmp_path), {})
    assert load_weights(StreamSpec(GRID, 0.1, "lab", weights=path), "my").arrays == {}
    assert [p.name for p in tmp_path.iterdir()] == ["lab.toml"]


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"tracker": "other"}, "made for tracker my, but this is other"),
        ({"grid": GridSpec(50, 0.1, (-2.0, -4.5))}, "made for grid 100x0.1@-2,-4.5, but this is 50x0.1@-2,-4.5"),
        ({"grid": GridSpec(100, 0.1, (-2.05, -4.5))}, "for grid 100x0.1@-2,-4.5, but this is 100x0.1@-2.05,-4.5"),
        ({"period_s": 0.125}, r"for a period of 0.1 s \(10 Hz\), but this stream's is 0.125 s: compare with --rate 10"),
    ],
)
def test_another_grid_period_or_tracker_is_refused_by_name(
    path: Path, change: dict[str, object], complaint: str
) -> None:
    with pytest.raises(WeightsError, match=complaint):
        load(path, **change)  # type: ignore[arg-type]


def test_a_period_that_differs_by_rounding_is_the_same(path: Path) -> None:
    load(path, period_s=0.1 + 1e-9)


def test_no_weights_names_the_command_that_makes_them() -> None:
    with pytest.raises(WeightsError, match="no weights for site 'lab'; make them with `gridtrack train my RECORDING`"):
        load(None)


def test_a_missing_file_says_which(path: Path) -> None:
    path.with_suffix(".safetensors").unlink()
    with pytest.raises(WeightsError, match=r"lab\.safetensors: cannot be read \(No such file"):
        load(path)
    path.unlink()
    with pytest.raises(WeightsError, match=r"lab\.toml: cannot be read \(No such file"):
        load(path)


def test_a_flipped_bit_in_the_arrays_is_found(path: Path) -> None:
    arrays = path.with_suffix(".safetensors")
    whole = arrays.read_bytes()
    for place, bit in np.random.default_rng(0).integers((len(whole), 8), size=(50, 2)).tolist():
        blob = bytearray(whole)
        blob[place] ^= 1 << bit
        arrays.write_bytes(blob)
        with pytest.raises(WeightsError, match="the file is damaged or was exchanged"):
            load(path)


def test_a_card_that_was_exchanged_is_refused(path: Path) -> None:
    stream = StreamSpec(GRID, 0.1, "lab", weights=path, weights_sha256=sha256_of(path))
    load_weights(stream, "my")
    path.write_text(path.read_text() + "\n")
    with pytest.raises(WeightsError, match=r"lab\.toml: its sha256 is not the one in the request"):
        load_weights(stream, "my")


def test_a_reader_between_the_two_replacements_has_the_previous_weights(path: Path, monkeypatch: Any) -> None:
    """So has one after a crash there: the arrays are replaced first, and the card last."""
    other = {"w": np.zeros((2, 3)), "n": np.array([3, 4])}
    replace = Path.replace
    monkeypatch.setattr(Path, "replace", lambda self, to: None if to == path else replace(self, to))
    monkeypatch.setattr(Path, "unlink", lambda self, missing_ok=False: None)
    save_weights(path, card(path.parent), other)
    assert load_weights(StreamSpec(GRID, 0.1, "lab", weights=path), "my").arrays["w"].any()
    monkeypatch.undo()
    save_weights(path, card(path.parent), other)
    assert not load_weights(StreamSpec(GRID, 0.1, "lab", weights=path), "my").arrays["w"].any()
    assert sorted(p.name for p in path.parent.iterdir() if p.suffix != ".partial") == ["lab.safetensors", "lab.toml"]


def test_arrays_too_large_are_refused_unread(path: Path) -> None:
    with path.with_suffix(".safetensors").open("r+b") as file:
        file.truncate(MAX_ARRAYS_BYTES + 1)  # sparse: nothing is written
    with pytest.raises(WeightsError, match="are refused"):
        load(path)


@pytest.mark.parametrize(
    ("edit", "complaint"),
    [
        (
            lambda text: text.replace("schema_version = 2", "schema_version = 9"),
            "schema 9; .* reads 2: update gridtrack",
        ),
        (
            lambda text: text.replace("schema_version = 2", "schema_version = 1"),
            "schema 1; .* rewrite it with gridtrack 0.2",
        ),
        (lambda text: re.sub(r"world_T_grid = \[[^\]]*\]\n", "", text), "has its grid, period_s and world_T_grid"),
        (lambda text: 'secret = "x"\n' + text, "there is no option"),
        (lambda text: text.replace('site = "lab"\n', ""), "'site'"),
        (lambda text: text.replace("period_s = 0.1", "period_s = 0.0"), "'period_s' = 0.0"),
        (lambda text: text.replace("100x0.1@-2,-4.5", "huge"), "grid 'huge'"),
        (lambda text: "[" + text, "not a weights card"),
        (lambda text: "#" * (1 << 20) + text, "larger than 1048576 bytes"),
    ],
)
def test_a_damaged_card_is_one_clear_line(path: Path, edit: Callable[[str], str], complaint: str) -> None:
    path.write_text(edit(path.read_text()))
    with pytest.raises(WeightsError, match=complaint):
        read_card(path)


@pytest.mark.parametrize("card", [f"a = {'9' * 5000}", "a = " + "[" * 20_000, f'grid = "{"9" * 5000}x0.1"'])
def test_a_card_made_to_break_the_reader_is_refused_in_one_line(path: Path, card: str) -> None:
    text = path.read_text()
    path.write_text(
        card if "grid" not in card else "\n".join(card if x[:4] == "grid" else x for x in text.splitlines())
    )
    with pytest.raises(WeightsError, match="not a weights card of gridtrack"):
        read_card(path)


def test_a_card_that_is_not_text_is_refused(path: Path) -> None:
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(WeightsError, match="not a weights card"):
        read_card(path)


def test_an_array_of_another_shape_or_name_is_refused(path: Path) -> None:
    found = load_weights(StreamSpec(GRID, 0.1, "lab", weights=path), "my")
    with pytest.raises(WeightsError, match=r"array 'w' is \(2, 3\), expected \(3, 2\)"):
        array(found, "w", (3, 2))
    with pytest.raises(WeightsError, match="array 'v' is missing"):
        array(found, "v", (1,))


def test_training_stretches_must_share_grid_period_and_site(tmp_path: Path) -> None:
    with pytest.raises(WeightsError, match="one grid, period and site"):
        card(tmp_path, stretch(), stretch(site="elsewhere"))
    assert len(card(tmp_path, stretch("a"), stretch("b")).train) == 2


def test_thresholds_of_a_card_come_from_the_nearest_horizon():
    thresholds = CardThresholds(step_s=0.1, values={"visible": (0.5, 0.4, 0.3)})
    assert thresholds.at("visible", np.array([0.0, 0.06, 0.125, 0.2, 9.0])).tolist() == [0.5, 0.4, 0.4, 0.3, 0.3]
    assert thresholds.at("occluded", np.array([0.0, 1.0])).tolist() == [0.5, 0.5]
