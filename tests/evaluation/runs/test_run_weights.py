"""The learned weights of a run: found for each row, copied, and named in its results."""

from __future__ import annotations

import json
import shutil

import pytest

from gridtrack.common.errors import ConfigurationError, WeightsError
from gridtrack.evaluation.runs.learned import find_weights, user_weights_folder, weights_in, weights_path
from gridtrack.evaluation.runs.plan import resolve
from gridtrack.evaluation.runs.runner import run
from gridtrack.evaluation.runs.trial_record import read_trial_record
from gridtrack.recordings import packaged_recording
from gridtrack.trackers.training.card import Card
from gridtrack.trackers.training.weights import save_weights

from scenes.room import curve, trial_of

pytestmark = pytest.mark.usefixtures("trackers_here")


def test_the_suggested_training_has_the_grid_and_rate_of_the_comparison(settings):
    (trial,) = resolve(settings("static-map")).trials
    assert trial.how_to_train.endswith(
        "room.mcap`, then compare again with --resume, or name a folder of weights with --weights"
    )
    (trial,) = resolve(settings("static-map", grid="30x0.1", rate_hz=5.0)).trials
    assert "room.mcap --grid 30x0.1@-1.5,-1.5 --rate 5`" in trial.how_to_train


def test_a_run_with_learned_weights_names_them_without_the_folders_of_the_machine(compare, train, tmp_path):
    weights, card = tmp_path / "weights", train("weights")
    assert card == weights / "static-map" / "room.toml"
    summary = compare("static-map", weights=weights)
    result = trial_of(summary, "static-map")
    assert result.outcome == "ok"
    assert min(curve(result, "static", "f1.f1")) > 0.9
    assert not [notice for notice in map(str, summary.notices) if "learned from" in notice]
    kept = json.loads((tmp_path / "run" / "run.json").read_text())["weights"]
    assert kept["static-map@room"]["name"] == "static-map/room.toml"
    assert set(kept["static-map@room"]) == {"name", "sha256", "labelled_scans"}
    other = compare("static-map=static-map:card=site", weights=weights, grid="20x0.4@-1,-4", out=tmp_path / "other")
    refused = trial_of(other, "static-map")
    assert refused.outcome == "not-applicable"
    message = f"{card}: made for grid 40x0.2@-1,-4, but this is 20x0.4@-1,-4"
    assert refused.reason.startswith(message), "it names the user's file, not its copy"


def test_each_row_has_the_weights_of_its_own_folder_and_no_others(settings, train, tmp_path):
    with pytest.raises(WeightsError, match="wieghts: no such folder of weights"):
        resolve(settings("static-map", weights=tmp_path / "wieghts"))
    assert find_weights("static-map", "room", tmp_path, "site") is None
    card = train("first")
    shutil.copytree(tmp_path / "first", tmp_path / "second")
    rows = (f"{name}=static-map:weights={tmp_path / name}" for name in ("first", "second"))
    trials = resolve(settings(*rows, weights=tmp_path / "first")).trials
    assert [trial.weights.path.parent.parent.name for trial in trials] == ["first", "second"]
    with pytest.raises(WeightsError, match="empty: no such folder of weights"):
        resolve(settings(f"static-map:weights={tmp_path / 'empty'}", weights=tmp_path / "first"))
    (tmp_path / "empty").mkdir()
    with pytest.raises(WeightsError, match=r"empty: no weights of static-map for the site 'room'"):
        resolve(settings(f"static-map:weights={tmp_path / 'empty'}", weights=tmp_path / "first"))
    card.write_text(card.read_text().replace('interrupted = ""', 'interrupted = "update 3 of 9"'))
    (notice,) = resolve(settings("static-map", weights=tmp_path / "first")).notices
    assert str(notice) == "static-map: static-map/room.toml is of a training that was interrupted at update 3 of 9"


def test_weights_exchanged_in_mid_run_are_not_used(settings, record, train, tmp_path, progress):
    """The trial uses the files with the recorded hash, also if the site is trained again after the plan was made."""
    train("given", "static-map", record("given", wall_m=3.0))
    train("other", "static-map", record("other", wall_m=2.0), options={"prior_frames": 1000.0})
    weights = tmp_path / "given" / "static-map"

    class Exchanging(type(progress)):
        def started(self, trial, frames):
            shutil.copytree(tmp_path / "other" / "static-map", weights, dirs_exist_ok=True)

    def scored(out, watching):
        run(resolve(settings("static-map", weights=tmp_path / "given", out=tmp_path / out)), (), watching)
        return read_trial_record(tmp_path / out / "static-map@room")

    before, during, after = scored("a", progress), scored("b", Exchanging()), scored("c", progress)
    assert before.weights_sha256 == during.weights_sha256 != after.weights_sha256
    scores = "sums.parquet"
    assert before.files[scores] == during.files[scores] != after.files[scores]


def learned(folder, grid="1x1"):
    """Write weights of `static-map` for the room."""
    place = {"site": "room", "grid": grid, "period_s": 0.1, "world_T_grid": (0.0, 0.0)}
    card = Card(tracker="static-map", **place, seed=0, command=str(folder), train=())
    save_weights(weights_path(folder, "static-map", "room"), card, {})


def test_weights_are_found_in_the_given_folder_then_the_users_then_the_package(tmp_path, home):
    assert user_weights_folder() == tmp_path / "home" / "gridtrack" / "weights"
    assert find_weights("no-such-tracker", "room", None) is None
    learned(user_weights_folder())
    (tmp_path / "given").mkdir()
    assert find_weights("static-map", "room", tmp_path / "given").card.command == str(user_weights_folder())
    learned(tmp_path / "given")
    assert find_weights("static-map", "room", tmp_path / "given").card.command == str(tmp_path / "given")
    assert find_weights("static-map", "elsewhere", tmp_path / "given", "site") is None


def test_weights_of_a_site_choose_no_thresholds_at_another_one(settings, record, train, tmp_path):
    elsewhere = record("elsewhere", wall_m=2.2, stretches={}, site="elsewhere")
    there, site = {"validation": f"{elsewhere}@4s-9s"}, {"weights": tmp_path / "site"}
    learned(tmp_path / "site", grid="40x0.2@-1,-4")
    with pytest.raises(
        ConfigurationError,
        match=r"^static-map: its weights are of the site 'room', and its thresholds would be chosen on"
        r" elsewhere\.mcap@4s-9s of the site 'elsewhere': name a --validation stretch of the site 'room', or compare"
        r" general weights \(--tracker static-map:card=general\)$",
    ):
        resolve(settings("persistence", "static-map", **there, **site))
    resolve(settings("persistence", **there))
    train("site", "static-map", f"{elsewhere}@10s-15s", validation=(f"{elsewhere}@15s-20s",), general=True)
    (trial,) = resolve(settings("static-map:card=general", **there, **site)).trials
    assert trial.weights.card.general


@pytest.mark.parametrize("site", ["Hall A", "../room"])
def test_a_row_at_a_site_with_a_name_that_is_no_file_name_has_the_general_weights_of_its_folder(site, tmp_path):
    missing = rf"^{tmp_path}: no weights of .* \({tmp_path}/static-map/general.toml is missing"
    with pytest.raises(WeightsError, match=missing):
        weights_in(tmp_path, "static-map", site)
    card = {"cells_m": (0.1, 0.2), "periods_s": (0.1, 0.1), "seed": 0, "command": "", "train": ()}
    path = weights_path(tmp_path, "static-map", "general")
    save_weights(path, Card(tracker="static-map", site="general", **card), {})
    for kind in ("any", "general"):
        assert weights_in(tmp_path, "static-map", site, kind).path == path
        assert find_weights("static-map", site, tmp_path, kind).path == path
    assert find_weights("static-map", site, tmp_path, "site") is None
    with pytest.raises(WeightsError, match="cannot name a weights file"):
        weights_in(tmp_path, "static-map", site, "site")


@pytest.mark.parametrize(
    ("how", "why"),
    [
        ({"grid": "60x0.2"}, "made for grid 100x0.1@-2,-4.5, but this is 60x0.2@-6,-6"),
        ({"rate_hz": 5.0}, "made for a period of 0.1 s (10 Hz), but this stream's is 0.2 s"),
    ],
)
def test_weights_of_a_site_that_do_not_fit_grid_or_rate_give_way_to_general_ones_and_a_notice(how, why, settings):
    demo = str(packaged_recording("leg_tracker"))
    how |= {"recordings": (f"{demo}@114s-124s",), "validation": f"{demo}@75s-85s"}
    plan = resolve(settings("kalman", "site=kalman:card=site", **how))
    assert [trial.weights.kind for trial in plan.trials] == ["general", "site"]
    said = f"kalman on leg_tracker@114s-124s: its weights of the site 'leg_tracker' are {why}; general weights are"
    assert [line.startswith(said) for line in map(str, plan.notices) if "as with card=general" in line] == [True]
