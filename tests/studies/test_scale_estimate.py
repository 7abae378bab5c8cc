"""The cost of a large comparison is computed from two measured ones."""

from __future__ import annotations

from dataclasses import replace

from benchmarks.scale import COLUMNS, Cost, estimate, kept_costs, write_costs

ONE = Cost("local", 1, 2, 10.0, 4.0, 4.0, 300.0, 0.5, 5.0, 0.1, 6.0)
TEN = Cost("local", 10, 20, 40.0, 31.0, 31.0, 318.0, 4.1, 14.0, 0.1, 6.0)
CLUSTER = [replace(ONE, engine="slurm", host_s=3.0), replace(TEN, engine="slurm", host_s=4.8)]


def test_an_estimate_grows_with_the_trials_as_between_the_two_largest_measurements():
    smaller = replace(ONE, recordings=0, trials=1, memory_mb=0.0)
    table = estimate([smaller, ONE, TEN, *CLUSTER])
    assert {row[0]: row[1:] for row in table.rows} == {
        "trials": ("10,000 x 20", "200,000"),
        "nodes, slurm": ("200,000 x 1.50 s / 800 cores", "0.1 h"),
        "the comparison's process, slurm": ("200,000 x 0.10 s", "5.6 h"),
        "memory of the comparison's process, local": ("318.0 MB + 199,980 x 1.000 MB", "200.3 GB"),
        "folder of the run, local": ("4.1 MB + 199,980 x 0.200 MB", "40.0 GB"),
        "processor time of `report`, local": ("14.0 s + 199,980 x 0.500 s", "27.8 h"),
        "processor time of `regress`, local": ("6.0 s + 199,980 x 0.000 s", "0.0 h"),
    }


def test_one_measurement_gives_no_estimate():
    assert estimate([ONE, *CLUSTER]) is None


def test_the_results_file_keeps_what_was_measured_before(tmp_path):
    write_costs(tmp_path / "scale.json", [ONE, TEN])
    assert kept_costs(tmp_path / "scale.json") == {("local", 1): ONE, ("local", 10): TEN}
    assert len(COLUMNS) == len(ONE.row())
