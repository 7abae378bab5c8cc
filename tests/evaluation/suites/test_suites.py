"""A suite: recordings that are what they were, rows that pair without being run, and a leaderboard that decides."""

from __future__ import annotations

import json

import pytest
import tomli_w

from gridtrack.common.files import sha256_of
from gridtrack.evaluation.runs.run_record import RunConfiguration, RunRecord, TrialIdentity
from gridtrack.evaluation.scores.contact_foresight import CONTACT_FORESIGHT
from gridtrack.evaluation.scores.f1 import F1
from gridtrack.evaluation.suites.leaderboard import leaderboard
from gridtrack.evaluation.suites.published import read_row, row_file, rows_of_run, write_row
from gridtrack.evaluation.suites.suite import DATA, SuiteError, read_suite, suite_folders
from gridtrack.reports.leaderboard import printed_rows, render_leaderboard, sentences

from scenes.synthetic_run import RECORDINGS, description, identity, write_rows

SKILLS = {"stationary": 0.5, "good": 0.8, "twin": 0.8, "poor": 0.6}


@pytest.fixture(scope="module")
def rows(tmp_path_factory):
    """The rows of a run of four trackers on twenty recordings, as they come back from their files."""
    run = tmp_path_factory.mktemp("run")
    write_rows(run, SKILLS, scores=(F1, CONTACT_FORESIGHT))
    described = {name: described_as(f"{i:064x}") for i, name in enumerate(RECORDINGS)}
    identities = {label: TrialIdentity(tracker=label, options={"gate_m": 2.0}) for label in SKILLS}
    trials = {f"{label}@{name}": one for label, one in identities.items() for name in described}
    RunRecord(
        command=("gridtrack", "compare"),
        configuration=RunConfiguration(recordings=described, trials=trials),
        versions={"gridtrack": "0.3.0"},
        status="complete",
    ).write(run)
    found = rows_of_run(run, "made-1", credit="<b>somebody</b>")
    for row in found:
        write_row(run / row_file(row), row)
    return {row.label: read_row(run / row_file(row)) for row in found}


def described_as(source_sha256):
    """A recording of this source, as a run identifies it."""
    return identity(description(frames=8, source_sha256=source_sha256).model_copy(update={"rate_hz": 8.0}))


def test_the_leaderboard_ranks_rows_by_their_paired_tests(rows):
    board = leaderboard(list(rows.values()), "good", "contact_foresight")
    assert [(row.label, row.rank, row.verdict) for row in board.rows] == [
        ("good", 1, ""),
        ("twin", 1, "no difference shown"),
        ("poor", 3, "worse"),
        ("stationary", 4, "worse"),
    ]
    assert [score.name for score in board.scores] == ["contact_foresight", "f1"]
    assert (board.units, board.left_out) == (20, ())
    foreseen = board.rows[0].values[0].estimate
    assert foreseen.low < 0.8 < foreseen.high


def test_its_sentences_and_rows_say_what_is_better(rows, tmp_path):
    board = leaderboard(list(rows.values()), "good", "contact_foresight")
    lines = list(sentences(made_suite(tmp_path), board))
    assert lines[0].startswith("good on made-1: contacts foreseen 0.80")
    assert lines[1:] == ["It is better than poor, stationary.", "No difference is shown from twin."]
    assert printed_rows(board)[2]["difference from good"].endswith(" ▼")


def test_the_page_is_escaped_and_has_no_script(rows, tmp_path):
    board = leaderboard(list(rows.values()), "good", "contact_foresight")
    page = render_leaderboard(made_suite(tmp_path), board, tmp_path / "page").read_text()
    assert "&lt;b&gt;somebody&lt;/b&gt;" in page
    assert "<script" not in page
    assert "default-src &#39;none&#39;" in page or "default-src 'none'" in page


def test_a_row_of_other_frames_or_rules_is_left_out_and_one_changed_by_hand_is_refused(rows, tmp_path):
    poor, measured = rows["poor"], rows["poor"].measurement
    other = poor.model_copy(update={"measurement": measured.model_copy(update={"scoring_rules": 99})})
    board = leaderboard([rows["good"], other], "good", "contact_foresight")
    assert board.left_out == ("poor: scored by the rules 99, and not 1: run it again",)
    content = poor.model_dump(mode="json", by_alias=True)
    unit = content["measurement"]["trackers"]["poor"]["recordings"][RECORDINGS[0]]["units"][0]
    unit["frames"] += 1
    path = tmp_path / "poor.json"
    path.write_text(json.dumps(content))
    with pytest.raises(SuiteError, match="changed since it was written"):
        read_row(path)


def made_suite(folder, *files, **more):
    """A suite of these files in a folder."""
    found = [{"file": path.name, "sha256": sha256_of(path)} for path in files] or [{"file": "a", "sha256": "0" * 64}]
    content = {"name": "made-1", "about": "A room.", "horizon_s": 1.0, "every_s": 0.5, "recordings": found} | more
    (folder / "suite.toml").write_text(tomli_w.dumps(content))
    return read_suite(folder)


def test_the_recordings_of_the_shipped_suites_are_what_they_were():
    suites = {folder.name: read_suite(folder) for folder in suite_folders()}
    assert {"hall-1", "junction-1", "worlds-1"} <= suites.keys()
    for name, suite in suites.items():
        assert suite.name == name
        assert len(suite.settings(DATA)["recordings"]) == len(suite.recordings)


def test_a_missing_recording_and_another_one_are_refused_in_a_line(record, tmp_path):
    path = record()
    suite = made_suite(path.parent, path)
    with pytest.raises(SuiteError, match="a recording of the suite is missing: --data names the folder"):
        suite.settings(tmp_path / "elsewhere")
    with path.open("ab") as file:
        file.write(b" ")
    with pytest.raises(SuiteError, match="not the recording of the suite"):
        suite.settings(path.parent)
    outside = made_suite(path.parent, file := path, recordings=[{"file": f"../{file.name}", "sha256": "0" * 64}])
    with pytest.raises(SuiteError, match="is missing"):
        outside.settings(path.parent / "sub")


def test_a_tracker_is_compared_with_published_rows_that_are_not_run(gridtrack, record, tmp_path, home, trackers_here):
    path = record()
    folder = tmp_path / "made-1"
    folder.mkdir()
    made_suite(folder, path)
    first = ("suite", "run", folder, "--data", path.parent, "--jobs", "1", "--out")
    done = gridtrack(*first, tmp_path / "published", "--tracker", "persistence", "--tracker", "blank")
    assert done.code == 0, done.err
    done = gridtrack("suite", "row", tmp_path / "published", "--suite", folder, "--out", folder / "rows")
    assert done.code == 0, done.err
    assert sorted(file.name for file in (folder / "rows").iterdir()) == ["blank.json", "persistence.json"]
    done = gridtrack(*first, tmp_path / "mine", "--tracker", "mine=persistence", "--again", "blank")
    assert done.code == 0, done.err
    assert "mine on made-1: " in done.out
    assert "blank: its sums are equal to the published ones" in done.out
    assert not (tmp_path / "mine" / "persistence@room").exists()
    assert str(tmp_path) not in (folder / "rows" / "blank.json").read_text(), "rows name no folder of a machine"
    done = gridtrack(*first, tmp_path / "again", "--tracker", "persistence")
    assert (done.code, "name yours, as in mine=persistence" in done.err) == (2, True)
    done = gridtrack("suite", "page", folder, "--out", tmp_path / "page")
    assert (done.code, (tmp_path / "page" / "index.html").is_file()) == (0, True)
    assert gridtrack("suite", "list").out.count("\n") >= 3
