"""`compare --follow`: a recording is compared while it is written, by a writer that its reader drives."""

from __future__ import annotations

import queue
from collections.abc import Callable
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from mcap.reader import make_reader

from gridtrack.common.errors import ConfigurationError, RecordingError
from gridtrack.common.grid import Shift
from gridtrack.evaluation.referee.deadline import read_later
from gridtrack.evaluation.referee.live_timeline import LiveTimeline
from gridtrack.evaluation.referee.samples import SAMPLES, TRACKS_TOPIC
from gridtrack.evaluation.runs.following import Following, following
from gridtrack.evaluation.runs.plan import resolve
from gridtrack.evaluation.runs.result_files import RunError
from gridtrack.evaluation.runs.runner import run
from gridtrack.evaluation.runs.settings import CompareSettings
from gridtrack.evaluation.runs.sums import SUMS_FILE
from gridtrack.evaluation.runs.trial_record import read_trial_record
from gridtrack.trackers.contract import Forecast, TrackedObject

from scenes import truth_scene
from scenes.room import trial_of

pytestmark = pytest.mark.usefixtures("staged", "trackers_here")

COMMAND = ("gridtrack", "compare", "--follow")
PIECE = 1000


class Writer:
    """A recorder: whenever the reader waits for more, it appends the next piece of a finished recording."""

    def __init__(self, finished: Path, growing: Path, pieces: int | None = None) -> None:
        self.content, self.growing, self.pieces = finished.read_bytes(), growing, pieces
        self.growing.write_bytes(b"")
        self.written, self.idle, self.stopped = 0, False, False

    def more(self) -> bool:
        self.idle = self.written == len(self.content) or self.pieces == 0
        if self.idle or self.stopped:
            return False
        piece = self.content[self.written : self.written + PIECE]
        with self.growing.open("ab") as file:
            file.write(piece)
        self.written += len(piece)
        self.pieces = None if self.pieces is None else self.pieces - 1
        return True

    def stop(self) -> None:
        self.stopped = True


class InStep:
    """A pace at which every tracker keeps up; `on_frame(n)` is called before the n-th frame with a deadline."""

    def __init__(self, followed: Following, on_frame: Callable[[int], None] = lambda n: None) -> None:
        self.followed, self.on_frame, self.frames = followed, on_frame, 0

    def restart(self) -> None:
        pass

    def wait(self, all_free, *, behind: bool) -> None:
        for one in self.followed.runs:
            assert one.live.wait_until_free(60.0)
        self.frames += 1
        self.on_frame(self.frames)


class HeldBack(LiveTimeline):
    """A timeline that can hold the forecast of a frame back, so that the tracker is busy with it."""

    def __init__(self) -> None:
        super().__init__()
        self.holds, self.held = False, queue.Queue()

    def deliver(self, number, forecast) -> None:
        if self.holds:
            self.held.put((number, forecast))
        else:
            super().deliver(number, forecast)

    def release(self) -> None:
        if self.holds:
            delivered = self.held.get(timeout=60.0)
            self.holds = False
            super().deliver(*delivered)


class Table:
    """A LiveObserver that keeps each state of the table."""

    def __init__(self) -> None:
        self.shown: list[object] = []

    def note(self, text: str) -> None:
        pass

    def update(self, status) -> None:
        self.shown.append(status())


@pytest.fixture(autouse=True)
def small_chunks(monkeypatch):
    """A recorder that writes a chunk every second."""
    monkeypatch.setattr("gridtrack.recordings.formats.native.CHUNK_BYTES", 8000)


@pytest.fixture
def settings(record, tmp_path, home):
    """`settings(*trackers, **more)` to follow a file that `Writer` writes."""
    growing = tmp_path / "live" / "room.mcap"
    growing.parent.mkdir()

    given = {"recordings": (str(growing),), "out": tmp_path / "followed", "follow": True, "no_floors": True}
    return lambda *trackers, **more: CompareSettings(
        trackers=trackers, **({"horizon_s": 1.0, "every_s": 0.5} | given | more)
    )


@pytest.fixture
def ordinary(settings, progress, tmp_path):
    """`ordinary(*trackers, **more)`: the summary of a run on the finished file."""
    how = {"follow": False, "out": tmp_path / "ordinary"}
    return lambda *trackers, **more: run(resolve(settings(*trackers, **how, **more)), COMMAND, progress)


def followed(settings, finished: Path, progress, pieces: int | None = None):
    """The summary of a followed run in which the trackers keep up, and its table."""
    table = Table()
    with following(settings, Writer(finished, Path(settings.recordings[0]), pieces)) as one:
        one.pace = InStep(one)
        one.follow(table)
        return one.finish(COMMAND, progress), table


def live_of(summary, label):
    return trial_of(summary, label).strata["dynamic"]


def tracks_in(folder: Path) -> list[bytes]:
    """The objects of each sample in a trial's folder, as they are stored."""
    with (folder / SAMPLES).open("rb") as file:
        return [message.data for _, _, message in make_reader(file).iter_messages(TRACKS_TOPIC)]


@pytest.mark.parametrize("speed", [0.0, 0.4])
def test_a_tracker_that_keeps_up_has_the_scores_of_the_finished_file(
    settings, ordinary, record, progress, tmp_path, speed
):
    the_settings = settings("persistence", "blank")
    summary, table = followed(the_settings, record(stretches={}, speed=speed), progress)
    finished = ordinary("persistence", "blank")
    assert summary.interrupted is False
    for label in ("persistence", "blank"):
        live, later = (trial_of(one, label) for one in (summary, finished))
        assert live.outcome == "ok", live.reason
        assert live.strata == later.strata
        assert live.frames_scored == later.frames_scored == len(range(20, 200 - 10, 5))
        folders = [tmp_path / name / f"{label}@room" for name in ("followed", "ordinary")]
        delivered = [pl.read_parquet(folder / SUMS_FILE)["stamp_ns", "delivered"] for folder in folders]
        assert delivered[0].equals(delivered[1])
        records = [read_trial_record(folder) for folder in folders]
        assert records[0].delivered == records[1].delivered
        assert (records[0].followed.missed, records[0].followed.age_frames.p99) == (0, 0.0)
        assert records[0].followed.frames > 100
        assert records[1].followed is None
    assert summary.recordings["room"] == finished.recordings["room"]
    assert len(table.shown) == 200
    assert not [notice for notice in map(str, summary.notices) if "different frames" in notice or "table" in notice]
    assert table.shown[0].score == "F1 dynamic at 1 s"
    assert table.shown[-1].time_s == pytest.approx(19.9)
    assert [row.label for row in table.shown[-1].rows] == ["persistence", "blank"]
    with pytest.raises(RunError, match="holds a run already"), following(the_settings):
        pass


def test_every_part_of_a_forecast_waits_for_its_scores(settings, ordinary, movers, progress, tmp_path):
    """Velocities, sampled futures, the objects that the samples show; the oracle, and hidden cells."""
    finished = truth_scene.write_recording(tmp_path / "room.mcap", seconds=9)
    trackers = "mover", "now=mover:gives=now", "guesser:gives=mixed", "object=mover:gives=object"
    summary, table = followed(settings(*trackers), finished, progress)
    assert not [notice for notice in map(str, summary.notices) if "table" in notice or "different frames" in notice]
    assert table.shown[-1].rows[0].label == "mover"
    again = ordinary(*trackers, recordings=(f"{finished}@0s-",))
    longest = {}
    for label in ("mover", "now", "guesser", "object", "oracle"):
        live, later = (next(iter(one.trackers[label].recordings.values())).strata for one in (summary, again))
        assert live == later
        if label == "oracle":
            continue
        tracks = [tracks_in(next((tmp_path / out).glob(f"{label}@*"))) for out in ("followed", "ordinary")]
        assert tracks[0] == tracks[1]
        longest[label] = max(map(len, tracks[0]))
    assert longest["object"] > longest["mover"], "it alone has objects"
    assert live_of(summary, "mover")["flow_error"]["mean"].value[0] is not None
    assert live_of(summary, "guesser")["energy"]["score"].value[0] is not None


def test_a_forecast_that_is_read_later_keeps_its_later_steps():
    steps = np.arange(4, dtype=np.float32)[:, None, None, None] * np.ones((4, 2, 3, 3), np.float32)
    tracked = TrackedObject(1, np.zeros(5, np.float32), np.zeros(2, np.float32), np.eye(4, dtype=np.float32))
    whole = Forecast(steps[:, 0], None, steps, (tracked,), steps.swapaxes(0, 1) > 1)
    now = read_later(whole, 0, Shift(), 2)
    assert now.objects == (tracked,)
    np.testing.assert_array_equal(now.velocity, steps[:3])
    later = read_later(whole, 2, Shift(columns=1), 2)
    assert later.objects == ()
    assert (
        later.velocity[:, 0, 0].tolist()
        == [[2.0, 2.0, pytest.approx(np.nan, nan_ok=True)]] + [[3.0, 3.0, pytest.approx(np.nan, nan_ok=True)]] * 2
    )
    assert later.futures.dtype == np.bool_
    assert later.futures[1, :, 0].tolist() == [[True, True, False]] * 3
    alone = Forecast(whole.occupancy, velocity=steps[0])
    np.testing.assert_array_equal(read_later(alone, 0, Shift(), 2).velocity, steps[0])
    assert read_later(alone, 1, Shift(), 2).velocity is None


def test_a_busy_tracker_misses_frames_and_its_newest_forecast_in_time_is_scored(settings, record, progress, tmp_path):
    the_settings = settings("persistence", "slow=persistence")
    busy = range(60, 90)
    missed = len(busy) - 1

    class Slow(InStep):
        """The second tracker works on one frame for as long as `busy`; else both keep up."""

        def wait(self, all_free, *, behind: bool) -> None:
            held = self.followed.runs[1].live
            if self.frames + 1 == busy.start:
                super().wait(all_free, behind=behind)
                held.holds = True
            elif self.frames + 1 in busy:
                assert self.followed.runs[0].live.wait_until_free(60.0)
                self.frames += 1
            else:
                held.release()
                super().wait(all_free, behind=behind)

    writer, table = Writer(record(stretches={}), Path(the_settings.recordings[0])), Table()
    with following(the_settings, writer) as one:
        one.runs[1].live = HeldBack()
        one.pace = Slow(one)
        one.follow(table)
        summary = one.finish(COMMAND, progress)
    kept_up, slow = (read_trial_record(tmp_path / "followed" / f"{name}@room") for name in ("persistence", "slow"))
    assert (kept_up.followed.missed, slow.followed.missed) == (0, missed)
    assert missed - 1 <= slow.followed.age_frames.p99 <= missed + 1
    assert slow.complete
    assert kept_up.delivered == slow.delivered
    (notice,) = (notice for notice in map(str, summary.notices) if "missed" in notice)
    assert notice.startswith(f"slow: missed {missed} of {slow.followed.frames} frames with a deadline; its newest")
    assert table.shown[-1].rows[1].missed == missed
    f1 = [live_of(summary, name)["f1"]["f1"].value[0] for name in ("persistence", "slow")]
    assert f1[0] == 1.0 > f1[1] > 0.0


def test_ctrl_c_ends_the_recording_and_the_run_is_complete(settings, ordinary, record, progress):
    the_settings = settings("persistence")
    growing = Path(the_settings.recordings[0])

    def interrupt(frame: int) -> None:
        if frame == 50:
            raise KeyboardInterrupt

    with following(the_settings, Writer(record(stretches={}), growing)) as one:
        one.pace = InStep(one, interrupt)
        one.follow(Table())
        summary = one.finish(COMMAND, progress)
        assert one.interrupted
    assert summary.interrupted is False
    trial, frames = trial_of(summary, "persistence"), summary.recordings["room"].frames
    assert trial.outcome == "ok"
    assert trial.frames_scored == trial.frames_expected == len(range(20, frames - 10, 5))
    assert any("by Ctrl-C" in notice for notice in map(str, summary.notices))
    part = ordinary("persistence", recordings=(f"{growing}@0s-{frames / 10}s",))
    assert next(iter(part.trackers["persistence"].recordings.values())).strata == trial.strata


def test_a_file_that_its_recorder_leaves_open_ends_when_nothing_more_comes(settings, record, progress):
    summary, _ = followed(settings("persistence", idle_timeout_s=5.0), record(stretches={}), progress, pieces=12)
    assert trial_of(summary, "persistence").outcome == "ok"
    assert not any("damage" in notice or "cut off" in notice for notice in map(str, summary.notices))
    assert any(f"its first {12 * PIECE} bytes were read" in notice for notice in map(str, summary.notices))
    assert any("nothing was written to it for --idle-timeout" in notice for notice in map(str, summary.notices))


def test_a_tracker_that_dies_is_partial_and_stops_no_other(settings, record, progress):
    summary, _ = followed(settings("staged:crash_at=60,crash_in=1", "persistence"), record(stretches={}), progress)
    partial, whole = (trial_of(summary, label) for label in ("staged", "persistence"))
    assert (partial.outcome, partial.frames_scored) == ("crashed", len(range(20, 59 - 10 + 1, 5)))
    assert (whole.outcome, whole.frames_scored) == ("ok", whole.frames_expected)


def test_thresholds_are_chosen_on_a_finished_recording_before(settings, ordinary, record, progress):
    chosen_on = str(record("other", seconds=8, stretches={}))
    summary, _ = followed(settings("staged", validation=chosen_on), record(stretches={}), progress)
    assert summary.recordings["room"].validation == "other.mcap"
    assert trial_of(summary, "staged").strata == trial_of(ordinary("staged", validation=chosen_on), "staged").strata


def test_options_for_finished_recordings_are_refused(settings, record, tmp_path):
    path = str(record(stretches={}))
    for more, said in (
        ({"deadline": True}, "--deadline is for finished recordings"),
        ({"recordings": (f"{path}@0s-9s",)}, "name one file, no range"),
        ({"recordings": (path, path)}, "name one file, no range"),
        ({"recordings": (path,), "validation": path}, "the recording that is followed"),
    ):
        with pytest.raises(ConfigurationError, match=said), following(settings("blank", **more)):
            pass
    (tmp_path / "old.bag").write_bytes(b"#ROSBAG V2.0\n")
    for name, said in (("old.bag", "a ROS 1 bag cannot be followed while it is written"), ("none.mcap", "no such")):
        absent = settings("blank", recordings=(str(tmp_path / name),))
        with pytest.raises(RecordingError, match=said), following(absent):
            pass


def test_a_file_in_which_too_little_comes_is_one_line(settings, record):
    the_settings = settings("blank")
    writer = Writer(record(stretches={}), Path(the_settings.recordings[0]), pieces=3)
    said = r"nothing more is written to it, and it holds .* s of scans"
    with pytest.raises(RecordingError, match=said), following(the_settings, writer):
        pass


def test_the_command_follows_a_finished_file_to_its_end(gridtrack, record, tmp_path):
    asked = ("--follow", "--no-floors", "--tracker", "persistence", "--horizon", "1s", "--out", tmp_path / "out")
    command = ("compare", record(stretches={}), *asked)
    done = gridtrack(*command)
    assert done.code == 0, done.err
    assert "F1 dynamic at 1 s: persistence" in done.err
    assert "the first 200 frames, written before the comparison began, have no deadline" in (
        (tmp_path / "out" / "report" / "index.html").read_text()
    )
    refused = gridtrack(*command, "--deadline")
    message = "gridtrack: --deadline is for finished recordings: leave it out with --follow\n"
    assert (refused.code, refused.err) == (2, message)
