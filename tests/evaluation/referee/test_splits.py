"""Splits: the test stretch, the validation stretch, and refused overlaps."""

import pytest

from gridtrack.common.errors import ConfigurationError, WeightsError
from gridtrack.common.grid import GridSpec
from gridtrack.evaluation.referee.splits import Sampling, common_with, plan_split
from gridtrack.evaluation.referee.strata import CELL_KINDS
from gridtrack.evaluation.runs.learned import find_weights, user_weights_folder, weights_in, weights_path
from gridtrack.evaluation.runs.plan import resolve
from gridtrack.evaluation.runs.recipe import Recipe
from gridtrack.evaluation.runs.run_record import description_of
from gridtrack.evaluation.runs.settings import CompareSettings
from gridtrack.evaluation.runs.train import train_tracker
from gridtrack.recordings import import_recording, open_recording, packaged_recording
from gridtrack.recordings.formats.native import NativeRecording
from gridtrack.recordings.recording_info import NO_MOTION
from gridtrack.trackers.training.card import Card, TrainingData
from gridtrack.trackers.training.weights import save_weights

pytestmark = pytest.mark.usefixtures("trackers_here")

SECOND = Sampling(horizon_s=1.0, every_s=0.5)


def test_the_named_test_and_validation_stretches_are_the_default(record):
    split = plan_split(str(record()), None, SECOND)
    assert (split.name, split.test.name, split.validation.name) == ("room", "room.mcap@test", "room.mcap@validation")
    assert (split.steps, split.every) == (10, 5)
    assert description_of(split).horizons_s == tuple(round(0.1 * n, 1) for n in range(11))
    assert split.notices == ()


def test_a_recording_without_named_stretches_is_tested_whole_at_one_half(record):
    split = plan_split(str(record(stretches={})), None, SECOND)
    assert len(split.test) == 200
    assert split.validation is None
    assert "the thresholds of a tracker come from its weights' card" in split.notices[0].text


def test_a_range_is_part_of_the_name_of_its_split(record):
    split = plan_split(f"{record()}@9s-20s", None, SECOND)
    assert (split.name, len(split.test)) == ("room@9s-20s", 110)
    assert split.validation.name == "room.mcap@validation"


def test_thresholds_are_never_chosen_on_frames_that_are_tested(record):
    path = record()
    split = plan_split(f"{path}@8s-20s", None, SECOND)
    assert split.validation is None
    assert (
        "shares frames with its validation room.mcap@validation, so the thresholds of a tracker"
        in split.notices[0].text
    )
    with pytest.raises(ConfigurationError, match=r"shares frames with its validation room\.mcap@0s-8\.5s: name"):
        plan_split(f"{path}@8s-20s", f"{path}@0s-8.5s", SECOND)


def test_a_validation_stretch_that_is_too_short_gives_a_notice(record):
    stretches = {"validation": (0.0, 2.5), "test": (9.0, None)}
    split = plan_split(str(record(stretches=stretches)), None, SECOND)
    assert split.validation is None
    assert "25 frames leave nothing to score" in split.notices[0].text
    with pytest.raises(ConfigurationError, match="name another --validation"):
        plan_split(str(record()), f"{record()}@0s-2.5s", SECOND)


def test_a_short_validation_stretch_is_forecast_from_more_often_than_the_test(record):
    often = plan_split(str(record(stretches={"validation": (0.0, 9.9), "test": (10.0, None)})), None, SECOND)
    assert often.validation_schedule.every == 2
    assert often.validation_schedule.expected == len(range(20, 99 - 10, 2))
    seldom = plan_split(str(record(seconds=60)), f"{record('long', seconds=60, stretches={})}", SECOND)
    assert seldom.validation_schedule.every == seldom.every == 5


@pytest.mark.parametrize(
    ("seconds", "every", "forecasts", "says"),
    [
        (4, 1, 10, "made: 10 forecasts, one every 0.1 s (--every)"),
        (12, 3, 30, "made: 30 forecasts, one every 0.3 s (--every)"),
        (40, 10, 37, ""),
    ],
)
def test_by_default_there_is_a_forecast_a_second_and_more_of_them_on_a_short_recording(
    record, seconds, every, forecasts, says
):
    path = str(record("made", seconds=seconds, stretches={}))
    split = plan_split(path, None, Sampling(horizon_s=1.0, every_s=None))
    assert (split.every, split.schedule.expected) == (every, forecasts)
    assert [line for line in map(str, split.notices) if "--every" in line] == [says] * bool(says)
    assert plan_split(path, None, Sampling(horizon_s=1.0, every_s=1.0)).every == 10


@pytest.mark.parametrize(
    ("poses", "kinds"),
    [
        ("odom -> laser; from /tf; longest gap 0.05 s", []),
        ("at rest", []),
        (f"map -> laser; from /tf; {NO_MOTION}", [f"poses: {NO_MOTION}"]),
        ("kiss-icp: scans of 'scan' matched", ["poses: from matching the scans"]),
    ],
)
def test_poses_that_are_recorded_are_no_notice(record, monkeypatch, poses, kinds):
    path = record()
    info = open_recording(path).info.model_copy(update={"poses": poses})
    monkeypatch.setattr(NativeRecording, "info", info)
    assert [notice.kind for notice in plan_split(str(path), None, SECOND).notices] == kinds


@pytest.mark.parametrize(
    ("text", "sampling", "message"),
    [
        ("@9s-12s", SECOND, r"30 frames leave nothing to score after 20 frames of warm-up and with 10 steps ahead"),
        ("", Sampling(horizon_s=0.04, every_s=1.0), r"a horizon of 0\.04 s is less than half a frame"),
        ("", Sampling(60.0, 1.0, GridSpec(1000, 0.01)), r"forecasts of 600 steps on 1000 x 1000 cells take"),
    ],
)
def test_a_stretch_without_scored_frames_is_refused_in_one_line(record, text, sampling, message):
    with pytest.raises(ConfigurationError, match=message):
        plan_split(f"{record()}{text}", None, sampling)


def test_grid_and_rate_can_be_given(record):
    split = plan_split(str(record()), None, Sampling(0.6, 1.0, GridSpec(30, 0.1), 5.0))
    assert (split.test.grid, split.validation.grid, len(split.test)) == (GridSpec(30, 0.1), GridSpec(30, 0.1), 55)


def cell_kinds(split):
    return split.regions().test.of(next(split.test.observations())).cell_kinds


def test_static_cells_come_from_the_whole_recording(record):
    path = record()
    one, other = (cell_kinds(plan_split(f"{path}@{stretch}", None, SECOND)) for stretch in ("0s-5s", "9s-20s"))
    assert (one == other).all()
    wall = one[20, int((3.0 + 1.0) / 0.2)]
    assert CELL_KINDS[wall] == "static"


def test_two_recordings_with_one_name_are_refused(record, tmp_path):
    path = str(record())
    settings = CompareSettings(recordings=(path, path), trackers=("blank",), out=tmp_path / "run")
    with pytest.raises(ConfigurationError, match="would both be called 'room'"):
        resolve(settings)


def test_a_copy_of_a_recording_is_refused_because_its_frames_are_no_more_evidence(record, tmp_path):
    path = record()
    copied = path.with_name("copy.mcap")
    copied.write_bytes(path.read_bytes())
    settings = CompareSettings(recordings=(str(path), str(copied)), trackers=("blank",), out=tmp_path / "run")
    with pytest.raises(ConfigurationError, match=r"room.mcap@test and copy.mcap@test are of one source and have 11 s"):
        resolve(settings)


def test_an_import_under_another_name_is_of_the_same_source_and_stretches_that_overlap_are_refused(record, tmp_path):
    path = record()
    imported = import_recording(path, tmp_path / "other.mcap", site="elsewhere").path
    again = import_recording(imported, tmp_path / "again.mcap").path
    whole = {"trackers": ("blank",), "out": tmp_path / "run", "horizon_s": 0.5}
    for other in (imported, again):
        settings = CompareSettings(recordings=(f"{path}@0s-10s", f"{other}@8s-20s"), **whole)
        with pytest.raises(ConfigurationError, match=r"@0s-10s and .*@8s-20s are of one source and have 2 s in common"):
            resolve(settings)
    settings = CompareSettings(recordings=(f"{path}@0s-10s", f"{again}@10s-20s"), **whole)
    assert len({description_of(split).source_sha256 for split in resolve(settings).splits}) == 1


@pytest.mark.parametrize(
    ("seen", "expected"),
    [
        ("room.mcap@train", False),
        ("room.mcap@validation", False),
        ("room.mcap@test", True),
        ("room.mcap@0s-9s", False),
        ("room.mcap@0s-9.5s", True),
        ("room.mcap@15s-", True),
        ("room.mcap", True),
        ("room.mcap@no-longer-named", True),
    ],
)
def test_frames_seen_in_training_are_detected(record, seen, expected):
    test = plan_split(str(record()), None, SECOND).test
    assert (common_with(test, TrainingData(recording=seen, sha256=test.sha256)) is not None) is expected
    assert common_with(test, TrainingData(recording=seen, sha256="another")) is None


def learned(folder, tracker="static-map", site="room", grid="1x1"):
    place = {"site": site, "grid": grid, "period_s": 0.1, "world_T_grid": (0.0, 0.0)}
    card = Card(tracker=tracker, **place, seed=0, command=str(folder), train=())
    save_weights(weights_path(folder, tracker, site), card, {})


def test_weights_are_found_in_the_given_folder_then_the_users_then_the_package(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    assert user_weights_folder() == tmp_path / "gridtrack" / "weights"
    assert find_weights("no-such-tracker", "room", None) is None
    learned(user_weights_folder())
    (tmp_path / "given").mkdir()
    assert find_weights("static-map", "room", tmp_path / "given").card.command == str(user_weights_folder())
    learned(tmp_path / "given")
    assert find_weights("static-map", "room", tmp_path / "given").card.command == str(tmp_path / "given")
    assert find_weights("static-map", "elsewhere", tmp_path / "given", "site") is None


def test_weights_of_a_site_choose_no_thresholds_at_another_one(record, train, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "home"))
    elsewhere = record("elsewhere", wall_m=2.2, stretches={}, site="elsewhere")
    chosen_there = {"recordings": (str(record()),), "validation": f"{elsewhere}@4s-9s", "out": tmp_path / "run"}
    learned(tmp_path / "site", grid=str(plan_split(str(record()), None, SECOND).test.grid))
    with pytest.raises(
        ConfigurationError,
        match=r"^static-map: its weights are of the site 'room', and its thresholds would be chosen on"
        r" elsewhere\.mcap@4s-9s of the site 'elsewhere': name a --validation stretch of the site 'room', or compare"
        r" general weights \(--tracker static-map:card=general\)$",
    ):
        resolve(CompareSettings(trackers=("persistence", "static-map"), weights=tmp_path / "site", **chosen_there))
    resolve(CompareSettings(trackers=("persistence",), **chosen_there))
    train("site", "static-map", f"{elsewhere}@10s-15s", validation=(f"{elsewhere}@15s-20s",), general=True)
    general = CompareSettings(
        trackers=("static-map:card=general",), no_floors=True, weights=tmp_path / "site", **chosen_there
    )
    (trial,) = resolve(general).trials
    assert trial.weights.card.general


@pytest.mark.parametrize("site", ["Hall A", "../room"])
def test_a_row_at_a_site_with_a_name_that_is_no_file_name_has_the_general_weights_of_its_folder(site, tmp_path):
    with pytest.raises(
        WeightsError, match=rf"^{tmp_path}: no weights of .* \({tmp_path}/static-map/general.toml is missing"
    ):
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


def test_training_on_the_unnamed_test_stretch_is_reported(record, tmp_path):
    path, said = str(record(stretches={"test": (9.0, None)})), []
    for train in (f"{path}@8s-12s", f"{path}@test", f"{path}@0s-3s"):
        recipe = Recipe(tracker="static-map", recordings=(train,), validation=(f"{path}@4s-8s",), out=tmp_path)
        train_tracker(recipe, said.append)
    assert [line for line in said if "'test'" in line] == [
        "room.mcap@8s-12s has frames of the recording's stretch 'test' (9s-): these weights cannot be compared there;"
        " name room.mcap@test if that is meant"
    ]


def test_a_training_on_a_recording_with_stretches_and_none_to_train_on_is_refused(record, tmp_path):
    half = str(record("half", stretches={"test": (0.0, 5.0)}))
    with pytest.raises(ConfigurationError, match=r"no stretch 'train'; name one of its own \(.*@test\), or seconds"):
        train_tracker(Recipe(tracker="static-map", recordings=(half,), out=tmp_path))


def test_thresholds_of_another_recording_are_chosen_on_its_own_strata(record):
    here, elsewhere = record("here"), record("elsewhere", wall_m=2.2)
    split = plan_split(str(here), f"{elsewhere}@4s-9s", SECOND)
    regions, observation = split.regions(), next(split.test.observations())
    kinds, on_validation = (one.of(observation).cell_kinds for one in (regions.test, regions.validation))
    assert (kinds != on_validation).any()
    assert (on_validation == cell_kinds(plan_split(str(elsewhere), None, SECOND))).all()
    own = plan_split(str(here), None, SECOND).regions()
    assert own.validation is own.test


@pytest.mark.parametrize(
    ("how", "why"),
    [
        ({"grid": "60x0.2"}, "made for grid 100x0.1@-2,-4.5, but this is 60x0.2@-6,-6"),
        ({"rate_hz": 5.0}, "made for a period of 0.1 s (10 Hz), but this stream's is 0.2 s"),
    ],
)
def test_weights_of_a_site_that_do_not_fit_grid_or_rate_give_way_to_general_ones_and_a_notice(how, why, tmp_path):
    demo, out = str(packaged_recording("leg_tracker")), tmp_path / "run"
    chosen = {
        "recordings": (f"{demo}@114s-124s",),
        "validation": f"{demo}@75s-85s",
        "horizon_s": 1.0,
        "out": out,
        "no_floors": True,
        **how,
    }
    plan = resolve(CompareSettings(trackers=("kalman", "site=kalman:card=site"), **chosen))
    assert [trial.weights.kind for trial in plan.trials] == ["general", "site"]
    said = f"kalman on leg_tracker@114s-124s: its weights of the site 'leg_tracker' are {why}; general weights are"
    assert [line.startswith(said) for line in map(str, plan.notices) if "as with card=general" in line] == [True]


def test_a_large_cost_is_estimated_before_anything_runs(tmp_path):
    demo = str(packaged_recording("leg_tracker"))

    def said(grid: str, *stretches: str, **other: str) -> list[str]:
        recordings = tuple(f"{demo}@{stretch}" for stretch in stretches)
        chosen = {"recordings": recordings, "trackers": ("blank",), "no_floors": True, "out": tmp_path / "run"}
        plan = resolve(CompareSettings(**chosen, grid=grid, **other))
        return [line for line in map(str, plan.notices) if "scoring" in line]

    (line,) = said("2000x0.01", "114s-124s")
    assert "scoring 160 forecasts, the largest of 26 steps on 2000 x 2000 cells, takes about 14 minutes" in line
    (line,) = said("2000x0.01", "114s-124s", "104s-114s", validation=f"{demo}@75s-85s")
    assert "scoring 165 forecasts" in line, "thresholds are chosen once for both recordings"
    assert said("60x0.2", "114s-124s") == []
