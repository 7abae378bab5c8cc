"""The learned weights of a run: found for each row, copied, and named in its results."""

from __future__ import annotations

import json
import shutil

import pytest

from gridtrack.common.errors import WeightsError
from gridtrack.evaluation.runs.learned import find_weights
from gridtrack.evaluation.runs.plan import resolve
from gridtrack.evaluation.runs.runner import run
from gridtrack.evaluation.runs.trial_record import read_trial_record
from gridtrack.trackers.training.weights import read_card
from tests.scenes.room import curve

from scenes.room import trial_of

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


def test_a_card_is_read_once_for_all_recordings_of_a_site(settings, record, monkeypatch):
    read = []
    monkeypatch.setattr(
        "gridtrack.evaluation.runs.learned.read_card",
        lambda path, *rest: read.append(path.parent.name) or read_card(path, *rest),
    )
    recordings = tuple(str(record(f"r{n}", 8, {}, wall_m=3 + n / 10)) for n in range(3))
    plan = resolve(settings("kalman", "persistence", recordings=recordings))
    assert read == ["kalman"]
    assert all(trial.weights for trial in plan.trials if trial.label == "kalman")
