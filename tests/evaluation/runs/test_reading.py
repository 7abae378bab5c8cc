"""The JSON files of a run are read as they were written; damaged and hostile content is refused in one line."""

import json

import pytest

from gridtrack.common.notices import Notice
from gridtrack.evaluation.runs.passes import CallTimes
from gridtrack.evaluation.runs.result_files import RunError, json_of
from gridtrack.evaluation.runs.run_record import MAX_RUN_BYTES, read_run_record
from gridtrack.evaluation.runs.summarise import summarise
from gridtrack.evaluation.runs.summary import read_summary
from gridtrack.evaluation.runs.trial_record import MAX_OUTCOME_BYTES, read_trial_record

from scenes import synthetic_run as synthetic

FILES = {
    "run.json": (read_run_record, MAX_RUN_BYTES),
    "summary.json": (read_summary, 256 << 20),
    "outcome.json": (read_trial_record, MAX_OUTCOME_BYTES),
}


@pytest.fixture
def folder(tmp_path):
    """One folder with the three files."""
    trials = [
        synthetic.write_trial(tmp_path, label, "room", 0.6, seed=0, frames=2) for label in ("persistence", "good")
    ]
    recordings = {"room": synthetic.description()}
    summarise(recordings, trials, [Notice(text="a notice")], False).write(tmp_path)
    synthetic.write_run_record(tmp_path, recordings)
    trials[1].record.write(tmp_path)
    return tmp_path


def change(folder, name, **changes):
    path = folder / name
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))


@pytest.mark.parametrize("name", FILES)
def test_a_file_is_read_as_it_was_written(folder, name):
    read, _ = FILES[name]
    assert json.loads(json_of(read(folder))) == json.loads((folder / name).read_text())


@pytest.mark.parametrize("name", FILES)
def test_a_key_that_is_not_known_is_ignored(folder, name):
    read, _ = FILES[name]
    before = read(folder)
    change(folder, name, later={"anything": [1, None]})
    assert read(folder) == before


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("schema", [0, 2, "3", None, [3]])
def test_another_schema_is_refused_by_its_number(folder, name, schema):
    change(folder, name, schema=schema)
    with pytest.raises(RunError, match=r"this gridtrack reads schema 3: \w+") as refused:
        FILES[name][0](folder)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("content", ["{", "[]", '"x"', "[" * 100_000, "\udcff", '{"schema": 3}', '{"schema": 1e999}'])
def test_damaged_content_is_refused_in_one_line(folder, name, content):
    (folder / name).write_bytes(content.encode("utf-8", "surrogateescape"))
    with pytest.raises(RunError) as refused:
        FILES[name][0](folder)
    assert str(folder / name) in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("name", FILES)
def test_a_file_that_is_too_large_is_refused_before_it_is_read(folder, name):
    read, most = FILES[name]
    with (folder / name).open("r+b") as file:
        file.truncate(most + 1)
    with pytest.raises(RunError, match="refused"):
        read(folder)


def test_a_trial_without_a_record_has_none_and_a_folder_without_the_others_is_an_error(tmp_path):
    assert read_trial_record(tmp_path) is None
    for read in (read_run_record, read_summary):
        with pytest.raises(FileNotFoundError):
            read(tmp_path)


@pytest.mark.parametrize(
    ("name", "changes", "where"),
    [
        ("outcome.json", {"outcome": "won"}, "outcome"),
        ("outcome.json", {"times": {"wall_s": None}}, "times.wall_s"),
        ("outcome.json", {"latency_ms": {"update": {"p50": None}}}, "latency_ms.update.p50"),
        ("run.json", {"status": "done"}, "status"),
        ("run.json", {"configuration": {"recordings": {"a": {}}, "trials": {}}}, "configuration.recordings.a"),
        ("summary.json", {"recordings": {}}, "recordings"),
        ("summary.json", {"trackers": {"a": {"tracker": "a", "recordings": {"b": {"outcome": "ok"}}}}}, "scores on b"),
    ],
)
def test_a_value_that_does_not_fit_is_named(folder, name, changes, where):
    change(folder, name, **changes)
    with pytest.raises(RunError, match=where.replace(".", r"\.")):
        FILES[name][0](folder)


def test_pooled_curves_that_do_not_reach_every_horizon_are_refused(tmp_path):
    trials = [synthetic.write_trial(tmp_path, "good", name, 0.6, seed=0, frames=2) for name in ("a", "b")]
    summarise({name: synthetic.description() for name in ("a", "b")}, trials, [], False).write(tmp_path)
    summary = json.loads((tmp_path / "summary.json").read_text())
    summary["trackers"]["good"]["pooled"]["strata"]["dynamic"]["f1"]["f1"]["value"].pop()
    (tmp_path / "summary.json").write_text(json.dumps(summary))
    with pytest.raises(RunError, match="good on all recordings, dynamic: 20 steps, expected 21"):
        read_summary(tmp_path)


@pytest.mark.parametrize(
    ("twentieths", "why"),
    [((1.0, 2.0), "2 percentiles where 21 belong"), ((*range(20), 3.0), "do not increase"), ((-1.0,) * 21, "increase")],
)
def test_percentiles_of_times_are_all_there_and_increase(twentieths, why):
    with pytest.raises(ValueError, match=why):
        CallTimes(p50=1.0, p95=2.0, p99=3.0, twentieths=twentieths)
