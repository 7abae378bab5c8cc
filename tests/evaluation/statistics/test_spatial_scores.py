"""Fractions skill score, soft IoU and beam errors of a run: from the sums of all its frames, with intervals."""

from __future__ import annotations

import re

import numpy as np
import polars as pl
import pytest
from scipy import stats

from gridtrack.evaluation.results.columns import (
    BEAM_ERROR_BINS,
    BEAM_ERROR_EDGES_M,
    BEAMS_TABLE,
    NEIGHBOURHOODS_TABLE,
    SCALES,
)
from gridtrack.evaluation.scoring.score_store import ScoresError
from gridtrack.evaluation.referee.strata import STRATA_WITH_TRUTH
from gridtrack.evaluation.statistics.spatial_scores import (
    beam_scores,
    median_size,
    neighbourhood_scores,
    spatial_ratios,
)
from gridtrack.evaluation.statistics.summary import summarise

from scenes import synthetic_run as synthetic

RECORDINGS = [f"seed-{i:02}" for i in range(20)]
SCORES = (*(f"fss_{scale}" for scale in SCALES), "soft_iou", "beam_error", "beam_error_median", "beam_bias")


def summary_of(trials):
    names = dict.fromkeys(trial.record.recording for trial in trials)
    return summarise({name: synthetic.description() for name in names}, trials, [], False)


def write(folder, recordings=RECORDINGS, **others):
    return [
        synthetic.write_trial(folder, label, name, skill, seed=i, frames=6, **others)
        for i, name in enumerate(recordings)
        for label, skill in {"persistence": 0.5, "good": 0.8}.items()
    ]


@pytest.fixture(scope="module")
def twenty(tmp_path_factory):
    trials = write(tmp_path_factory.mktemp("twenty"))
    return trials, summary_of(trials)


def rows_of(trials, label, table, stratum, step=8):
    own = [pl.read_parquet(t.folder / table.file) for t in trials if t.record.label == label]
    return pl.concat(own).filter((pl.col("stratum") == stratum) & (pl.col("step") == step))


def test_scores_are_ratios_of_sums_over_all_frames_and_not_means_of_ratios(twenty):
    trials, summary = twenty
    found = summary.trackers["good"].pooled.strata["in-motion"]
    sums = rows_of(trials, "good", NEIGHBOURHOODS_TABLE, "in-motion").sum()
    for scale in SCALES:
        expected = sums[f"agreement_{scale}"][0] / sums[f"squares_{scale}"][0]
        assert found.at(f"fss_{scale}", 8) == pytest.approx(expected, abs=1e-5)
    assert found.soft_iou[8] == pytest.approx(sums["agreement_1"][0] / 2 / sums["soft_union"][0], abs=1e-5)
    beams = rows_of(trials, "good", BEAMS_TABLE, "in-motion")
    number = beams["count"].list.sum().sum()
    late, early = beams["late_m"].sum(), beams["early_m"].sum()
    assert found.beam_error[8] == pytest.approx((late + early) / number, abs=1e-5)
    assert found.beam_bias[8] == pytest.approx((late - early) / number, abs=1e-5)


@pytest.mark.parametrize("score", SCORES)
def test_every_score_has_an_interval_from_twenty_recordings_on_and_less_have_none(twenty, score):
    _, summary = twenty
    row = summary.trackers["good"]
    of_all, of_one = row.pooled.strata["visible"], row.recordings[RECORDINGS[0]].strata["visible"]
    assert of_all.at(f"{score}_low", 8) < of_all.at(score, 8) < of_all.at(f"{score}_high", 8)
    assert of_one.at(score, 8) is not None
    assert of_one.at(f"{score}_low", 8) is of_one.at(f"{score}_high", 8) is None


def sums_of(trials, label, score, stratum, step):
    """Numerator and denominator (20,) of a score, by recording."""
    if score == "beam_error":
        sums = [pl.col("late_m") + pl.col("early_m"), pl.col("count").list.sum().cast(pl.Float64)]
        table = BEAMS_TABLE
    else:
        part, whole = ("agreement_1", "soft_union") if score == "soft_iou" else (f"agreement_{score[4:]}",) * 2
        sums = [pl.col(part) / (2 if score == "soft_iou" else 1), pl.col(whole.replace("agreement", "squares"))]
        table = NEIGHBOURHOODS_TABLE
    kept = (pl.col("stratum") == stratum) & (pl.col("step") == step)
    own = [pl.read_parquet(t.folder / table.file).filter(kept) for t in trials if t.record.label == label]
    return np.array([[one.select(column.sum().alias("sum"))["sum"][0] for column in sums] for one in own], float).T


@pytest.mark.parametrize("score", [*(f"fss_{scale}" for scale in SCALES), "soft_iou", "beam_error"])
def test_the_difference_from_the_reference_is_paired_by_recording(twenty, score):
    """The jackknife over recordings of the difference of the two ratios, computed one recording at a time."""
    trials, summary = twenty
    (difference,) = summary.differences
    (test,) = [one for one in difference.headline if (one.stratum, one.horizon_s) == ("in-motion", 1.0)]
    sides = [sums_of(trials, label, score, "in-motion", 8) for label in ("good", "persistence")]
    value, *without = (
        np.subtract(*(part[kept].sum() / whole[kept].sum() for part, whole in sides))
        for kept in (np.ones(20, bool), *~np.eye(20, dtype=bool))
    )
    error = np.sqrt(19 / 20 * np.sum((without - np.mean(without)) ** 2))
    freedom = min(whole.sum() ** 2 / (whole**2).sum() for _, whole in sides) - 1
    assert getattr(test, score) == pytest.approx(value, abs=2e-5)
    ends = value + np.array([-1, 1]) * stats.t.ppf(0.975, freedom) * error
    assert (getattr(test, f"{score}_low"), getattr(test, f"{score}_high")) == pytest.approx(ends, abs=2e-5)
    assert getattr(test, f"{score}_p") == pytest.approx(2 * stats.t.sf(abs(value) / error, freedom), abs=5e-4)


def test_sums_that_are_paired_are_those_of_the_common_frames(twenty):
    trials, _ = twenty
    trial = next(trial for trial in trials if trial.record.label == "good")
    scored = pl.read_parquet(trial.folder / NEIGHBOURHOODS_TABLE.file)["stamp_ns"].unique().sort().to_numpy()
    paired, chosen = scored[[1, 3, 4]], [(8, "in-motion"), (4, "visible")]
    found = spatial_ratios([trial], [scored], [paired], [np.array([0, 0, 1])], chosen)
    for table, columns, score in (
        (NEIGHBOURHOODS_TABLE, pl.col("agreement_3") * 9, "fss_3"),
        (BEAMS_TABLE, pl.col("late_m") + pl.col("early_m"), "beam_error"),
    ):
        rows = pl.read_parquet(trial.folder / table.file).with_columns(part=columns)
        for n, (step, stratum) in enumerate(chosen):
            own = rows.filter((pl.col("step") == step) & (pl.col("stratum") == stratum)).sort("stamp_ns")["part"]
            expected = own[1] + own[3], own[4]
            assert found[score][0][:, n] == pytest.approx(expected, rel=1e-5)


def test_strata_without_neighbourhoods_or_beams_have_no_such_score(tmp_path):
    summary = summary_of(write(tmp_path, RECORDINGS[:1], strata=STRATA_WITH_TRUTH))
    strata = summary.trackers["good"].recordings[RECORDINGS[0]].strata
    having = {score: {name for name in strata if getattr(strata[name], score) is not None} for score in SCORES}
    assert having["fss_3"] == having["soft_iou"] == {"visible", "dynamic", "in-motion", "occluded"}
    assert having["beam_error"] == having["beam_bias"] == {"visible", "dynamic", "static", "in-motion", "standing"}


@pytest.mark.parametrize("trials_of_before", [1, 40])
def test_a_run_of_before_has_all_other_scores(tmp_path, twenty, trials_of_before):
    """Its trials lack the files; where only one does, the pooled scores of its tracker are undefined."""
    _, whole = twenty
    trials = write(tmp_path)
    for trial in trials[:trials_of_before]:
        for table in (NEIGHBOURHOODS_TABLE, BEAMS_TABLE):
            (trial.folder / table.file).unlink()
    summary = summary_of(trials)
    of_before, known = (one.trackers["persistence"].pooled.strata["dynamic"] for one in (summary, whole))
    assert of_before.f1 == known.f1
    assert of_before.f1_low == known.f1_low
    assert all(of_before.at(score, 8) is None for score in SCORES)
    (difference,) = summary.differences
    assert all(test.f1_low < test.f1 for test in difference.headline)
    assert all(test.fss_5 is None and test.beam_error_p is None for test in difference.headline)
    good = summary.trackers["good"].pooled.strata["dynamic"].fss_3
    assert (good is None) == (trials_of_before == 40)


def rewritten(path, change):
    change(pl.read_parquet(path)).write_parquet(path)


@pytest.mark.parametrize(
    ("table", "change", "said"),
    [
        (NEIGHBOURHOODS_TABLE, lambda rows: rows[1:], "not 21 steps of visible, dynamic, in-motion"),
        (NEIGHBOURHOODS_TABLE, lambda rows: rows[21 * 3 :], "not the frames of the scores beside it"),
        (BEAMS_TABLE, lambda rows: rows[21 * 5 :], "not the frames of the scores beside it"),
        (BEAMS_TABLE, lambda rows: rows.with_columns(bin=pl.col("bin") + 1000), f"not errors in {BEAM_ERROR_BINS}"),
        (BEAMS_TABLE, lambda rows: rows.with_columns(bin=pl.col("bin").list.head(1)), "not errors in"),
        (BEAMS_TABLE, lambda rows: rows.drop("late_m"), "cannot be read as scores"),
    ],
)
def test_files_that_do_not_fit_the_scores_are_refused_in_one_line(tmp_path, table, change, said):
    trials = write(tmp_path, RECORDINGS[:1])
    rewritten(trials[0].folder / table.file, change)
    with pytest.raises(ScoresError, match=rf"{re.escape(table.file)}: .*{said}") as refused:
        summary_of(trials)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("seed", range(5))
def test_the_median_of_binned_errors_is_that_of_the_errors_within_a_part_of_a_bin(seed):
    errors = np.random.default_rng(seed).lognormal(-2.0, 1.5, 501)
    counts = np.histogram(errors, BEAM_ERROR_EDGES_M)[0]
    assert median_size(counts) == pytest.approx(np.median(errors), rel=0.05)


def test_the_median_of_no_beams_is_undefined_and_that_of_errors_beyond_the_bins_is_their_edge():
    counts = np.zeros((2, BEAM_ERROR_BINS), np.int64)
    counts[1, -1] = 3
    none, beyond = median_size(counts)
    assert np.isnan(none)
    assert beyond == BEAM_ERROR_EDGES_M[-2]


def coverage(draw, truth, score, repetitions=300):
    """Share of intervals that contain the true score; `draw(rng)` gives the scores of twenty units."""
    rng = np.random.default_rng(7)
    inside = 0
    for _ in range(repetitions):
        ends = {name: (low[0, 0], high[0, 0]) for name, _, low, high in draw(rng)}
        inside += ends[score][0] <= truth <= ends[score][1]
    return inside / repetitions


def test_intervals_of_the_median_and_of_the_fractions_skill_score_cover_what_they_should():
    """Units differ in how much they hold and in how good the forecast is in them; the truth is that of many units."""

    def beams(rng, units=20):
        errors = [rng.lognormal(rng.normal(-1.5, 0.3), 1.0, rng.poisson(400)) for _ in range(units)]
        counts = np.stack([np.histogram(own, BEAM_ERROR_EDGES_M)[0] for own in errors])[:, None, None]
        late = np.array([own.sum() for own in errors])[:, None, None]
        return beam_scores(late, np.zeros_like(late), counts)

    def neighbourhoods(rng, units=20):
        squares = rng.gamma(4.0, 5.0, (units, 1, 1, len(SCALES)))
        agreement = squares * rng.beta(6.0, 4.0, squares.shape)
        return neighbourhood_scores(np.concatenate([agreement, squares, squares[..., :1]], axis=-1))

    many = {name: value[0, 0] for name, value, *_ in beams(np.random.default_rng(0), 5000)}
    for score in ("beam_error", "beam_error_median", "beam_bias"):
        assert 0.91 < coverage(beams, many[score], score) < 0.985, score
    assert 0.91 < coverage(neighbourhoods, 0.6, "fss_9") < 0.985


def test_soft_iou_has_the_same_interval_in_any_unit_and_a_fraction_counts_in_lone_cells():
    rng = np.random.default_rng(3)
    squares = rng.gamma(4.0, 0.5, (20, 1, 1, len(SCALES)))
    sums = np.concatenate([0.6 * squares * rng.beta(6.0, 4.0, squares.shape), squares, squares[..., :1]], axis=-1)
    once, thousand = ({name: (low, high) for name, _, low, high in neighbourhood_scores(k * sums)} for k in (1, 1000))
    assert np.ravel(once["soft_iou"]) == pytest.approx(np.ravel(thousand["soft_iou"]))
    widths = [float(np.ptp(np.ravel(ends["fss_1"]))) for ends in (once, thousand)]
    assert widths[0] < 0.99 * widths[1], "half a lone cell is added to both sums"
