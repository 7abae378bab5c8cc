"""Requested measurements that failed: `compare` and `regress` report them and do not pass."""

from __future__ import annotations

import pytest

pytestmark = pytest.mark.usefixtures("staged", "trackers_here")


@pytest.fixture
def compare(gridtrack, record, tmp_path):
    """`compare(folder, *requested)` runs `staged`, which fails in its second stream, and `blank`."""
    # without a validation stretch the second stream is the first one after the trial
    path, starts = record("plain", seconds=10, stretches={}), tmp_path / "starts"
    trackers = ("--tracker", f"staged:crash_at=60,starts={starts}", "--tracker", "blank")
    fixed = ("compare", "--no-floors", path, *trackers, "--horizon", "1s", "--every", "0.5s", "--out")

    def compare(folder, *requested):
        starts.unlink(missing_ok=True)
        return gridtrack(*fixed, tmp_path / folder, *requested)

    return compare


@pytest.mark.parametrize("requested", [("--deadline",), ("--degrade", "range-noise=0.1")])
def test_a_requested_measurement_that_failed_is_exit_3_of_compare_and_of_regress(
    compare, gridtrack, tmp_path, requested
):
    message = f"gridtrack: not measured: staged@plain: {requested[0]} was requested and failed"
    baseline = tmp_path / "baseline.json"
    assert compare("then").code == 0
    code, _, err = compare("now", *requested)
    assert (code, err.count("gridtrack: not measured: "), message in err) == (3, 1, True)
    assert gridtrack("regress", tmp_path / "then", "--baseline", baseline, "--update").code == 0
    before = baseline.read_bytes()
    for update in ([], ["--update"]):
        code, _, err = gridtrack("regress", tmp_path / "now", "--baseline", baseline, *update)
        assert (code, message in err, baseline.read_bytes() == before) == (3, True, True)


def test_a_run_without_the_measurements_of_the_baseline_does_not_pass(gridtrack, record, tmp_path):
    path, baseline = record(seconds=14), tmp_path / "baseline.json"
    fixed = ("compare", "--no-floors", path, "--tracker", "blank", "--horizon", "1s", "--every", "0.5s", "--out")
    assert gridtrack(*fixed, tmp_path / "then", "--degrade", "range-noise=0.1").code == 0
    assert gridtrack("regress", tmp_path / "then", "--baseline", baseline, "--update").code == 0
    assert gridtrack(*fixed, tmp_path / "now").code == 0
    code, _, err = gridtrack("regress", tmp_path / "now", "--baseline", baseline)
    assert (code, "blank@room: measured with --degrade for the baseline and not in the run" in err) == (3, True)
    assert gridtrack("regress", tmp_path / "then", "--baseline", baseline).code == 0
