"""Agreement of two runs: records, files and every count. And a wait for other processes."""

from __future__ import annotations

import time

from pyarrow import parquet

from gridtrack.evaluation.runs.trial_record import read_trial_record


def counted(run):
    """By trial: the record without fields that depend on the machine, and every count."""
    trials = {}
    for folder in sorted(path.parent for path in run.glob("*/outcome.json")):
        record = read_trial_record(folder)
        tables = {path.name: parquet.read_table(path) for path in sorted(folder.glob("*.parquet"))}
        fields = record.model_dump(exclude={"times", "round_trips", "peak_rss_mb", "files"})
        trials[folder.name] = fields, tables, sorted(path.name for path in folder.iterdir())
    return trials


def assert_agree(one, other):
    """Two runs have the same trials with the same files, records and counts."""
    assert one.keys() == other.keys()
    for name, (fields, tables, files) in one.items():
        assert fields == other[name][0]
        assert files == other[name][2]
        assert tables.keys() == other[name][1].keys()
        assert all(table.equals(other[name][1][file]) for file, table in tables.items())


def wait_until(true, seconds=300.0):
    """Poll; the limit only ends a test that has failed."""
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end, "the condition is still false"
        time.sleep(0.05)
