"""The store of scores: round trip, complete files after a failure, bounded memory."""

import numpy as np
import polars as pl
import pyarrow as pa
import pytest
from pyarrow import parquet

from gridtrack.evaluation.results.columns import (
    CALIBRATION_BINS,
    CONFUSION,
    HISTOGRAM_TABLE,
    PROBABILITY_BINS,
    SCORES_TABLE,
)
from gridtrack.evaluation.scoring.counting import HALF, Tally
from gridtrack.evaluation.scoring.histograms import read_tally
from gridtrack.evaluation.scoring.label_free import LabelFreeThresholds
from gridtrack.evaluation.scoring.score_store import (
    ScoresError,
    ScoreWriter,
    read_label_free,
)
from gridtrack.evaluation.scoring.store_writer import ROW_GROUP
from gridtrack.evaluation.referee.strata import STRATA
from gridtrack.evaluation.scoring.thresholds import Thresholds, half

STEPS = 2
THRESHOLDS = Thresholds(np.array([[HALF, 10, 400, 5, 6], [3, 25, 8, 7, 300], [11, 490, 1, 2, 44]]), "validation")


def random_tally(seed):
    rng = np.random.default_rng(seed)
    plain = (STEPS + 1, len(STRATA))
    positives = rng.integers(0, 3, (*plain, PROBABILITY_BINS)) * (rng.random((*plain, PROBABILITY_BINS)) < 0.3)
    cells = positives + rng.integers(0, 2, positives.shape)
    return Tally(cells, positives, rng.random((*plain, CALIBRATION_BINS)), *rng.random((2, *plain)))


def write(folder, frames, every_ns=400_000_000):
    total = Tally.empty(STEPS)
    with ScoreWriter(folder, STEPS, THRESHOLDS) as writer:
        for i in range(frames):
            writer.add(i * every_ns, f"digest {i}", random_tally(i), i * every_ns)
            total.add(random_tally(i))
    return total


@pytest.mark.parametrize("frames", [0, 1, 7, 3 * ROW_GROUP])
def test_counts_survive_a_round_trip(tmp_path, frames):
    total, read = write(tmp_path, frames), read_tally(tmp_path, STEPS)
    assert np.array_equal(read.cells, total.cells)
    assert np.array_equal(read.positives, total.positives)
    for name in ("p_sum", "squared_error", "log_loss"):
        assert getattr(read, name) == pytest.approx(getattr(total, name))


def test_each_scored_frame_has_its_confusion_counts_per_step_and_stratum(tmp_path):
    write(tmp_path, 3)
    scores = pl.read_parquet(tmp_path / SCORES_TABLE.file)
    assert len(scores) == 3 * (STEPS + 1) * len(STRATA)
    row = scores.filter((pl.col("stamp_ns") == 400_000_000) & (pl.col("step") == 2) & (pl.col("stratum") == "dynamic"))
    expected = random_tally(1).confusion(THRESHOLDS.bins)[2, STRATA.index("dynamic")]
    assert row.select(CONFUSION).row(0) == tuple(expected)
    expected_at_half = random_tally(1).confusion(half(STEPS).bins)[2, STRATA.index("dynamic")]
    assert row.select([f"{name}_half" for name in CONFUSION]).row(0) == tuple(expected_at_half)
    label_free = LabelFreeThresholds(STEPS, STRATA)
    label_free.add(0, random_tally(0))
    expected_label_free = random_tally(1).confusion(label_free.bins(400_000_000))[2, STRATA.index("dynamic")]
    assert row.select([f"{name}_label_free" for name in CONFUSION]).row(0) == tuple(expected_label_free)
    all_frames = scores.filter((pl.col("step") == 2) & (pl.col("stratum") == "dynamic"))
    summed = all_frames.select([f"{name}_label_free" for name in CONFUSION]).sum().row(0)
    assert tuple(read_label_free(tmp_path, STEPS, ("dynamic",))[2, 0]) == summed


def test_the_histogram_has_the_rows_of_the_scores_and_agrees_with_them(tmp_path):
    write(tmp_path, 7)
    histogram, scores = (pl.read_parquet(tmp_path / table.file) for table in (HISTOGRAM_TABLE, SCORES_TABLE))
    for key in ("stamp_ns", "step", "stratum"):
        assert histogram[key].equals(scores[key])
    assert (
        histogram["count"].list.sum().equals(scores.select(pl.sum_horizontal(CONFUSION)).to_series(), check_names=False)
    )
    assert histogram["count"].list.min().min() > 0


def test_a_histogram_of_an_earlier_version_is_refused_in_one_line(tmp_path):
    write(tmp_path, 1)
    path = tmp_path / HISTOGRAM_TABLE.file
    parquet.write_table(parquet.read_table(path).replace_schema_metadata(None), path)
    with pytest.raises(ScoresError, match=r"histogram\.parquet: version '1' .* compare again") as refused:
        read_tally(tmp_path, STEPS)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("column", ["bin", "count"])
def test_a_histogram_with_other_bins_than_declared_is_refused(tmp_path, column):
    write(tmp_path, 1)
    path = tmp_path / HISTOGRAM_TABLE.file
    table = parquet.read_table(path)
    other = [[PROBABILITY_BINS] if column == "bin" else [] for _ in range(len(table))]
    at = table.schema.get_field_index(column)
    changed = table.set_column(at, table.schema.field(column), pa.array(other, table.schema.field(column).type))
    parquet.write_table(changed, path)
    with pytest.raises(ScoresError, match="not histograms of"):
        read_tally(tmp_path, STEPS)


def test_rows_are_written_in_groups_so_memory_does_not_grow(tmp_path):
    write(tmp_path, 3 * ROW_GROUP + 1)
    assert parquet.ParquetFile(tmp_path / SCORES_TABLE.file).num_row_groups == 4


def test_counts_before_a_failure_are_kept(tmp_path):
    def crash_after_two():
        with ScoreWriter(tmp_path, STEPS, THRESHOLDS) as writer:
            writer.add(0, "a", random_tally(0), 0)
            writer.add(100_000_000, "b", random_tally(1), 100_000_000)
            raise RuntimeError

    with pytest.raises(RuntimeError):
        crash_after_two()
    kept = pl.read_parquet(tmp_path / SCORES_TABLE.file).select("stamp_ns", "delivered").unique()
    assert set(kept.iter_rows()) == {(0, "a"), (100_000_000, "b")}
    assert read_tally(tmp_path, STEPS).cells.sum() == random_tally(0).cells.sum() + random_tally(1).cells.sum()


def test_a_file_that_is_no_store_is_refused_in_one_line(tmp_path):
    write(tmp_path, 1)
    (tmp_path / SCORES_TABLE.file).write_bytes(b"PAR1 not really")
    with pytest.raises(ScoresError, match=r"scores\.parquet: cannot be read") as refused:
        read_tally(tmp_path, STEPS)
    assert "\n" not in str(refused.value)
    with pytest.raises(ScoresError):
        read_tally(tmp_path / "nowhere", STEPS)


def test_steps_beyond_the_runs_horizon_are_refused(tmp_path):
    write(tmp_path, 1)
    with pytest.raises(ScoresError, match="expected 0 to 1"):
        read_tally(tmp_path, 1)
