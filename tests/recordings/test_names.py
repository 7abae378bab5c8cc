"""Names that become parts of paths are checked where they enter: the metadata of a file, and the command line."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from gridtrack.common.errors import ConfigurationError, RecordingError
from gridtrack.evaluation.referee.splits import Sampling, plan_split
from gridtrack.recordings import RecordingInfo, import_recording, open_recording, write_native
from gridtrack.recordings.stream import open_stream

ALLOWED = "expected 1 to 160 bytes of printable UTF-8"
SECOND = Sampling(horizon_s=1.0, every_s=0.5)


@pytest.fixture
def hostile(tmp_path: Path, scan) -> Callable[..., Path]:
    """Writes a native recording with unchecked metadata."""

    def write(**info: object) -> Path:
        path = tmp_path / "rec.mcap"
        with path.open("wb") as file:
            write_native(file, RecordingInfo.model_construct(**{"site": "here"} | info), [scan(k) for k in range(80)])
        return path

    return write


@pytest.mark.parametrize(
    "info",
    [
        {"stretches": {"../../x": (0.0, 8.0)}},
        {"stretches": {"a/b": (0.0, 8.0)}},
        {"stretches": {"": (0.0, 8.0)}},
        {"site": "../x"},
        {"site": "a\nb"},
        {"classes": ("car\x1b[2J",)},
    ],
)
def test_a_file_with_invalid_names_is_one_line_of_error(hostile: Callable[..., Path], info: dict[str, object]) -> None:
    path = hostile(**info)
    with pytest.raises(ConfigurationError, match=ALLOWED):
        open_stream(path)


def test_results_have_the_name_of_the_file_with_characters_that_a_folder_may_have(write, scan) -> None:
    scans = [scan(k) for k in range(80)]
    names = {"a\tb.mcap": "a_b", "run.v1.2.mcap": "run.v1.2", "run.v1.3.mcap": "run.v1.3"}
    assert {name: plan_split(str(write(scans, name)), None, SECOND).name for name in names} == names
    long = write(scans, f"{'x' * 159}.mcap")
    with pytest.raises(ConfigurationError, match=r"cannot be the name of a folder of results: expected .*; rename it"):
        plan_split(f"{long}@0s-6s", None, SECOND)


@pytest.mark.parametrize("name", [" [1] *?.clf", ".hidden.clf", "a\tb.clf", f"{'x' * 200}.clf"])
def test_the_site_of_any_file_is_a_valid_name(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_text("FLASER 3 1.0 2.0 3.0 0 0 0 0 0 0 10.5 host 0.0\n")
    assert open_recording(path).info.site


def test_an_import_refuses_a_site_and_a_stretch_that_are_paths(write, scan, tmp_path: Path) -> None:
    source = write([scan(0), scan(1)])
    for given in ({"site": "../x"}, {"stretches": {"../x": (0.0, 1.0)}}):
        with pytest.raises(ConfigurationError, match=ALLOWED):
            import_recording(source, tmp_path / "out.mcap", **given)
    assert not (tmp_path / "out.mcap").exists()


def test_a_sensor_with_an_unprintable_name_is_refused(write, scan) -> None:
    path = write([replace(scan(0), sensor="a\nb")])
    with pytest.raises(RecordingError, match=ALLOWED):
        list(open_recording(path).scans())


@pytest.mark.parametrize(
    ("name", "out"),
    [("a.mcap", "a-posed.mcap"), ("a-posed.mcap", "a-posed-2.mcap"), ("a-posed-2.mcap", "a-posed-3.mcap")],
)
def test_a_suggested_import_has_a_name_of_its_own(write: Callable[..., Path], scan, name: str, out: str) -> None:
    command = open_recording(write((scan(k) for k in range(2)), name)).import_command(["--ego-motion", "refined"])
    assert f" --out {out} --ego-motion refined" in command
