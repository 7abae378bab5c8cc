"""Forecasts from a file or in a bag score as the tracker that made them; a file that cannot be right is refused."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from gridtrack.common.errors import ConfigurationError
from gridtrack.common.forecast_file import write_forecasts
from gridtrack.common.geometry import SE2
from gridtrack.evaluation.runs.jobs import JobOrder, SharedInputs
from gridtrack.evaluation.runs.plan import resolve
from gridtrack.evaluation.runs.sums import SUMS_FILE
from gridtrack.evaluation.scores.robot import CAR
from gridtrack.recordings.outputs.conversion import write_outputs
from gridtrack.recordings.stream import open_stream
from gridtrack.reports.run import read_runs
from gridtrack.reports.table import headline_tables
from gridtrack.trackers import registry
from gridtrack.trackers.baselines import PersistenceTracker
from gridtrack.trackers.contract import stream_of

from scenes import drive_bag as made
from scenes.output_bag import Outputs
from scenes.room import trial_of

STEPS = 10
WEIGHTS = Path(__file__).parents[3] / "data" / "weights" / "stationary" / "general.toml"


def arrays_of(recording, *, moved=0):
    """The forecasts of `stationary` at every frame of two stretches, in the world; `moved`: late by so many frames."""
    kind = registry.load("stationary")
    occupancy, stamps, origins = [], [], []
    for stretch in ("validation", "test"):
        stream = open_stream(f"{recording}@{stretch}")
        tracker = kind(stream_of(stream, WEIGHTS), kind.Options())
        tracker.reset(0)
        for frame in stream:
            tracker.update(frame)
            occupancy.append(tracker.predict(STEPS).occupancy)
            stamps.append(frame.stamp_ns)
            origins.append(np.add(stream.grid.origin, (frame.world_T_grid.x, frame.world_T_grid.y)))
    return {
        "occupancy": np.stack(occupancy[: len(occupancy) - moved]),
        "stamp_ns": np.array(stamps[moved:]),
        "lead_s": np.arange(STEPS + 1) * stream.period_s,
        "cell_m": np.float64(stream.grid.cell_m),
        "origin_xy": np.stack(origins[: len(origins) - moved]),
        "note": np.array("objects + constant velocity"),
    }


@pytest.fixture
def files(tmp_path, record):
    """`files(changes, **record)`: the row of a file with the changed arrays of a recording, and the recording."""

    def files(changes=lambda arrays: {}, *, moved=0, **of_room):
        recording, path = record(**of_room), tmp_path / "mine.npz"
        arrays = arrays_of(recording, moved=moved)
        write_forecasts(path, arrays | changes(arrays))
        return f"mine=recorded:file={path}", (str(recording),)

    return files


def turned(arrays):
    """The arrays in the frame of a sensor that is turned by 90 degrees, indexed [x, y]."""
    count, corner = len(arrays["stamp_ns"]), arrays["origin_xy"]
    pose = np.column_stack([np.zeros((count, 2)), np.full(count, np.pi / 2)])
    side = arrays["occupancy"].shape[-1] * float(arrays["cell_m"])
    # x of the sensor is y of the world, and y of the sensor is -x of the world
    planes = np.rot90(arrays["occupancy"], axes=(2, 3))
    return {
        "occupancy": np.ascontiguousarray(planes.swapaxes(2, 3)),
        "axes": np.array("xy"),
        "frame": np.array("sensor"),
        "pose": pose,
        "origin_xy": np.column_stack([corner[:, 1], -corner[:, 0] - side]),
    }


def with_border(arrays):
    """The arrays on a larger grid."""
    border = ((0, 0), (0, 0), (3, 5), (2, 6))
    cell = float(arrays["cell_m"])
    return {
        "occupancy": np.pad(arrays["occupancy"], border),
        "origin_xy": arrays["origin_xy"] - np.array([2, 3]) * cell,
    }


@pytest.mark.parametrize(
    ("changes", "speed"),
    [(lambda arrays: {}, 0.0), (lambda arrays: {}, 0.15), (turned, 0.15), (with_border, 0.0)],
    ids=["at rest", "moving", "turned sensor", "larger"],
)
def test_a_file_scores_exactly_as_the_tracker_that_made_it(compare, files, tmp_path, changes, speed):
    row, recordings = files(changes, speed=speed)
    summary = compare("live=stationary", row, recordings=recordings)
    mine, live = (trial_of(summary, label) for label in ("mine", "live"))
    assert (mine.outcome, mine.frames_scored, mine.frames_missing) == ("ok", live.frames_scored, 0)
    of_rows = [(tmp_path / "run" / f"{label}@room" / SUMS_FILE).read_bytes() for label in ("mine", "live")]
    assert of_rows[0] == of_rows[1]
    assert (summary.trackers["mine"].role, mine.made_by) == ("recorded", "objects + constant velocity")
    marks = {row.label: row.remark for row in headline_tables(read_runs([tmp_path / "run"]))[0].rows}
    assert marks["mine"].endswith("objects + constant velocity, recorded: causality not checked")


def test_frames_without_a_forecast_are_counted_not_scored_and_too_many_give_no_rank(compare, files, progress, tmp_path):
    """The frames of a second lose their forecasts; the ones before are too old after a second."""

    def without(gap_s):
        def changes(arrays):
            since_s = (arrays["stamp_ns"] - arrays["stamp_ns"][-1]) / 1e9
            kept = (since_s < -6.0 - gap_s) | (since_s > -6.0)
            return {name: arrays[name][kept] for name in ("occupancy", "stamp_ns", "origin_xy")}

        return changes

    row, recordings = files(without(1.5))
    mine = trial_of(compare(row, recordings=recordings), "mine")
    assert (mine.frames_missing, mine.ranked) == (1, True)
    assert any("recorded forecasts, frames without one: 1 of" in line for line in progress.notes)
    row, recordings = files(without(4.0))
    mine = trial_of(compare(row, recordings=recordings, out=tmp_path / "other"), "mine")
    assert (mine.frames_missing, mine.ranked) == (6, False)
    assert mine.reason == f"6 of {mine.frames_expected} frames have no recorded forecast"


def test_a_cell_without_a_forecast_is_wrong_and_not_free(compare, files, tmp_path):
    row, recordings = files(lambda arrays: {"occupancy": np.where(arrays["occupancy"] < 0.5, np.nan, 1.0).astype("f4")})
    blank = trial_of(compare("blank", row, recordings=recordings), "mine").at("visible", "f1", "precision", 0).value
    row, recordings = files(lambda arrays: {"occupancy": np.where(arrays["occupancy"] < 0.5, 0.0, 1.0).astype("f4")})
    full = (
        trial_of(compare(row, recordings=recordings, out=tmp_path / "full"), "mine")
        .at("visible", "f1", "precision", 0)
        .value
    )
    assert blank < 0.2 < full


def test_the_thresholds_without_a_forecast_of_the_validation_stretch_need_no_labels(compare, files):
    def test_stretch_alone(arrays):
        late = arrays["stamp_ns"] > arrays["stamp_ns"][0] + 9e9
        return {name: arrays[name][late] for name in ("occupancy", "stamp_ns", "origin_xy")}

    row, recordings = files(test_stretch_alone)
    mine = trial_of(compare(row, recordings=recordings), "mine")
    assert mine.threshold_chosen_on == "its earlier forecasts, without labels"
    chosen, label_free = (mine.at("visible", "f1", name, 5).value for name in ("f1", "label_free"))
    assert chosen == label_free


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        (lambda arrays: {"occupancy": arrays["occupancy"][..., ::-1]}, "fits the frames better mirrored in x"),
        (lambda arrays: {"axes": np.array("xy")}, "fits the frames better transposed"),
        (
            lambda arrays: {"stamp_ns": arrays["stamp_ns"] + 10**12},
            "no forecast of any scored frame of room: its stamps",
        ),
        (lambda arrays: {"occupancy": 2 * arrays["occupancy"] + 1}, "occupancy of forecast .* is outside"),
    ],
    ids=["mirrored", "transposed", "clock", "values"],
)
def test_a_file_that_cannot_be_right_is_refused_before_anything_runs(settings, files, changes, line):
    row, recordings = files(changes)
    with pytest.raises(Exception, match=line) as raised:
        resolve(settings(row, recordings=recordings))
    assert raised.value.exit_code == 2


def test_a_forecast_that_is_late_by_a_frame_is_a_notice_and_one_that_is_early_is_refused(settings, files):
    row, recordings = files(moved=1)
    notices = list(map(str, resolve(settings(row, recordings=recordings)).notices))
    assert any("their first step fits the frames better one frame earlier" in line for line in notices), notices
    row, recordings = files(lambda arrays: {"stamp_ns": arrays["stamp_ns"] - 10**8})
    with pytest.raises(ConfigurationError, match="one frame later"):
        resolve(settings(row, recordings=recordings))


def test_a_row_needs_a_file_and_a_folder_has_one_for_each_recording(settings, files, tmp_path):
    with pytest.raises(ConfigurationError, match="mine: it needs a file: mine=recorded:file=FILE"):
        resolve(settings("mine=recorded"))
    _, recordings = files()
    folder = tmp_path / "all"
    folder.mkdir()
    with pytest.raises(ConfigurationError, match=r"has no room\.npz, the forecasts of room"):
        resolve(settings(f"mine=recorded:file={folder}", recordings=recordings))
    (tmp_path / "mine.npz").rename(folder / "room.npz")
    plan = resolve(settings(f"mine=recorded:file={folder}", recordings=recordings))
    assert plan.trials[0].recorded == folder / "room.npz"
    assert len(plan.trials[0].identity().file_sha256) == 64


def test_another_machine_runs_the_same_trial_with_the_robot_of_the_run(settings, files, tmp_path):
    row, recordings = files()
    plan = resolve(settings(row, recordings=recordings, robot=CAR, seed=3))
    (here,) = plan.trials
    shared = SharedInputs(plan.settings, lambda text: None, tmp_path)
    order = JobOrder.read(JobOrder.of(here, shared).model_dump_json(by_alias=True))
    there = order.row.trial(order.split(), order.settings)
    assert (there.robot, there.scores, there.seed) == (CAR, here.scores, 3)
    assert there.file_sha256 == here.file_sha256 != ""


ROS = made.Ros(2)
OUT = Outputs(ROS)


def scans(sway):
    """Ten seconds of a laser at rest in a round room, in which something walks to and fro by `sway` radians."""
    angles = made.FRONT.angle_min + np.arange(made.FRONT.beams) * made.FRONT.angle_increment
    for at_ms in range(0, 10_000, 100):
        near = np.abs(angles - sway * math.sin(at_ms / 1200)) < 0.08
        yield ROS.laser(at_ms, np.where(near, 1.6, 6.0).astype(np.float32), made.FRONT)


def test_occupancy_grids_score_as_the_tracker_that_published_them(compare, trackers_here, tmp_path):
    stream = open_stream(ROS.write(tmp_path / "scans", scans(sway=0.8)))
    tracker, corner = PersistenceTracker(stream_of(stream), PersistenceTracker.Options()), SE2(*stream.grid.origin)
    tracker.reset(0)
    messages, leads_s = list(scans(sway=0.8)), (0.0, 0.5, 1.0)
    for number, frame in enumerate(stream):
        tracker.update(frame)
        planes = 100 * tracker.predict(10).occupancy.astype(int)  # of 0 and 1: percentages do not round them
        for lead_s in leads_s:
            plane, topic = planes[round(10 * lead_s)], f"/pred_{10 * lead_s:.0f}"
            messages.append(OUT.grid(topic, 100 * number, plane, corner, cell_m=stream.grid.cell_m, delay_ms=0))
    bag, mine = ROS.write(tmp_path / "bag", messages), tmp_path / "mine.npz"
    write_outputs(bag, mine, grid=tuple(f"/pred_{10 * lead_s:.0f}={lead_s}s" for lead_s in leads_s))
    rows, half = ("persistence", f"mine=recorded:file={mine}"), {"recordings": (f"{bag}@5s-10s",)}
    summary = compare(*rows, **half, validation=f"{bag}@0s-5s")
    assert trial_of(summary, "mine", "bag@5s-10s").frames_scored >= 3
    one, other = ((tmp_path / "run" / f"{label}@bag@5s-10s" / SUMS_FILE) for label in ("persistence", "mine"))
    assert one.read_bytes() == other.read_bytes()


def test_the_width_is_fitted_on_the_validation_stretch(tmp_path):
    """It follows the errors of the positions: an outline that is too sharp is surer than it can be."""
    draw, given = np.random.default_rng(1), {"objects": "/objects", "horizon_s": 1.0}
    fitted_m = []
    for number, error_m in enumerate((0.0, 0.3)):
        ahead = [SE2(1.7 + x, y) for x, y in draw.normal(0.0, error_m, (100, 2))]
        messages = [
            OUT.objects(100 * n, OUT.car(at, (0.0, 0.0), label=7, size=(0.2, 0.2))) for n, at in enumerate(ahead)
        ]
        bag = ROS.write(tmp_path / f"bag-{number}", [*scans(sway=0.0), *messages])
        _, lines = write_outputs(bag, tmp_path / f"fitted-{number}.npz", **given, validation="0s-5s")
        (line,) = (line for line in lines if "--width" in line)
        assert f": the least log loss of 85 predicted frames of {bag.name}@0s-5s" in line
        fitted_m.append(float(line.split()[2]))
    assert fitted_m[0] <= 0.2 < fitted_m[1]
    _, lines = write_outputs(bag, tmp_path / "default.npz", **given)
    assert any(line.startswith("--width is 0.2 m, the default") for line in lines)
