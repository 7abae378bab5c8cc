"""The table of sums: round trip, units, complete files after a failure, and refusal of other files."""

import json

import numpy as np
import pyarrow as pa
import pyarrow.compute
import pytest
from pyarrow import parquet

from gridtrack.evaluation.runs.sums import COLUMNS, ROW_GROUP, SUMS_FILE, Layout, ScoresError, SumsWriter, TrialSums

STEPS = 2
LAYOUTS = {
    "hits": Layout(("visible", "dynamic"), ("tp", "fp", "fn"), (0, 1, 2)),
    "loss": Layout(("visible",), ("loss", "cells"), (0, 2)),
    "never": Layout(("visible",), ("nothing",), (0,)),
}


def sums_of(score, seed):
    """Sums of one frame, a third of them 0."""
    layout, rng = LAYOUTS[score], np.random.default_rng([seed, len(score)])
    shape = len(layout.steps), len(layout.strata), len(layout.parts)
    return rng.random(shape) * (rng.random(shape) < 0.7)


def write(folder, frames, fail_after=None):
    with SumsWriter(folder, LAYOUTS, STEPS) as writer:
        for i in range(frames):
            if i == fail_after:
                raise RuntimeError
            for score in ("hits", "loss"):
                writer.add(i * 10, f"digest {i}", score, sums_of(score, i))
    return TrialSums(folder)


@pytest.mark.parametrize("frames", [0, 1, 7, 2 * ROW_GROUP + 1])
def test_sums_are_read_back_to_the_last_bit(tmp_path, frames):
    read = write(tmp_path, frames)
    assert read.scores == (("hits", "loss") if frames else ()), "a score without rows has none"
    assert read.frames.stamps_ns.tolist() == [i * 10 for i in range(frames)]
    assert read.frames.delivered.tolist() == [f"digest {i}" for i in range(frames)]
    for score in read.scores:
        layout = LAYOUTS[score]
        found = read.by_frame(score, layout.steps, layout.strata, layout.parts)
        assert np.array_equal(found.values, [sums_of(score, i) for i in range(frames)])


def test_sums_are_added_up_by_unit_in_the_steps_strata_and_parts_that_are_asked_for(tmp_path):
    read = write(tmp_path, 5)
    found = read.by_unit("hits", np.array([1, -1, 0, 1, 1]), [2, 0], ["dynamic"], ["fn", "tp"])
    by_hand = np.array([sums_of("hits", i) for i in range(5)])[:, [2, 0]][:, :, [1]][..., [2, 0]]
    assert found.values == pytest.approx(np.stack([by_hand[2], by_hand[0] + by_hand[3] + by_hand[4]]))
    assert np.array_equal(found["tp"], found.values[..., 1])
    skipped = read.by_unit("loss", np.zeros(5, np.int64), [1, 2], ["visible"]).values[0]
    assert not skipped[0].any(), "a step that the score does not have"
    assert skipped[1] == pytest.approx(sum(sums_of("loss", i)[1] for i in range(5)))


def test_frames_of_two_trials_are_common_with_the_same_stamp_after_the_same_frames(tmp_path):
    frames = write(tmp_path, 4).frames
    other = type(frames)(np.array([10, 20, 30, 99]), np.array(["digest 1", "another", "digest 3", "digest 0"]))
    assert frames.common_with(other).tolist() == [False, True, False, True]


def test_the_table_is_long_and_names_its_parts(tmp_path):
    write(tmp_path, 3)
    table = parquet.read_table(tmp_path / SUMS_FILE)
    assert table.column_names == list(COLUMNS)
    described = json.loads(table.schema.metadata[b"gridtrack"])
    row = table.filter(pa.compute.equal(table["score"].cast("string"), "hits")).slice(6 + 1, 1).to_pylist()[0]
    assert (row["stamp_ns"], row["step"], row["stratum"]) == (10, 0, "dynamic")
    parts = [described["scores"]["hits"]["parts"][part] for part in row["part"]]
    own = sums_of("hits", 1)[0, 1]
    assert dict(zip(parts, row["value"], strict=True)) == {
        name: value for name, value in zip(LAYOUTS["hits"].parts, own.tolist(), strict=True) if value
    }


def test_rows_are_written_in_groups_of_one_score_so_memory_does_not_grow(tmp_path):
    write(tmp_path, 2 * ROW_GROUP + 1)
    assert parquet.ParquetFile(tmp_path / SUMS_FILE).num_row_groups == 2 * 3


def test_sums_before_a_failure_are_kept(tmp_path):
    with pytest.raises(RuntimeError):
        write(tmp_path, 5, fail_after=2)
    assert len(TrialSums(tmp_path).frames.stamps_ns) == 2


def altered(folder, **columns):
    """Write the table again with these columns replaced, by functions of their values."""
    path = folder / SUMS_FILE
    table = parquet.read_table(path)
    for name, change in columns.items():
        at = table.schema.get_field_index(name)
        new = pa.array(change(table[name].to_pylist()), table.schema.field(name).type)
        table = table.set_column(at, table.schema.field(name), new)
    parquet.write_table(table, path)


DAMAGE = {
    "a step beyond the horizon": ({"step": lambda steps: [*steps[:-1], 9]}, "not 3 steps of"),
    "another stratum": ({"stratum": lambda names: ["static", *names[1:]]}, "not 3 steps of"),
    "a stamp of its own": ({"stamp_ns": lambda stamps: [5, *stamps[1:]]}, "not 3 steps of"),
    "a part that the score lacks": ({"part": lambda parts: [[7] * len(one) for one in parts]}, "a part beyond the"),
    "fewer values than parts": ({"value": lambda values: [[] for _ in values]}, "not 3 steps of"),
    "several scores in a group": ({"score": lambda names: ["loss", *names[1:]]}, "not of one known score"),
    "a score that is not described": ({"score": lambda names: ["other"] * len(names)}, "not of one known score"),
    "a value that is missing": ({"value": lambda values: [None, *values[1:]]}, "a value or a row is missing"),
}


@pytest.mark.parametrize(("columns", "reason"), DAMAGE.values(), ids=DAMAGE)
def test_a_damaged_table_is_refused_in_one_line(tmp_path, columns, reason):
    with SumsWriter(tmp_path, {"hits": LAYOUTS["hits"], "loss": LAYOUTS["loss"]}, STEPS) as writer:
        for i in range(2):
            writer.add(i * 10, f"digest {i}", "hits", np.ones((STEPS + 1, 2, 3)))
    altered(tmp_path, **columns)
    with pytest.raises(ScoresError, match=reason) as refused:
        TrialSums(tmp_path).by_unit("hits", np.zeros(2, np.int64), [0], ["visible"])
    assert "\n" not in str(refused.value)


def test_a_file_that_is_no_table_of_sums_or_of_another_version_is_refused_in_one_line(tmp_path):
    write(tmp_path, 1)
    path = tmp_path / SUMS_FILE
    table = parquet.read_table(path)
    metadata = json.loads(table.schema.metadata[b"gridtrack"])
    for content, reason in (
        (table.replace_schema_metadata({b"gridtrack": json.dumps(metadata | {"version": 7})}), "version 7 .* compare"),
        (table.replace_schema_metadata({b"gridtrack": b"[]"}), "cannot be read as sums"),
        (table.replace_schema_metadata(None), "cannot be read as sums"),
        (table.replace_schema_metadata({b"gridtrack": json.dumps(metadata | {"steps": 1})}), "cannot be read as sums"),
        (table.drop_columns(["value"]), "columns stamp_ns, .* expected"),
    ):
        parquet.write_table(content, path)
        with pytest.raises(ScoresError, match=reason) as refused:
            TrialSums(tmp_path)
        assert "\n" not in str(refused.value)
    path.write_bytes(b"PAR1 not really")
    for folder in (tmp_path, tmp_path / "nowhere"):
        with pytest.raises(ScoresError, match=r"sums\.parquet: cannot be read as sums"):
            TrialSums(folder)


def test_a_small_file_that_unpacks_to_gigabytes_is_refused_before_it_is_read(tmp_path):
    """Equal rows take no room: a hundred million of them are a file of some kilobytes."""
    write(tmp_path, 1)
    table = parquet.read_table(tmp_path / SUMS_FILE)
    hits = table.filter(pa.compute.equal(table["score"].cast("string"), "hits")).slice(0, 1)
    many = pa.concat_tables([hits] * 100_000).combine_chunks()
    parquet.write_table(many, tmp_path / SUMS_FILE, compression="zstd")
    with pytest.raises(ScoresError, match=r"100000 rows and \d+ values together, more than a trial writes: refused"):
        _ = TrialSums(tmp_path).scores
