"""The study of drives pairs the same minute of two kinds of poses, and refuses scores of some drives only."""

from __future__ import annotations

import zlib
from pathlib import Path

import pytest

from gridtrack.evaluation.referee.strata import STRATA_WITH_TRUTH
from gridtrack.evaluation.runs.summarise import summarise

from scenes.synthetic_run import description, write_trial
from studies.moving import Comparison, difference_section, pair_section, score_tables, view_section


def compared(
    folder: Path,
    kind: str,
    skill: float,
    *,
    floor: float = 0.3,
    minutes: int = 2,
    start_s: int = 10,
    scored: int = 2,
) -> Comparison:
    """A comparison of kalman, persistence and the oracle, two forecasts in each of `minutes`; counts are random."""
    names = [f"car-{200 + minute}-{kind}" for minute in range(minutes)]
    trials = [
        write_trial(
            folder / kind,
            row,
            name,
            better,
            seed=zlib.crc32(name.encode()),
            frames=2,
            scored=scored,
            strata=STRATA_WITH_TRUTH,
            delivered=kind,
            start_s=start_s,
        )
        for name in names
        for row, better in (("kalman", skill), ("persistence", floor), ("oracle", 1.0))
    ]
    described = {name: description(2, source_sha256=name.ljust(64, "0")) for name in names}
    summarise(described, trials, [], interrupted=False).write(folder / kind)
    return Comparison.read(kind, folder / kind)


def test_the_loss_without_ego_motion_is_paired_over_twenty_drives(tmp_path: Path) -> None:
    perfect, ignored = (compared(tmp_path, *of, minutes=20) for of in (("perfect", 0.8), ("ignored", 0.5)))
    section = difference_section([perfect, ignored], ["kalman"])
    text = section.values["kalman, perfect less ignored, dynamic, 1 s"]
    value, low, high = (float(one.strip("[],")) for one in text.split())
    assert 0.1 < low < value < high < 0.4
    assert set(section.tables) == {"in motion", "dynamic", "visible", "hidden"}


def test_a_loss_that_persistence_has_too_is_of_the_view(tmp_path: Path) -> None:
    perfect = compared(tmp_path, "perfect", 0.6, floor=0.3, minutes=20)
    text = {
        kind: view_section([perfect, compared(tmp_path, kind, 0.8, floor=floor, minutes=20)], ["persistence", "kalman"])
        for kind, floor in (("both-lose", 0.5), ("kalman-loses", 0.3))
    }
    lost = {kind: section.values["kalman, dynamic, 1 s"].split() for kind, section in text.items()}
    value, low, high = (float(one.strip("[],")) for one in lost["kalman-loses"])
    assert -0.4 < low < value < high < -0.05
    value, low, high = (float(one.strip("[],")) for one in lost["both-lose"])
    assert low < 0 < high
    assert abs(value) < 0.1
    assert [row[0] for row in text["both-lose"].tables["dynamic"].rows] == ["kalman"]


def test_the_scores_have_a_row_for_each_kind_and_tracker_after_the_oracle(tmp_path: Path) -> None:
    both = [compared(tmp_path, "perfect", 0.8), compared(tmp_path, "beside", 0.8)]
    rows = score_tables(both, ["kalman"])["dynamic"].rows
    assert [row[0] for row in rows] == ["oracle, perfect", "oracle, beside", "kalman, perfect", "kalman, beside"]
    assert all(len(row) == 4 for row in rows)


def test_minutes_that_were_scored_at_other_times_are_not_paired(tmp_path: Path) -> None:
    perfect, later = compared(tmp_path, "perfect", 0.8), compared(tmp_path, "ignored", 0.8, start_s=11)
    with pytest.raises(SystemExit, match="scored at other times"):
        perfect.less(later, "kalman")


def test_a_comparison_that_ended_early_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match=r"is not complete \(0 of 2 recordings"):
        compared(tmp_path, "perfect", 0.8, scored=1)


def test_trackers_are_told_apart_where_the_drives_do(tmp_path: Path) -> None:
    better, equal = (compared(tmp_path, f"x{skill}", skill, floor=0.4, minutes=20) for skill in (0.8, 0.4))
    for found, told in ((better, True), (equal, False)):
        table = pair_section(found).tables["pairs"]
        (row,) = table.rows
        assert (table.columns[1:], row[0]) == (("in motion", "dynamic", "visible"), "kalman less persistence")
        assert ["°" not in text for text in row[1:]] == [told] * 3
