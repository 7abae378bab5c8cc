"""Statistical units against plain sums over the rows of a trial's scores, and the division of a trial into units."""

from __future__ import annotations

import pytest
from pyarrow import parquet

from gridtrack.evaluation.regression.units import band_of, read_scored_trial, units_by_recording
from gridtrack.evaluation.statistics.units import UnitRule

HORIZONS_S = [n * 0.125 for n in range(17)]
FRAMES = 8
STRATA = ("visible", "dynamic", "static")


@pytest.fixture
def trial(write_run):
    """A trial's folder: eight frames, one second apart."""
    return write_run("run", {"kalman": {}}, recordings=1) / "kalman@junction-00"


def units_of(folder, block_s):
    """The units of one trial, in blocks of `block_s`; None: one unit."""
    scored = read_scored_trial(folder, HORIZONS_S, STRATA, FRAMES)
    (numbers,) = UnitRule(("one",), block_s).units_of([scored.frames.stamps_ns])
    return units_by_recording({"one": scored}, {"one": numbers})["one"]


def test_counts_are_sums_over_the_frames_and_steps_of_each_unit(trial):
    rows = parquet.read_table(trial / "scores.parquet").to_pylist()
    units = units_of(trial, 4.0)
    assert [unit.frames for unit in units] == [4, 4]
    first_ns = rows[0]["stamp_ns"]
    for number, unit in enumerate(units):
        for stratum, bands in unit.counts.items():
            for band, (*counts, log_loss) in bands.items():
                mine = [
                    row
                    for row in rows
                    if row["stratum"] == stratum
                    and band_of(HORIZONS_S[row["step"]]) == band
                    and (row["stamp_ns"] - first_ns) // 4_000_000_000 == number
                ]
                assert counts == [sum(row[name] for row in mine) for name in ("tp", "fp", "fn", "tn")]
                assert log_loss == pytest.approx(sum(row["log_loss"] for row in mine), rel=1e-5)


def test_bands_end_at_half_a_second_and_at_one_and_a_half_and_step_0_is_in_none():
    bands = [band_of(horizon) for horizon in (0.0, 0.125, 0.5, 0.625, 1.5, 1.625, 60.0)]
    assert bands == [None, "short", "short", "middle", "middle", "long", "long"]


@pytest.mark.parametrize(("block_s", "units"), [(None, 1), (100.0, 1), (7.0, 1), (4.0, 2), (1.0, 8), (0.1, 8)])
def test_blocks_have_at_least_the_requested_length_and_none_is_empty(trial, block_s, units):
    found = units_of(trial, block_s)
    assert len(found) == units
    assert sum(unit.frames for unit in found) == FRAMES


def test_the_digest_of_a_unit_identifies_its_frames(trial):
    digests = [unit.delivered for unit in units_of(trial, 1.0)]
    assert len(set(digests)) == len(digests)
    assert units_of(trial, None)[0].delivered == units_of(trial, 100.0)[0].delivered
