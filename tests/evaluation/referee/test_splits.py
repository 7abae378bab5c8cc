"""Splits: the test stretch, the validation stretch, and refused overlaps."""

import pytest

from gridtrack.common.errors import ConfigurationError
from gridtrack.common.grid import GridSpec
from gridtrack.evaluation.referee.splits import Sampling, common_with, plan_split
from gridtrack.evaluation.referee.strata import CELL_KINDS
from gridtrack.evaluation.runs.plan import resolve
from gridtrack.evaluation.runs.recipe import Recipe
from gridtrack.evaluation.runs.run_record import description_of
from gridtrack.evaluation.runs.train import train_tracker
from gridtrack.recordings import import_recording, open_recording, packaged_recording
from gridtrack.recordings.formats.native import NativeRecording
from gridtrack.recordings.recording_info import NO_MOTION
from gridtrack.trackers.training.card import TrainingData

pytestmark = pytest.mark.usefixtures("trackers_here")

SECOND = Sampling(horizon_s=1.0, every_s=0.5)


def test_the_named_test_and_validation_stretches_are_the_default(record):
    split = plan_split(str(record()), None, SECOND)
    assert (split.name, split.test.name, split.validation.name) == ("room", "room.mcap@test", "room.mcap@validation")
    assert (split.steps, split.every) == (10, 5)
    assert description_of(split).horizons_s == tuple(round(0.1 * n, 1) for n in range(11))
    assert split.notices == ()


@pytest.mark.parametrize(
    ("stretches", "part", "frames", "says"),
    [
        ({}, "", 200, "the thresholds of a tracker come from its weights' card"),
        (
            None,
            "@8s-20s",
            120,
            "shares frames with its validation room.mcap@validation, so the thresholds of a tracker",
        ),
        ({"validation": (0.0, 2.5), "test": (9.0, None)}, "", 110, "25 frames leave nothing to score"),
    ],
    ids=["no stretches", "the test's frames", "too short"],
)
def test_without_frames_to_choose_thresholds_on_a_notice_says_so(record, stretches, part, frames, says):
    split = plan_split(f"{record(stretches=stretches)}{part}", None, SECOND)
    assert (len(split.test), split.validation, says in split.notices[0].text) == (frames, None, True)


def test_a_range_is_part_of_the_name_of_its_split(record):
    split = plan_split(f"{record()}@9s-20s", None, SECOND)
    assert (split.name, len(split.test)) == ("room@9s-20s", 110)
    assert split.validation.name == "room.mcap@validation"


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
    ("test", "validation", "sampling", "message"),
    [
        ("@8s-20s", "@0s-8.5s", SECOND, r"shares frames with its validation room\.mcap@0s-8\.5s: name"),
        ("", "@0s-2.5s", SECOND, "name another --validation"),
        ("@9s-12s", "", SECOND, r"30 frames leave nothing to score after 20 frames of warm-up and with 10 steps ahead"),
        ("", "", Sampling(horizon_s=0.04, every_s=1.0), r"a horizon of 0\.04 s is less than half a frame"),
        ("", "", Sampling(60.0, 1.0, GridSpec(1000, 0.01)), r"forecasts of 600 steps on 1000 x 1000 cells take"),
    ],
)
def test_stretches_that_cannot_be_scored_are_refused_in_one_line(record, test, validation, sampling, message):
    path = record()
    with pytest.raises(ConfigurationError, match=message):
        plan_split(f"{path}{test}", validation and f"{path}{validation}", sampling)


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


def test_two_recordings_with_one_name_are_refused(record, settings):
    path = str(record())
    with pytest.raises(ConfigurationError, match="would both be called 'room'"):
        resolve(settings("blank", recordings=(path, path)))


def test_a_copy_of_a_recording_is_refused_because_its_frames_are_no_more_evidence(record, settings):
    path = record()
    copied = path.with_name("copy.mcap")
    copied.write_bytes(path.read_bytes())
    with pytest.raises(ConfigurationError, match=r"room.mcap@test and copy.mcap@test are of one source and have 11 s"):
        resolve(settings("blank", recordings=(str(path), str(copied))))


def test_an_import_under_another_name_is_of_the_same_source_and_stretches_that_overlap_are_refused(
    record, settings, tmp_path
):
    path = record()
    imported = import_recording(path, tmp_path / "other.mcap", site="elsewhere").path
    again = import_recording(imported, tmp_path / "again.mcap").path
    for other in (imported, again):
        overlapping = settings("blank", recordings=(f"{path}@0s-10s", f"{other}@8s-20s"))
        with pytest.raises(ConfigurationError, match=r"@0s-10s and .*@8s-20s are of one source and have 2 s in common"):
            resolve(overlapping)
    apart = settings("blank", recordings=(f"{path}@0s-10s", f"{again}@10s-20s"))
    assert len({description_of(split).source_sha256 for split in resolve(apart).splits}) == 1


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


def test_a_large_cost_is_estimated_before_anything_runs(settings):
    demo = str(packaged_recording("leg_tracker"))

    def said(grid: str, *stretches: str, **other: str) -> list[str]:
        recordings = tuple(f"{demo}@{stretch}" for stretch in stretches)
        chosen = settings("blank", recordings=recordings, grid=grid, horizon_s=2.5, every_s=None, **other)
        return [line for line in map(str, resolve(chosen).notices) if "scoring" in line]

    (line,) = said("2000x0.01", "114s-124s")
    assert "scoring 160 forecasts, the largest of 26 steps on 2000 x 2000 cells, takes about 14 minutes" in line
    (line,) = said("2000x0.01", "114s-124s", "104s-114s", validation=f"{demo}@75s-85s")
    assert "scoring 165 forecasts" in line, "thresholds are chosen once for both recordings"
    assert said("60x0.2", "114s-124s") == []
