"""The studies of unseen places pool recordings of unlike periods, state their aim, and name what was not measured."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from pathlib import Path

import pytest

from gridtrack.evaluation.referee.strata import STRATA_WITH_TRUTH
from gridtrack.evaluation.runs.summarise import summarise

from scenes.synthetic_run import description, write_trial
from studies.real_results import sections_of as sections_of_real
from studies.site_minutes import rows_of, section_of, share_closed
from studies.support.real_recordings import REAL
from studies.support.results_file import measured_table
from studies.support.scale_charts import scale_charts
from studies.support.unseen_places import PlaceScores, general_rows, not_measured
from studies.support.world_lasers import DRIVES, ODOMETRY, STANDS
from studies.worlds_results import aim_met, aim_table, pair_tables, poses_section, sections_of

PERIODS_S = (0.1, 0.105263, 0.0625)
SKILLS = {"oracle": 1.0, "persistence": 0.5, "kalman": 0.8}


def run_of(
    folder: Path,
    names: list[str],
    skills: dict[str, float],
    *,
    scored: int = 2,
    periods_s: Sequence[float] = PERIODS_S,
) -> PlaceScores:
    """A comparison on recordings of these periods in turns, two forecasts on each; counts are drawn at random."""
    period_s = {name: periods_s[k % len(periods_s)] for k, name in enumerate(names)}
    steps = {name: round(1.0 / of_name) for name, of_name in period_s.items()}
    trials = [
        write_trial(
            folder,
            label,
            name,
            skill,
            seed=zlib.crc32(name.encode()),
            frames=2,
            scored=scored,
            strata=STRATA_WITH_TRUTH,
            steps=steps[name],
            tracker=label.partition(" ")[0],
        )
        for name in names
        for label, skill in skills.items()
    ]
    described = {
        name: description(2, source_sha256=name.ljust(64, "0"), period_s=period_s[name], steps=steps[name])
        for name in names
    }
    summarise(described, trials, [], interrupted=False).write(folder)
    return PlaceScores.read(folder)


@pytest.fixture(scope="module")
def worlds(tmp_path_factory: pytest.TempPathFactory) -> PlaceScores:
    names = [f"{part}-{k}" for k in range(10) for part in ("indoors", "outdoors")]
    return run_of(tmp_path_factory.mktemp("worlds"), names, SKILLS)


def test_twenty_worlds_have_intervals_and_ten_of_them_none(worlds: PlaceScores) -> None:
    tables = sections_of(worlds)["scores"].tables
    assert [row[0] for row in tables["dynamic"].rows] == list(SKILLS)
    assert tables["dynamic"].columns == ("F1, dynamic", "0.5 s", "1 s")
    assert all("[" in text for row in tables["dynamic"].rows for text in row[1:])
    apart = tables["indoors and outdoors"]
    assert apart.columns[1:3] == ("indoors, in motion", "indoors, dynamic")
    assert not any("[" in text for row in apart.rows for text in row)


@pytest.fixture(scope="module")
def contenders(tmp_path_factory: pytest.TempPathFactory) -> PlaceScores:
    names = [f"indoors-{1000 + k}" for k in range(20)]
    skills = {"persistence": 0.5, "kalman": 0.8, "dogma": 0.498, "dilated-convgru": 0.798, "dilated-convgru 2": 0.5}
    return run_of(tmp_path_factory.mktemp("contenders"), names, skills)


def test_a_difference_that_may_be_chance_is_marked(contenders: PlaceScores) -> None:
    marked = {row[0]: ["°" in text for text in row[1:]] for row in contenders.difference_table("dynamic").rows}
    assert marked == {
        "kalman less persistence": [False, False],
        "dogma less persistence": [True, True],
        "dilated-convgru less persistence": [False, False],
    }


def test_each_pair_of_contenders_has_its_difference_with_a_mark_where_it_may_be_chance(contenders: PlaceScores) -> None:
    f1 = {row[0]: row[1] for row in pair_tables(contenders)["F1"].rows}
    assert {pair: (text[0], "°" in text) for pair, text in f1.items()} == {
        "kalman less dogma": ("+", False),
        "kalman less dilated-convgru": ("+", True),
        "dogma less dilated-convgru": ("-", False),
    }


def test_log_losses_of_pairs_have_the_decimals_to_tell_them_apart(contenders: PlaceScores) -> None:
    difference = pair_tables(contenders)["log loss"].rows[0][1].partition(" ")[0]
    assert len(difference.partition(".")[2]) == 4


def test_the_aim_is_judged_where_it_was_measured_and_named_where_it_was_not(worlds: PlaceScores) -> None:
    rows = aim_table(worlds).rows
    verdicts = {row[0]: row[-1] for row in rows}
    assert verdicts == {
        "dilated-convgru less persistence, 0.5 s": "not measured",
        "dilated-convgru less persistence, 1 s": "not measured",
        "kalman less persistence, 0.5 s": "met",
        "kalman less persistence, 1 s": "met",
    }
    assert sections_of(worlds)["scores"].values["not measured"].startswith("`static-map`, `blank`, `factor-graph`")


def test_worlds_with_refined_poses_take_the_place_of_those_with_the_poses_of_the_wheels(tmp_path: Path) -> None:
    lasers = {f"world-{10 + k}": (STANDS, DRIVES, ODOMETRY)[k // 7] for k in range(21)}
    drivers = [name for name, laser in lasers.items() if laser == ODOMETRY]
    recorded = run_of(tmp_path / "recorded", list(lasers), {"persistence": 0.5, "kalman": 0.55})
    refined = run_of(tmp_path / "refined", drivers, {"persistence": 0.5, "kalman": 0.95})
    tables = poses_section(recorded, refined, lasers, drift=measured_table(("",), [])).tables
    assert tables["by laser"].columns[1::2] == tuple(
        f"{kind}, 0.5 s" for kind in ("stands (7)", "drives (7)", "drives, odometry (7)", "drives, refined")
    )
    verdicts = {
        name: [row[-1] for row in table.rows][-1]
        for name, table in (("recorded", aim_table(recorded)), ("refined", tables["aim"]))
    }
    assert verdicts == {"recorded": "not met", "refined": "met"}


@pytest.mark.parametrize(
    ("difference", "low", "verdict"),
    [(0.1, 0.01, "met"), (0.099, 0.05, "not met"), (0.2, -0.01, "not met"), (0.2, None, "no interval")],
)
def test_the_aim_asks_for_the_difference_and_for_an_interval_apart(
    difference: float, low: float | None, verdict: str
) -> None:
    assert aim_met(difference, low) == verdict


def test_the_charts_have_a_curve_of_each_row_at_both_horizons_beside_persistence_and_the_oracle(
    worlds: PlaceScores,
) -> None:
    drawn = scale_charts(worlds, "dynamic")
    assert drawn.count("<polyline") == 6
    assert "model-free pipeline" in drawn
    assert "networks" not in drawn


def test_further_trainings_are_in_the_table_of_their_spread_and_are_no_rows_of_their_own(tmp_path: Path) -> None:
    names = [f"indoors-{k}" for k in range(3)]
    scores = run_of(tmp_path, names, {"persistence": 0.5, "dilated-convgru": 0.7, "dilated-convgru 2": 0.75})
    assert scores.labels == ["persistence", "dilated-convgru"]


def test_recordings_of_one_period_have_the_steps_nearest_to_the_horizons(tmp_path: Path) -> None:
    scores = run_of(tmp_path, ["walker-1", "walker-3"], {"persistence": 0.5}, periods_s=(0.133333,))
    assert scores.horizons == {0.5: 4, 1.0: 8}
    assert scores.table("F1", [("1 s", "dynamic", "f1", 1.0)]).rows[0][0] == "persistence"
    assert set(scores.occupied("dynamic", 1.0)) == {"walker-1", "walker-3"}


def test_a_comparison_that_ended_early_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match="not complete"):
        run_of(tmp_path, ["indoors-1", "indoors-2"], {"persistence": 0.5}, scored=1)


def test_rows_are_those_without_weights_and_those_with_general_ones(tmp_path: Path) -> None:
    cards = [
        "weights/kalman/general.toml",
        "weights/dogma/hall.toml",
        "trainings/seed-2/kalman/general.toml",
        "trainings/seed-2/dogma/general.toml",
    ]
    for card in cards:
        (tmp_path / card).parent.mkdir(parents=True)
        (tmp_path / card).touch()
    rows = general_rows(tmp_path / "weights", tmp_path / "trainings")
    assert list(rows) == ["persistence", "blank", "kalman", "kalman 2"]
    assert rows["kalman"] == f"kalman=kalman:weights={tmp_path / 'weights'},card=general"
    assert rows["kalman 2"].startswith(f"kalman 2=kalman:weights={tmp_path / 'trainings' / 'seed-2'},")
    assert "`dogma`" in not_measured(rows)


def test_the_real_recordings_are_described_one_by_one_and_those_left_out_are_named(tmp_path: Path) -> None:
    scores = run_of(tmp_path, ["corridor", "aces"], {"persistence": 0.5})
    section = sections_of_real(scores)["scores"]
    assert [row[:2] for row in section.tables["recordings"].rows] == [("corridor", "stands"), ("aces", "moves")]
    assert [row[0] for row in section.tables["by recording"].rows] == ["corridor, persistence", "aces, persistence"]
    left_out = section.values["recordings not measured"].split(", ")
    assert left_out == [one.name for one in REAL if one.name not in ("corridor", "aces")]
    assert section.values["intervals"].startswith("too short for an interval")


def test_minutes_of_a_site_stand_between_general_and_site_weights(tmp_path: Path) -> None:
    rows = rows_of("kalman", (1, 65), Path("general"), tmp_path)
    assert list(rows) == ["kalman-general", "kalman-1-min", "kalman-65-min", "kalman-site"]
    assert rows["kalman-1-min"] == f"kalman-1-min=kalman:weights={tmp_path / 'minutes-1'},card=site"


def test_the_section_of_a_tracker_has_its_rows_and_the_share_of_the_gap_that_its_minutes_close(tmp_path: Path) -> None:
    names = [f"test-{10 + k}" for k in range(3)]
    skills = {"persistence": 0.3, "dogma-general": 0.5, "dogma-1-min": 0.7, "dogma-site": 0.9}
    scores = run_of(tmp_path, names, skills)
    tables = section_of(scores, scores, "dogma", (1,)).tables
    assert [row[0] for row in tables["F1"].rows] == list(skills)
    assert tables["gap"].columns == ("of the gap, %", "1 min")
    assert [row[0] for row in tables["gap"].rows] == ["0.5 s", "1 s"]
    assert all(0 < float(row[1]) < 100 for row in tables["gap"].rows)


def test_the_share_of_a_gap_is_given_where_there_is_a_gap() -> None:
    assert share_closed(0.5, 0.6, 0.7) == "50"
    assert share_closed(0.5, 0.75, 0.7) == "125"
    assert share_closed(0.7, 0.6, 0.7) == ""
    assert share_closed(0.5, None, 0.7) == ""


def test_a_comparison_of_the_reference_alone_is_drawn(tmp_path: Path) -> None:
    drawn = scale_charts(run_of(tmp_path, ["corridor", "aces"], {"persistence": 0.5}), "dynamic")
    assert drawn.count("<polyline") == 2
    assert "persistence</text>" in drawn
