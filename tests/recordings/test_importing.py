"""An import writes the same scans and metadata in the native format, or no file."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gridtrack.common.errors import ConfigurationError, GridtrackError, RecordingError
from gridtrack.recordings import import_recording, open_recording, packaged_recording


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """A CARMEN log of five scans, a second apart, of a moving sensor."""
    path = tmp_path / "building.clf"
    path.write_text("".join(f"FLASER 3 1.0 2.0 {k}.5 {k} 0 0.1 0 0 0 {k + 10}.5 host {k}.0\n" for k in range(5)))
    return path


def test_an_import_has_the_scans_of_its_source(log: Path, tmp_path: Path, same_scans) -> None:
    imported = import_recording(log, tmp_path / "out.mcap")
    same_scans(imported.scans(), open_recording(log).scans())
    assert imported.info.site == "building"


def test_an_import_names_its_source(log: Path, tmp_path: Path) -> None:
    stretches = {"train": (0.0, 3.0), "test": (3.0, None)}
    info = import_recording(
        log, tmp_path / "out.mcap", site="hall", grid="50x0.2", rate_hz=1.0, stretches=stretches, credit="A. Body"
    ).info
    assert info.source == "building.clf"
    assert info.source_sha256 == hashlib.sha256(log.read_bytes()).hexdigest()
    assert (info.site, info.grid, info.rate_hz, info.credit) == ("hall", "50x0.2@-5,-5", 1.0, "A. Body")
    assert info.command == (
        "gridtrack recording import building.clf --out out.mcap --site hall --grid 50x0.2"
        " --credit 'A. Body' --rate 1 --stretch train=0s-3s --stretch test=3s-"
    )
    assert str(tmp_path) not in info.command


def test_importing_again_gives_the_same_bytes(log: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.mcap"
    once = import_recording(log, out, site="hall").path.read_bytes()
    assert import_recording(log, out, site="hall", overwrite=True).path.read_bytes() == once


def test_a_stretch_outside_the_recording_is_refused_before_anything_is_written(log, tmp_path) -> None:
    out = tmp_path / "out.mcap"
    with pytest.raises(RecordingError, match=r"building.clf@100s-200s: the recording is 4\.0 s long: name a range"):
        import_recording(log, out, stretches={"train": (0.0, 2.0), "test": (100.0, 200.0)})
    assert not out.exists()


def test_an_import_replaces_a_recording_only_with_overwrite(log: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.mcap"
    before = import_recording(log, out, site="hall").path.read_bytes()
    with pytest.raises(RecordingError, match="exists already; choose another place for the result, or replace it with"):
        import_recording(log, out)
    assert out.read_bytes() == before


def test_an_import_keeps_the_metadata_that_no_option_replaces(write, scan, tmp_path: Path) -> None:
    source = write([scan(0), scan(1)], site="hall", licence="CC0", rate_hz=10.0)
    info = import_recording(source, tmp_path / "out.mcap", rate_hz=5.0).info
    assert (info.site, info.licence, info.rate_hz) == ("hall", "CC0", 5.0)


def test_warnings_of_the_source_are_kept(log: Path, tmp_path: Path) -> None:
    log.write_text(log.read_text() + "FLASER 3 1.0\n")
    imported = import_recording(log, tmp_path / "out.mcap")
    assert len(imported.survey.sensors["scan"].stamps) == 5
    assert any("line 6" in line for line in imported.warnings)


def test_a_failed_import_does_not_change_an_existing_file(log: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.mcap"
    out.write_bytes(b"earlier")
    log.write_text(log.read_text() + "FLASER 3 1.0\n")
    with pytest.raises(RecordingError, match="line 6"):
        import_recording(log, out, strict=True, overwrite=True)
    with pytest.raises(ConfigurationError, match="rate_hz"):
        import_recording(log, out, rate_hz=-1.0, overwrite=True)
    assert out.read_bytes() == b"earlier"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["building.clf", "out.mcap"]


def test_the_source_is_never_overwritten(write, scan) -> None:
    path = write([scan(0)])
    with pytest.raises(RecordingError, match="is the source itself"):
        import_recording(path, path)
    with pytest.raises(RecordingError, match=r"written as \.mcap"):
        import_recording(path, path.with_suffix(".bag"))


def csv_of(path: Path, rows: list[str], columns: str = "stamp_ns,beam,class,sensor") -> Path:
    path.write_text("\n".join([columns, *rows]) + "\n")
    return path


def test_labels_are_read_from_a_csv(write, scan, same_scans, tmp_path: Path) -> None:
    scans = [scan(k) for k in range(4)]
    stamps = [s.stamp_ns for s in scans]
    rows = [f"{stamps[1]},0,person,", f"{stamps[1]},35,car,scan", f"{stamps[3]},7,person,scan"]
    labels = csv_of(tmp_path / "labels.csv", rows)
    imported = import_recording(write(scans), tmp_path / "out.mcap", labels=labels)
    assert imported.info.classes == ("car", "person")
    one, three = np.full(36, 255, np.uint8), np.full(36, 255, np.uint8)
    one[0], one[35], three[7] = 1, 0, 1
    same_scans(imported.scans(), [scans[0], replace(scans[1], labels=one), scans[2], replace(scans[3], labels=three)])
    assert imported.overview().sensors["scan"].labelled_scans == 2


def test_labels_of_sensors_that_share_a_stamp_may_alternate(write, scan, tmp_path: Path) -> None:
    scans = [scan(0, "front"), scan(0, "rear")]
    rows = [f"{scans[0].stamp_ns},{beam},person,{sensor}" for beam in (0, 1, 2) for sensor in ("front", "rear")]
    imported = import_recording(write(scans), tmp_path / "out.mcap", labels=csv_of(tmp_path / "labels.csv", rows))
    for found in imported.scans():
        assert np.flatnonzero(found.labels != 255).tolist() == [0, 1, 2]


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        (["{0},99,car,scan"], r"line 2: beam 99 of a scan of 36 beams"),
        (["5,0,car,scan"], r"line 2: no scan of sensor 'scan' is stamped 5"),
        (["{1},0,car,front"], r"line 2: no scan of sensor 'front'"),
        (["{1},0,car,scan", "{0},0,car,scan"], r"line 3: (a stamp before that of the row above|no scan)"),
        (["{0},0,car,scan", "99999999999999999999,0,car,scan"], r"line 3: no scan"),
        (["now,0,car,scan"], r"line 2: invalid literal"),
    ],
)
def test_the_error_for_a_label_without_a_beam_names_its_line(
    rows: list[str], message: str, write, scan, tmp_path: Path
) -> None:
    scans = [scan(k) for k in range(3)]
    labels = csv_of(tmp_path / "labels.csv", [row.format(*(s.stamp_ns for s in scans)) for row in rows])
    with pytest.raises(RecordingError, match=message):
        import_recording(write(scans), tmp_path / "out.mcap", labels=labels)
    assert not (tmp_path / "out.mcap").exists()


def test_a_csv_without_the_columns_is_refused(write, scan, tmp_path: Path) -> None:
    labels = csv_of(tmp_path / "labels.csv", [], columns="time,class")
    with pytest.raises(RecordingError, match="expected the columns stamp_ns, beam, class"):
        import_recording(write([scan(0)]), tmp_path / "out.mcap", labels=labels)


def test_the_packaged_recording_is_found_by_its_name() -> None:
    recording = open_recording(packaged_recording("leg_tracker"))
    summary = recording.overview()
    assert (summary.sensors["scan"].scans, summary.sensors["scan"].beams) == (1265, (512, 512))
    assert set(recording.info.stretches) == {"train", "validation", "test"}
    assert recording.survey.rate_hz == recording.info.rate_hz == 10.0
    assert recording.warnings == []
    assert recording.info.licence == "BSD-3-Clause"
    assert (recording.path.parent / "LICENSE").is_file()


def test_the_error_for_an_unknown_packaged_recording_suggests_another() -> None:
    with pytest.raises(GridtrackError, match="did you mean 'leg_tracker'"):
        packaged_recording("leg-tracker")
