"""The cache of trainings: a second training reads no recording again, and no `fit` can damage it."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest

from gridtrack.evaluation.runs import stretch_files
from gridtrack.evaluation.runs.fit_regions import StretchRegions, cell_kinds_for
from gridtrack.evaluation.runs.recipe import Recipe
from gridtrack.evaluation.runs.stretch_files import (
    STRETCHES_VERSION,
    StoredStretch,
    StretchFiles,
    stretch_cache,
    surveyed,
)
from gridtrack.evaluation.runs.train import train_tracker
from gridtrack.recordings import import_recording, open_recording
from gridtrack.recordings.formats.native import NativeRecording
from gridtrack.recordings.stream import GridStream, frame_digest, open_stream
from gridtrack.trackers.training.progress import Progress
from gridtrack.trackers.wire import WireError

from scenes import drive, truth_scene

pytestmark = pytest.mark.usefixtures("trackers_here")

VANDAL = '''
from gridtrack.trackers.baselines import StaticMapTracker
from gridtrack.trackers.contract import stream_of


class Vandal(StaticMapTracker):
    """Its training destroys every file that it was given, once it has learned from them."""

    @classmethod
    def fit(cls, task):
        super().fit(task)
        for source in (*task.train, *task.validation):
            task.objective(cls(stream_of(source, task.out), task.options), source, 1)
        for path in task.train[0]._path.parent.iterdir():
            path.write_bytes(b"destroyed")
'''


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """A cache of this test's own; `reported` has its lines."""
    monkeypatch.setattr("gridtrack.common.cache.user_cache_folder", lambda: tmp_path / "cache")
    reported: list[str] = []
    cache = stretch_cache(reported.append)
    cache.reported = reported
    return cache


def files_of(path, cache, folder, *stretches):
    folder.mkdir(exist_ok=True)
    streams = [GridStream(surveyed(open_recording(path), cache), stretch) for stretch in stretches or (None,)]
    return StretchFiles(streams, folder, cache), streams


def content_of(files, n=0):
    """The frames and regions of a stretch."""
    regions = StretchRegions.read(files.regions(n))
    frames = [frame_digest(frame) for frame in StoredStretch(files.frames(Progress())[n])]
    return frames, regions.moving.tolist(), regions.starts.tolist()


def test_a_second_training_reads_no_scan_of_the_same_recording(record, cache, tmp_path, monkeypatch):
    path = record()
    first = content_of(files_of(path, cache, tmp_path / "1", (0.0, 4.0))[0])
    monkeypatch.setattr(NativeRecording, "read", None)
    files, streams = files_of(path, cache, tmp_path / "2", (0.0, 4.0))
    assert content_of(files) == first
    assert len(streams[0]) == len(first[0])


@pytest.mark.parametrize("other", [{"stretch": (0.0, 5.0)}, {"grid": "30x0.2"}, {"rate_hz": 4.0}])
def test_another_stretch_grid_or_rate_is_stored_for_itself(record, cache, tmp_path, other):
    path = record()
    options = {"stretch": (0.0, 4.0)} | other
    content_of(files_of(path, cache, tmp_path, (0.0, 4.0))[0])
    grid = open_stream(path).grid.parse(options["grid"]) if "grid" in options else None
    stream = GridStream(open_recording(path), options["stretch"], grid=grid, rate_hz=options.get("rate_hz"))
    stored = StoredStretch(StretchFiles([stream], tmp_path, cache).frames(Progress())[0])
    assert [frame_digest(frame) for frame in stored] == [frame_digest(frame) for frame in stream]


def test_a_changed_recording_is_read_again(record, cache, tmp_path):
    near = content_of(files_of(record(wall_m=3.0), cache, tmp_path)[0])
    far = content_of(files_of(record(wall_m=3.5), cache, tmp_path)[0])
    assert near[0] != far[0]


def test_regions_are_made_when_they_are_asked_for(record, cache, tmp_path, monkeypatch):
    made = []
    store = stretch_files.store_regions
    monkeypatch.setattr(stretch_files, "store_regions", lambda s, *rest: made.append(s.name) or store(s, *rest))
    recipe = Recipe(tracker="static-map", recordings=(str(record()),), out=tmp_path)
    train_tracker(recipe, lambda _: None)
    assert made == ["room.mcap@validation"], "static-map asks for no score: those are for the thresholds"
    with pytest.raises(WireError, match="regions of stretch 2; there are 1"):
        files_of(record(), cache, tmp_path)[0].regions(2)


def test_kinds_of_cells_come_from_all_stretches_of_the_training(cache, tmp_path, monkeypatch):
    """Without truth: a rider who waits in the first stretch alone is not static where the training has both."""
    monkeypatch.setattr(truth_scene, "to_and_fro", lambda time_s, period_s, reach_m: 0.0 if time_s < 4 else reach_m)
    path = tmp_path / "waits.mcap"
    truth_scene.write_recording(path, seconds=12, with_truth=False)
    kinds = []
    for stretches in ([(0.0, 4.0)], [(0.0, 4.0), (4.0, 12.0)]):
        files, streams = files_of(path, cache, tmp_path / "fit", *stretches)
        kinds.append(files.kinds(0).cell_kinds)
        assert np.array_equal(kinds[-1], cell_kinds_for(streams[0], streams).cell_kinds)
    assert not np.array_equal(*kinds)


def test_a_fit_that_destroys_its_files_damages_nothing_that_is_kept(record, cache, tmp_path, install):
    install("vandal", {"vandal": "vandal:Vandal"}, {"vandal.py": VANDAL})
    path = record()
    lines: list[str] = []
    for name in ("vandal", "static-map"):
        train_tracker(Recipe(tracker=name, recordings=(str(path),), out=tmp_path / name), lines.append)
    assert not [line for line in lines if "damaged" in line]
    files, (stream, _) = files_of(path, cache, tmp_path / "after", "train", "validation")
    assert content_of(files)[0] == [frame_digest(frame) for frame in stream]
    assert not cache.reported


def test_a_training_reports_a_damaged_entry_and_makes_it_again(record, cache, tmp_path):
    recipe = Recipe(tracker="static-map", recordings=(str(record()),), out=tmp_path)
    arrays = train_tracker(recipe, lambda _: None).with_suffix(".safetensors").read_bytes()
    for entry in cache.folder.iterdir():
        entry.write_bytes(b"damaged" * 10)
    lines: list[str] = []
    assert train_tracker(recipe, lines.append).with_suffix(".safetensors").read_bytes() == arrays
    # its survey, for either stretch the frames, and the regions of one
    assert sum("damaged; made again" in line for line in lines) == 4


@pytest.mark.parametrize("kind", ["room", "truth", "drive", "people", "cut off"])
def test_a_kept_survey_equals_the_recordings(kind, record, cache, tmp_path):
    path = tmp_path / "one.mcap"
    if kind == "truth":
        truth_scene.write_recording(path, seconds=4)
    elif kind == "drive":
        drive.write_recording(path, 4, pose_noise=(0.6, 0.2))
    else:
        path = record()
    if kind == "people":
        (tmp_path / "people.csv").write_text("time_s,id,x,y\n1,1,2,1\n2,1,2.2,1\n")
        path = import_recording(path, tmp_path / "people.mcap", people=str(tmp_path / "people.csv")).path
    if kind == "cut off":
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    expected = open_recording(path)
    expected.survey  # noqa: B018 - its warnings
    for _ in range(2):
        found = surveyed(open_recording(path), cache)
        assert found.overview() == expected.overview()
        assert (found.damage, found.survey.moves) == (expected.damage, expected.survey.moves)
        assert found.survey.poses == expected.survey.poses
        assert GridStream(found).has_people == GridStream(expected).has_people == (kind == "people")
    assert bool(expected.warnings) == (kind in ("drive", "people", "cut off"))


def test_equal_frames_and_regions_have_the_same_version(cache, tmp_path):
    """Fails where the same recording gives other ones: increase STRETCHES_VERSION, and replace the digest."""
    path = tmp_path / "room.mcap"
    truth_scene.write_recording(path, seconds=6)
    files, (stream,) = files_of(path, cache, tmp_path)
    digest = hashlib.sha256()
    for frame in stream:
        digest.update(np.packbits([frame.visible, frame.occupied]))
    regions = StretchRegions.read(files.regions(0))
    for array in (regions.moving, regions.starts, files.kinds(0).cell_kinds):
        digest.update(np.ascontiguousarray(array, "<i8"))
    assert (STRETCHES_VERSION, digest.hexdigest()[:16]) == (4, "70b0b22eb10b3138")
