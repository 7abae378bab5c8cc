"""Outputs in a bag, grids and objects, score exactly as the forecasts that they were made from."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gridtrack.common.forecast_file import write_forecasts
from gridtrack.common.geometry import SE2
from gridtrack.evaluation.runs.sums import SUMS_FILE
from gridtrack.recordings.outputs.conversion import write_outputs
from gridtrack.recordings.stream import open_stream
from gridtrack.trackers import registry
from gridtrack.trackers.contract import stream_of

from scenes import drive_bag as made
from scenes.output_bag import Outputs, box_cells

ROS = made.Ros(2)
CELL_M, SIZE = 0.2, 100
LEADS_S = np.arange(11) / 10
CAR = SE2(3.1, 1.1, math.pi / 2)


def scans(sway=0.8):
    """Ten seconds of a laser at rest in a round room, in which something walks to and fro by `sway` radians."""
    angles = made.FRONT.angle_min + np.arange(made.FRONT.beams) * made.FRONT.angle_increment
    for at_ms in range(0, 10_000, 100):
        near = np.abs(angles - sway * math.sin(at_ms / 1200)) < 0.08
        yield ROS.laser(at_ms, np.where(near, 1.6, 6.0).astype(np.float32), made.FRONT)


def write_bag(folder, messages=()):
    return ROS.write(folder, [*scans(), *messages])


def grids(planes, topic):
    """Planes of P(occupied), one a frame, as occupancy grids that are known at its stamp."""
    corner = SE2(-CELL_M * SIZE / 2, -CELL_M * SIZE / 2)
    for number, plane in enumerate(planes):
        yield Outputs(ROS).grid(topic, 100 * number, np.rint(100 * plane), corner, cell_m=CELL_M, delay_ms=0)


def forecasts(stream, name):
    """The forecasts (N, T, M, M) of a tracker at every frame."""
    kind = registry.load(name)
    tracker = kind(stream_of(stream), kind.Options())
    tracker.reset(0)
    found = []
    for frame in stream:
        tracker.update(frame)
        found.append(tracker.predict(10).occupancy)
    return np.stack(found)


@pytest.fixture
def sums(compare, tmp_path):
    """`sums(bag, *rows)`: the stored sums of each row on the second half of the bag, as bytes."""

    def sums(bag, *rows):
        summary = compare(*rows, recordings=(f"{bag}@5s-10s",), validation=f"{bag}@0s-5s")
        trials = {label: next(iter(row.recordings.values())) for label, row in summary.trackers.items()}
        assert {trial.outcome for trial in trials.values()} == {"ok"}
        assert all(trial.frames_scored >= 3 for trial in trials.values())
        return [next((tmp_path / "run").glob(f"{label}@*/{SUMS_FILE}")).read_bytes() for label in trials]

    return sums


def test_occupancy_grids_score_as_the_tracker_that_published_them(sums, tmp_path):
    planes = forecasts(open_stream(write_bag(tmp_path / "scans")), "persistence")
    assert set(np.unique(planes)) == {0.0, 1.0}  # else percentages round them
    topics = {f"/pred_{round(10 * lead):02d}": lead for lead in (0.0, 0.5, 1.0)}
    bag = write_bag(
        tmp_path / "bag", (m for topic, lead in topics.items() for m in grids(planes[:, round(10 * lead)], topic))
    )
    named = {"grid": tuple(f"{topic}={lead}s" for topic, lead in topics.items())}
    write_outputs(bag, tmp_path / "mine.npz", **named)
    live, mine = sums(bag, "persistence", f"mine=recorded:file={tmp_path / 'mine.npz'}")
    assert mine == live


def test_predicted_objects_score_as_their_cells(sums, tmp_path):
    out, frames = Outputs(ROS), list(open_stream(write_bag(tmp_path / "scans")))
    messages = [out.objects(100 * number, out.car(CAR, (2.0, 0.0)), delay_ms=0) for number in range(len(frames))]
    bag = write_bag(tmp_path / "bag", messages)
    write_outputs(bag, tmp_path / "mine.npz", objects="/objects", width_m=0.0, horizon_s=1.0)
    moved = [box_cells((2.1, 4.1), (-0.9 + 2 * lead, 3.1 + 2 * lead), CELL_M, SIZE) for lead in LEADS_S]
    visible, occupied = (np.cumsum([getattr(f, name) for f in frames], axis=0) for name in ("visible", "occupied"))
    rate = occupied / np.maximum(visible, 1)
    static = np.rint(255 * np.where(rate > 0.5, rate, 0.0)).astype(np.uint8)
    known = {
        "occupancy": np.maximum(static[:, None], 255 * np.array(moved, np.uint8)),
        "stamp_ns": np.array([frame.stamp_ns for frame in frames]),
        "lead_s": LEADS_S,
        "cell_m": np.float64(CELL_M),
        "origin_xy": np.full(2, -CELL_M * SIZE / 2),
    }
    write_forecasts(tmp_path / "known.npz", known)
    rows = [f"{name}=recorded:file={tmp_path / name}.npz" for name in ("known", "mine")]
    live, mine = sums(bag, *rows)
    assert mine == live


def test_the_width_is_fitted_on_the_validation_stretch(tmp_path):
    """It follows the errors of the positions: an outline that is too sharp is surer than it can be."""
    out, draw, given = Outputs(ROS), np.random.default_rng(1), {"objects": "/objects", "horizon_s": 1.0}
    fitted_m = []
    for number, error_m in enumerate((0.0, 0.3)):
        ahead = [SE2(1.7 + x, y) for x, y in draw.normal(0.0, error_m, (100, 2))]
        messages = [
            out.objects(100 * n, out.car(at, (0.0, 0.0), label=7, size=(0.2, 0.2))) for n, at in enumerate(ahead)
        ]
        bag = ROS.write(tmp_path / f"bag-{number}", [*scans(sway=0.0), *messages])
        _, lines = write_outputs(bag, tmp_path / f"fitted-{number}.npz", **given, validation="0s-5s")
        (line,) = (line for line in lines if "--width" in line)
        assert f": the least log loss of 85 predicted frames of {bag.name}@0s-5s" in line
        fitted_m.append(float(line.split()[2]))
    assert fitted_m[0] <= 0.2 < fitted_m[1]
    _, lines = write_outputs(bag, tmp_path / "default.npz", **given)
    assert any(line.startswith("--width is 0.2 m, the default") for line in lines)
