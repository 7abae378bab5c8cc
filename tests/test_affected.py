"""The tests that `make check` chooses for a change: nearest first."""

from affected import affected_tests


def test_the_nearest_tests_of_a_change_come_first():
    """A changed test, tests that import the changed module, tests that import an importer of it; no others."""
    chosen = affected_tests(["recordings/resample.py", "tests/common/test_files.py"])
    assert chosen[:2] == ["tests/common/test_files.py", "tests/recordings/test_resample.py"]
    assert "tests/recordings/test_stream.py" in chosen
    assert "tests/trackers/model_free/test_estimators.py" not in chosen


def test_a_changed_study_runs_the_tests_that_start_each_study_by_its_name():
    assert affected_tests(["studies/gate_power.py"]) == ["tests/studies/test_modules.py"]
    assert "tests/studies/test_results.py" in affected_tests(["studies/kept_summary.py"])
