"""Numbers of the pages: from summaries of comparisons, cards, and tables of measurements; and the size of the tree."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from gridtrack.evaluation.runs.summarise import summarise

from benchmarks.scale import COLUMNS, Cost, estimate, kept_costs, write_costs
from scenes import synthetic_run as synthetic
from studies.cards import labelled_scans, shipped_table
from studies.kept_summary import RunScores, kept, main
from studies.size import measured
from studies.support.results_file import read_sections

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "docs" / "results"
SCORES = {"strata": {"dynamic": {"f1": {"f1": {"value": [0.1, 0.2], "low": None, "high": None}}}}}
OTHER = {"strata": {"dynamic": {"f1": {"f1": {"value": [0.3, 0.4], "low": [0.2, 0.3], "high": [0.4, 0.5]}}}}}


def summary(**rows):
    trackers = {label: {"pooled": pooled, "recordings": recordings} for label, (pooled, recordings) in rows.items()}
    return {
        "recordings": {"hall": {"horizons_s": [0.0, 0.5]}},
        "trackers": trackers,
        "trainings": [{"labels": ["kalman", "again"]}],
        "differences": [{"tracker": label} for label in trackers],
        "pairs": [{"tracker": "kalman"}],
    }


@pytest.mark.parametrize(("pooled", "text"), [(None, "0.200"), (OTHER, "0.400 [.300, .500]")])
def test_a_number_is_from_all_recordings_or_the_only_one(tmp_path, pooled, text):
    path = tmp_path / "summary.json"
    path.write_text(json.dumps(summary(kalman=(pooled, {"hall": SCORES}))))
    assert RunScores(path).value("kalman", "f1 dynamic 0.5 s", interval=True) == text


def test_a_kept_summary_has_one_training_of_each_tracker_and_no_single_recording_of_several():
    found = kept(summary(kalman=(OTHER, {"hall": SCORES}), again=(OTHER, {}), alone=(None, {"hall": SCORES})))
    assert list(found["trackers"]) == ["kalman", "alone"]
    assert [one["tracker"] for one in found["differences"]] == ["kalman", "alone"]
    assert found["trackers"]["kalman"]["recordings"] == {}
    assert found["trackers"]["alone"]["recordings"] == {"hall": SCORES}
    assert found["pairs"] == []


def test_the_summary_of_a_run_is_kept_in_the_folder_of_its_place_with_its_confusions(tmp_path):
    run, names = tmp_path / "run", ("one", "two")
    trials = [synthetic.write_trial(run, "kalman", name, 0.6, seed=0, frames=2) for name in names]
    for trial in trials:
        synthetic.write_confusion(trial.folder, ("car", "bus"), {0: [[3, 1, 0], [2, 2, 0]]})
    described = {name: synthetic.description(classes=("car", "bus")) for name in names}
    summarise(described, trials, (), False).write(run)
    main([str(run), "junction", "--results", str(tmp_path)])
    assert json.loads((tmp_path / "junction" / "summary.json").read_text())["pairs"] == []
    scores = RunScores(tmp_path / "junction" / "summary.json")
    assert scores.value("kalman", "visible bus as car") == "50 %"


def test_the_committed_table_is_the_cards():
    committed = read_sections(RESULTS / "trackers" / "model-cards.json")
    assert committed["shipped"].tables["table"] == shipped_table(), "run python -m studies.cards"


def test_labelled_scans_come_from_the_tracker_or_its_class_decoder():
    assert labelled_scans({"labelled": "a.tracks, 20 scans from 1 s to 3 s"}) == "20"
    assert labelled_scans({"classes": {"labelled": "800 scans of 384 recordings"}}) == "800"
    assert labelled_scans({"classes": "none: a has no labels"}) == ""


ONE = Cost("local", 1, 2, 10.0, 4.0, 4.0, 300.0, 0.5, 5.0, 0.1, 6.0)
TEN = Cost("local", 10, 20, 40.0, 31.0, 31.0, 318.0, 4.1, 14.0, 0.1, 6.0)
CLUSTER = [replace(ONE, engine="slurm", host_s=3.0), replace(TEN, engine="slurm", host_s=4.8)]


def test_an_estimate_grows_with_the_trials_as_between_the_two_largest_measurements():
    smaller = replace(ONE, recordings=0, trials=1, memory_mb=0.0)
    table = estimate([smaller, ONE, TEN, *CLUSTER])
    assert table is not None
    assert {row[0]: row[1:] for row in table.rows} == {
        "trials": ("10,000 x 20", "200,000"),
        "core hours of the nodes, slurm": ("200,000 x 1.50 s", "83.3 h"),
        "time of the nodes, slurm": ("the same / 800 cores", "6.2 min"),
        "the comparison's process, slurm": ("200,000 x 0.10 s", "5.6 h"),
        "memory of the comparison's process, local": ("318.0 MB + 199,980 x 1.000 MB", "200.3 GB"),
        "folder of the run, local": ("4.1 MB + 199,980 x 0.200 MB", "40.0 GB"),
        "processor time of `report`, local": ("14.0 s + 199,980 x 0.500 s", "27.8 h"),
        "processor time of `regress`, local": ("6.0 s + 199,980 x 0.000 s", "0.0 h"),
    }
    assert estimate([ONE, *CLUSTER]) is None


def test_the_results_file_keeps_earlier_measurements(tmp_path):
    write_costs(tmp_path / "scale.json", [ONE, TEN])
    assert kept_costs(tmp_path / "scale.json") == {("local", 1): ONE, ("local", 10): TEN}
    assert len(COLUMNS) == len(ONE.row())


def test_the_size_of_a_tree_is_counted():
    found = measured(
        {
            "common/grid.py": "from __future__ import annotations\nSIZE, CELL = 2, 3\n\n\ndef cells():\n    pass\n",
            "common/scan.py": "from gridtrack.common.grid import SIZE\nimport gridtrack.common.grid\nCELL: int = 1\n",
            "reports/assets/main.js": 'import { draw } from "./figure.js";\n',
            "reports/assets/figure.js": "export function draw() {}\n",
            "tests/test_grid.py": "from gridtrack.common.grid import CELL\n\n",
            "docs/glossary.md": "# Words\n\n- **Cell**: one\n- **Grid**: two\n",
        }
    )
    assert list(found.values()) == [11, 4, 2, 1, 2, 1, 8, 2]
