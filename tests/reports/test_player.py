"""Moments on the page: packed without loss at their quantisation, within the budget, and omissions are named."""

import base64
import zlib
from dataclasses import replace

import numpy as np
import pytest

from gridtrack.evaluation.referee.samples import SAMPLES, KeptObject, read_samples
from gridtrack.reports import page as page_module
from gridtrack.reports import player
from gridtrack.reports.moments import CALLED, IN_MOTION, PACKED_LEVELS, forecast_planes, pack_moment
from gridtrack.reports.page import render_report
from gridtrack.reports.scripts import data_in_page, json_in_page

from scenes.edited_run import edit, edited
from scenes.report_page import data_of, moments_of


def planes_of(moment, size):
    return np.frombuffer(zlib.decompress(base64.b64decode(moment["cells"])), np.uint8).reshape(-1, size, size)


@pytest.fixture
def sample(run_folder):
    return list(read_samples(run_folder / "fair@crossing" / SAMPLES))[10]


@pytest.fixture(scope="module")
def page(run_folder, tmp_path_factory):
    return render_report([run_folder], tmp_path_factory.mktemp("player")).read_text("utf-8")


def test_packed_values_are_read_back_exactly_at_their_quantisation(sample):
    rng = np.random.default_rng(3)
    forecast = rng.random(sample.forecast.shape, dtype=np.float32)
    state = rng.integers(0, 5, forecast.shape).astype(np.uint8)
    in_motion = (state < 2) & (rng.random(forecast.shape) < 0.5)
    thresholds = [0.2, 0.5, 0.9]
    packed = pack_moment(
        replace(sample, state=state, in_motion=in_motion), [None, forecast_planes(forecast, thresholds)]
    )
    planes = planes_of({"cells": packed}, 32)
    assert len(planes) == 1 + 3 + 2 * 3
    assert np.array_equal(planes[0] > 0, sample.visible)
    assert np.array_equal(planes[0] == 2, sample.occupied)
    assert np.array_equal(planes[1:4] & 7, state)
    assert np.array_equal((planes[1:4] & IN_MOTION) > 0, in_motion)
    assert not planes[4:7].any(), "a tracker without a forecast"
    assert (
        np.abs((planes[7:] & (PACKED_LEVELS - 1)) / (PACKED_LEVELS - 1) - forecast).max()
        <= 0.5 / (PACKED_LEVELS - 1) + 1e-6
    )
    for h, threshold in enumerate(thresholds):
        assert np.array_equal((planes[7 + h] & CALLED) > 0, forecast[h] >= np.float32(threshold))


def test_the_page_has_every_kept_moment_with_the_counts_of_the_scores(page, run_folder):
    (data,) = moments_of(page)
    kept = list(read_samples(run_folder / "fair@crossing" / SAMPLES))
    assert (data["recording"], data["size"], data["horizons_s"]) == ("crossing", 32, [0.5, 1.0, 2.0])
    assert len(data["moments"]) == len(kept) == 20
    assert data["kept"] == 20
    fair = data["trackers"].index("fair")
    for sample, moment in zip(kept, data["moments"], strict=True):
        assert moment["t"] == pytest.approx((sample.stamp_ns - kept[0].stamp_ns) / 1e9)
        planes = planes_of(moment, 32)
        for h in range(3):
            target, forecast = planes[1 + h], planes[4 + 3 * fair + h]
            in_motion, called = (target & IN_MOTION) > 0, (forecast & CALLED) > 0
            occupied = (target & 7) == 1
            counts = [in_motion & called & occupied, in_motion & called & ~occupied, in_motion & ~called & occupied]
            assert [int(mask.sum()) for mask in counts] == moment["counts"][h][fair]


def test_a_moment_that_a_tracker_does_not_have_says_so(page):
    (data,) = moments_of(page)
    unlucky = data["trackers"].index("unlucky")
    missing = ["unlucky" in moment["missing"] for moment in data["moments"]]
    assert missing == [False] * 7 + [True] * 13
    assert data["moments"][-1]["counts"][0][unlucky] is None


def test_a_budget_keeps_the_first_moments_and_at_least_one(page, run_folder, tmp_path, monkeypatch):
    scores = {key: value for key, value in data_of(page).items() if key != "players"}
    monkeypatch.setattr(page_module, "PAGE_BYTES", len(data_in_page(scores)) + 6000)
    (data,) = moments_of(render_report([run_folder], tmp_path).read_text("utf-8"))
    shown = len(data["moments"])
    assert 1 < shown < 20
    assert sum(len(json_in_page(moment)) for moment in data["moments"]) <= 6000
    assert data["kept"] == 20, "the page knows how many there were"
    monkeypatch.setattr(page_module, "PAGE_BYTES", 0)
    (data,) = moments_of(render_report([run_folder], tmp_path).read_text("utf-8"))
    assert len(data["moments"]) == 1


def test_objects_are_with_their_tracker(run_folder, tmp_path, monkeypatch):
    tracked = KeptObject(7, (1.0, 2.0, 0.5, 0.6, 0.4), (1.25, -0.5))

    def with_objects(path):
        return (replace(s, objects=(tracked,) * 99 if "fair" in str(path) else ()) for s in read_samples(path))

    monkeypatch.setattr("gridtrack.reports.player.read_samples", with_objects)
    (data,) = moments_of(render_report([run_folder], tmp_path).read_text("utf-8"))
    objects = dict(zip(data["trackers"], data["moments"][3]["objects"], strict=True))
    assert objects["fair"] == [[7, 1.0, 2.0, 0.5, 0.6, 0.4, 1.25, -0.5]] * player.OBJECTS_SHOWN
    assert objects["good"] == []


def test_times_come_from_the_recording_and_horizons_from_its_steps(run_folder, tmp_path):
    """Stretch from 100 s on, 20 frames of warm-up, at 7.5 Hz: 1 s ahead is step 8, 1.0667 s."""
    horizons_s = [round(n / 7.5, 6) for n in range(21)]
    slower = {"horizons_s": horizons_s, "warm_up_frames": 20}
    later = slower | {"stretch_s": [100.0, None]}
    run = edited(run_folder, tmp_path / "run", lambda summary: summary["recordings"]["crossing"].update(slower))
    edit(run, lambda record: record["configuration"]["recordings"]["crossing"].update(later), "run.json")
    page = render_report([run]).read_text("utf-8")
    (data,) = moments_of(page)
    assert data["moments"][0]["t"] == pytest.approx(100 + 20 / 7.5, abs=1e-3)
    assert data["horizons_s"] == [horizons_s[4], horizons_s[8], horizons_s[15]]
    assert "1.07 s later" in page, "the still picture"
