"""Stretches as text and as recorded time, and recordings named by URLs."""

from __future__ import annotations

import http.server
import threading
from functools import partial
from pathlib import Path

import pytest
from typer.testing import CliRunner

from gridtrack.cli import app
from gridtrack.common.errors import GridtrackError, RecordingError, StoreError
from gridtrack.recordings import import_recording, packaged_recording
from gridtrack.recordings.stream import open_stream
from gridtrack.recordings.stretches import WALL_CLOCK_FROM_NS, RecordedTime, fetched, parse_named_stretch, parse_stretch

DAY_NS = 86_400 * 1_000_000_000
CONTENT = b"a recording" * 1000


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("demo.mcap", ("demo.mcap", None)),
        ("demo.mcap@30s-90s", ("demo.mcap", (30.0, 90.0))),
        ("demo.mcap@30-90.5", ("demo.mcap", (30.0, 90.5))),
        ("demo.mcap@90s-", ("demo.mcap", (90.0, None))),
        ("a@b/demo.mcap@test", ("a@b/demo.mcap", "test")),
        ("demo.mcap@leave-one-out", ("demo.mcap", "leave-one-out")),
    ],
)
def test_a_stretch_is_read_from_text(text: str, expected: tuple[str, object]) -> None:
    path, stretch = parse_stretch(text)
    assert (str(path), stretch) == expected


def test_a_file_with_an_at_sign_in_its_name_is_a_file(tmp_path: Path) -> None:
    path = tmp_path / "demo@home"
    path.touch()
    assert parse_stretch(str(path)) == (path, None)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("demo.mcap@", r"'demo\.mcap@': "),
        ("@test", "'@test': "),
        ("demo.mcap@90s-30s", r"'demo\.mcap@90s-30s': "),
        ("demo.mcap@../../x", r"'\.\./\.\./x' is not the name of a stretch: expected"),
    ],
)
def test_an_invalid_stretch_is_refused(text: str, message: str) -> None:
    with pytest.raises(RecordingError, match=message):
        parse_stretch(text)


def test_the_name_of_a_stretch_is_not_a_path() -> None:
    assert parse_named_stretch("train=0s-75s") == ("train", (0.0, 75.0))
    with pytest.raises(RecordingError, match=r"'\.\./x' cannot be the name of a stretch: expected"):
        parse_named_stretch("../x=0s-5s")


@pytest.mark.parametrize(
    ("stretch", "message"),
    [
        ("@tset", "no stretch 'tset'; did you mean 'test'"),
        ("@5s-9s", r"the recording is 2\.9 s long"),
        ("@3.5s-", r"the recording is 2\.9 s long"),
        ("@1.01s-1.02s", "no frame at 10 Hz"),
    ],
)
def test_a_stretch_outside_the_recording_is_refused(stretch: str, message: str, write, scan) -> None:
    path = write((scan(k) for k in range(30)), stretches={"test": (1.0, None)})
    with pytest.raises(GridtrackError, match=message):
        open_stream(f"{path}{stretch}")


# ---- recorded time


def recorded(path: Path, stretch: str = "") -> RecordedTime:
    return open_stream(f"{path}{stretch}", rate_hz=10.0).recorded


def test_an_import_of_an_import_has_the_time_of_its_first_source(tmp_path: Path) -> None:
    log = tmp_path / "a.clf"
    log.write_text("".join(f"FLASER 3 1.0 2.0 {k % 7}.5 0 0 0 0 0 0 {k}.0 host {k}.0\n" for k in range(20)))
    once = import_recording(log, tmp_path / "b.mcap", site="hall", stretches={"train": (0.0, 10.0)})
    twice = import_recording(once.path, tmp_path / "c.mcap", credit="another name")
    assert len({once.sha256, twice.sha256, recorded(log).source_sha256}) == 3
    assert recorded(twice.path).source_sha256 == recorded(once.path).source_sha256 == recorded(log).source_sha256
    assert twice.info.source == "a.clf"
    assert recorded(log, "@5s-8s").overlaps(recorded(twice.path, "@train"))
    assert not recorded(log, "@10s-").overlaps(recorded(twice.path, "@train"))


def test_a_part_cut_by_another_program_overlaps_if_its_stamps_are_times_of_day(write, scan) -> None:
    whole, cut = write(map(scan, range(100)), "whole.mcap"), write(map(scan, range(40, 60)), "cut.mcap")
    assert recorded(whole).overlaps(recorded(cut))
    assert recorded(whole, "@5s-").overlaps(recorded(cut))
    assert not recorded(whole, "@6s-").overlaps(recorded(cut))
    elsewhere = write(map(scan, range(100)), "elsewhere.mcap", site="elsewhere")
    assert not recorded(elsewhere).overlaps(recorded(cut))


@pytest.mark.parametrize(("start_ns", "expected"), [(0, False), (WALL_CLOCK_FROM_NS + DAY_NS, True)])
def test_equal_stamps_of_two_sources_overlap_only_as_times_of_day(start_ns: int, expected: bool) -> None:
    one, other = (RecordedTime(name, "junction", start_ns, start_ns + 1000) for name in ("seed 1", "seed 2"))
    assert one.overlaps(other) is expected


# ---- URLs


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "gridtrack" / "recordings"


@pytest.fixture
def notes() -> list[str]:
    return []


@pytest.mark.parametrize("text", ["hall.mcap", "hall.mcap@30s-90s", "/data/a:b/hall.mcap", "s3:/bucket/hall.mcap"])
def test_other_texts_than_urls_are_unchanged(text: str, notes: list[str]) -> None:
    assert fetched(text, notes.append) == text
    assert notes == []


def test_a_recording_is_fetched_once_under_its_own_name_and_again_when_it_has_changed(bucket, notes, cache) -> None:
    bucket.pipe("/bucket/hall.mcap", CONTENT)
    first, again = (fetched("memory://bucket/hall.mcap@3s-9s", notes.append) for _ in range(2))
    assert first == again
    path, _, stretch = first.rpartition("@")
    assert stretch == "3s-9s"
    assert path.startswith(str(cache))
    assert path.endswith("/hall.mcap")
    assert Path(path).read_bytes() == CONTENT
    assert notes == ["memory://bucket/hall.mcap: fetching 0.0 MB"]
    assert [file.name for file in cache.rglob("*") if file.is_file()] == ["hall.mcap"]
    bucket.pipe("/bucket/hall.mcap", CONTENT + b"more")
    assert fetched("memory://bucket/hall.mcap", notes.append) != first
    assert len(notes) == 2


def test_commands_read_urls_like_files(cache: Path) -> None:
    folder = packaged_recording("leg_tracker").parent
    handler = partial(http.server.SimpleHTTPRequestHandler, directory=str(folder))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        url = f"http://127.0.0.1:{server.server_port}"
        shown = CliRunner().invoke(app, ["recording", "info", f"{url}/leg_tracker.mcap"])
        missing = CliRunner().invoke(app, ["compare", f"{url}/none.mcap", "--tracker", "persistence"])
        server.shutdown()
    assert shown.exit_code == 0, shown.output
    assert "1265 scans" in shown.stdout
    assert shown.stderr.count("fetching") == 1
    assert isinstance(missing.exception, StoreError)
    assert "none.mcap: cannot be fetched" in str(missing.exception)
