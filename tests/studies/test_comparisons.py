"""Studies of many comparisons: pooled over unlike periods, paired by drive, complete, and compared with an aim."""

import importlib
import shlex
import zlib
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from gridtrack.common.geometry import SE2
from gridtrack.common.scan import Scan
from gridtrack.evaluation.runs.summarise import summarise
from gridtrack.evaluation.scores.contact_foresight import CONTACT_FORESIGHT
from gridtrack.recordings import open_recording

from docs.test_commands import problem_of
from scenes import drive, truth_scene
from scenes.synthetic_run import SCORES, description, write_trial
from studies import moving, real_results, variants
from studies.real_results import REAL
from studies.support.results_file import measured_table, read_sections
from studies.support.shipped import DEMO
from studies.support.unseen_places import STRATA, PlaceScores, general_rows, not_measured
from studies.worlds_results import (
    CONTENDERS,
    DRIVES,
    ODOMETRY,
    STANDS,
    aim_met,
    aim_table,
    laser_of,
    network_section,
    poses_section,
    sections_of,
)

ROOT = Path(__file__).parents[2]
PERIODS_S = (0.25, 0.26, 0.166667)
WITH_CONTACTS = (*SCORES, CONTACT_FORESIGHT)
SKILLS = {"oracle": 1.0, "persistence": 0.5, "kalman": 0.8, "dogma": 0.4995, "dilated-convgru": 0.7995}


def trials_of(folder, names, skills, *, periods_s=PERIODS_S, longest_s=1.0, **how):
    """The descriptions and trials of a comparison on recordings of these periods in turns, two forecasts on each.

    Counts are random; recordings of the same name have the same, except for the skill. `how` as of `write_trial`.
    """
    period_s = {name: periods_s[k % len(periods_s)] for k, name in enumerate(names)}
    steps = {name: round(longest_s / of_name) for name, of_name in period_s.items()}
    trials = [
        write_trial(
            folder,
            label,
            name,
            skill,
            seed=zlib.crc32(name.encode()),
            frames=2,
            strata=tuple(STRATA),
            steps=steps[name],
            tracker=label.partition(" ")[0],
            period_s=period_s[name],
            **how,
        )
        for name in names
        for label, skill in skills.items()
    ]
    described = {
        name: description(2, source_sha256=name.ljust(64, "0"), period_s=period_s[name], steps=steps[name])
        for name in names
    }
    return described, trials


def scores_of(folder, names, skills, **how):
    """The scores of a drawn comparison; `how` as of `trials_of`."""
    return PlaceScores(*trials_of(folder, names, skills, **how))


@pytest.fixture(scope="module")
def worlds(tmp_path_factory):
    """Twenty worlds."""
    names = [f"{part}-{k}" for k in range(10) for part in ("indoors", "outdoors")]
    return scores_of(tmp_path_factory.mktemp("worlds"), names, SKILLS)


@pytest.fixture(scope="module")
def sections(worlds):
    return sections_of(worlds)


def test_each_contender_is_paired_with_each_floor_whatever_the_order_of_the_rows(sections):
    pairs = sections["pairs"].tables["F1 and floors"].rows
    assert [row[0] for row in pairs] == [f"persistence less {name}" for name in SKILLS if name in CONTENDERS]


def test_the_aim_is_judged_if_it_was_measured_and_named_if_it_was_not(sections, tmp_path):
    aim = sections["differences"].tables["aim"]
    assert {row[0]: row[-1] for row in aim.rows} == {
        f"{name} less persistence, {ahead} s": "met" for name in ("dilated-convgru", "kalman") for ahead in ("0.5", "1")
    }
    missing = sections["scores"].values["not measured"]
    assert "`static-map`" in missing
    assert "`kalman`" not in missing
    floor = scores_of(tmp_path, ["indoors-1", "indoors-2"], {"persistence": 0.5})
    assert {row[-1] for row in aim_table(floor).rows} == {"not measured"}


@pytest.mark.parametrize(
    ("difference", "low", "verdict"),
    [(0.1, 0.01, "met"), (0.099, 0.05, "not met"), (0.2, -0.01, "not met"), (0.2, None, "no interval")],
)
def test_the_aim_asks_for_the_difference_and_for_a_significant_one(difference, low, verdict):
    assert aim_met(difference, low) == verdict


def test_each_pair_of_contenders_has_its_difference_and_is_marked_if_it_may_be_chance(worlds):
    f1 = {row[0]: row[1] for row in worlds.pair_table("F1", "f1", CONTENDERS).rows}
    assert {pair: (text[0], "°" in text) for pair, text in f1.items()} == {
        "kalman less dogma": ("+", False),
        "kalman less dilated-convgru": ("+", True),
        "dogma less dilated-convgru": ("-", False),
    }


def test_worlds_with_refined_poses_replace_worlds_with_poses_of_the_wheels(tmp_path):
    lasers = {f"world-{10 + k}": (STANDS, DRIVES, ODOMETRY)[k // 2] for k in range(6)}
    drivers = [name for name, laser in lasers.items() if laser == ODOMETRY]
    recorded = scores_of(tmp_path / "recorded", list(lasers), {"persistence": 0.5, "kalman": 0.55})
    refined = scores_of(tmp_path / "refined", drivers, {"persistence": 0.5, "kalman": 0.95})
    tables = poses_section(recorded, refined, lasers).tables
    assert tables["contacts by laser"].columns[1::2] == tuple(
        f"{kind}, 0.5 s" for kind in ("stands (2)", "drives (2)", "drives, odometry (2)", "drives, refined")
    )
    before, after = (float(table.rows[-1][1]) for table in (aim_table(recorded), tables["aim"]))
    assert 0.0 < before < 0.1 < after


def test_networks_of_an_equal_budget_replace_the_shipped_ones(worlds, tmp_path):
    names = list(worlds.described)
    equal = scores_of(tmp_path, names, {"dilated-convgru": 0.5, "deep-tracking-rnn": 0.5})
    rows = ("persistence", "dilated-convgru", "deep-tracking-rnn", "conv-lstm")
    together = worlds.replaced_by(equal).of(labels=rows)
    assert together.labels == ["persistence", "dilated-convgru", "deep-tracking-rnn"]
    shipped, budget = (float(scores.text("dilated-convgru", "dynamic", "f1", 1.0)[:5]) for scores in (worlds, together))
    assert shipped > budget + 0.05
    assert [row[0] for row in network_section(together).tables["scores"].rows] == together.labels


def test_the_laser_of_a_world_stands_or_drives_with_exact_poses_or_wheel_odometry(tmp_path):
    recordings = {
        STANDS: truth_scene.write_recording(tmp_path / "standing.mcap", 2),
        DRIVES: drive.write_recording(tmp_path / "driving.mcap", 2, with_truth=False),
        ODOMETRY: drive.write_recording(tmp_path / "wheels.mcap", 2),
    }
    assert {kind: laser_of(path) for kind, path in recordings.items()} == {kind: kind for kind in recordings}


def test_recordings_of_one_period_have_the_steps_nearest_to_the_horizons(tmp_path):
    scores = scores_of(tmp_path, ["walker-1", "walker-3"], {"persistence": 0.5}, periods_s=(0.133333,))
    assert scores.horizons == {0.5: 4, 1.0: 8}
    assert scores.table("F1", [("1 s", "dynamic", "f1", 1.0)]).rows[0][0] == "persistence"
    assert set(scores.occupied("dynamic", 1.0)) == {"walker-1", "walker-3"}


def test_a_comparison_that_ended_early_is_refused(tmp_path):
    described, trials = trials_of(tmp_path, ["indoors-1", "indoors-2"], {"persistence": 0.5}, scored=1)
    summarise(described, trials, [], interrupted=False).write(tmp_path)
    with pytest.raises(SystemExit, match="not complete"):
        PlaceScores.read(tmp_path)


def test_rows_have_no_weights_or_general_ones(tmp_path):
    for card in ("weights/kalman/general.toml", "weights/dogma/hall.toml"):
        (tmp_path / card).parent.mkdir(parents=True)
        (tmp_path / card).touch()
    rows = general_rows(tmp_path / "weights")
    assert list(rows) == ["persistence", "blank", "advection", "kalman"]
    assert rows["kalman"] == f"kalman=kalman:weights={tmp_path / 'weights'},card=general"
    assert "`dogma`" in not_measured(rows)


def drives(folder, kind, skill, floor=0.3, *, cars, start_s=10):
    """A comparison of kalman with persistence and the oracle on drives, with one kind of poses."""
    names = [f"car-{200 + k}-{kind}" for k in range(cars)]
    skills = {"kalman": skill, "persistence": floor, "oracle": 1.0}
    how = {"periods_s": (0.125,), "delivered": kind, "start_s": start_s, "scores": WITH_CONTACTS}
    return moving.Comparison(kind, scores_of(folder / f"{kind}-{skill}", names, skills, **how))


@pytest.fixture(scope="module")
def perfect(tmp_path_factory):
    """Twenty drives with perfect poses."""
    return drives(tmp_path_factory.mktemp("drives"), "perfect", 0.6, cars=20)


def ends_of(text):
    """`+0.100 [+.050, +.150]` as value, low and high."""
    return [float(one.strip("[],")) for one in text.split()]


@pytest.mark.parametrize("score", moving.SCORES)
def test_the_loss_without_ego_motion_is_paired_over_twenty_drives(score, perfect, tmp_path):
    table = moving.difference_table([perfect, drives(tmp_path, "ignored", 0.3, cars=20)], score)
    assert [row[0] for row in table.rows] == ["persistence", "kalman"]
    value, low, high = ends_of(table.rows[1][1])
    assert 0.1 < low < value < high < 0.4


def test_a_loss_that_persistence_has_too_is_one_of_the_view(perfect, tmp_path):
    text = {}
    for kind, floor in (("both-lose", 0.5), ("kalman-loses", 0.3)):
        ((label, _, text[kind]),) = moving.view_table([perfect, drives(tmp_path, kind, 0.8, floor, cars=20)]).rows
        assert label == "kalman"
    value, low, high = ends_of(text["kalman-loses"])
    assert -0.4 < low < value < high < -0.05
    value, low, high = ends_of(text["both-lose"])
    assert low < 0 < high
    assert abs(value) < 0.1


def test_drives_that_were_scored_at_other_times_are_not_paired(tmp_path):
    first, later = (drives(tmp_path, f"from-{start_s}", 0.8, cars=2, start_s=start_s) for start_s in (10, 11))
    with pytest.raises(SystemExit, match="scored at different times"):
        first.less(later, "kalman", "f1")


def test_poses_are_measured_by_the_true_ones_over_two_and_a_half_seconds_and_at_the_end(tmp_path):
    for noise, least in ((0.0, 0.0), (0.2, 0.05)):
        apart, end_m = moving.errors_of(drive.write_recording(tmp_path / "d.mcap", 4, pose_noise=(noise, 0.0)))
        assert apart.shape == (40 - moving.APART, 2)
        assert np.median(apart[:, 0]) >= least
        assert end_m == pytest.approx(0.0, abs=1e-6) if not noise else end_m > 0.0


def test_a_sensor_with_ignored_motion_stands_at_its_first_pose_and_is_scored_by_the_true_poses():
    true = [SE2(1.0, 2.0, 0.5), SE2(2.0, 2.0, 0.6), SE2(3.0, 2.5, 0.7)]
    beams = (np.ones(4, np.float32), 0.0, 1.0, 0.1, 10.0)
    scans = list(moving.standing(Scan(k, *beams, world_T_sensor=pose) for k, pose in enumerate(true)))
    assert [scan.world_T_sensor for scan in scans] == [true[0]] * 3
    assert [scan.reference_T_sensor for scan in scans] == true


def test_the_window_of_a_real_recording_is_the_shipped_one_or_about_the_laser_that_moves():
    windows = {one.name: one.grid for one in REAL}
    middles = {one.name: f"100x{one.cell_m:g}@-{50 * one.cell_m:g},-{50 * one.cell_m:g}" for one in REAL if one.moves}
    assert windows.items() >= middles.items()
    assert windows["corridor"] == open_recording(DEMO).info.grid


RUNS = {
    "worlds_results": "--world indoors-hall-1010 --world outdoors-plaza-1004 --tracker persistence --tracker kalman"
    " --out TMP/run --results TMP/worlds.json",
    "real_results": "DATA --recording corridor --recording aces --tracker persistence --tracker kalman --out TMP/run"
    " --results TMP/real.json",
    "moving": "--drive car-202 --drive car-204 --drive robot-201 --drive robot-203 --tracker persistence"
    " --tracker kalman --out TMP/run --results TMP/drives.json",
}
"""Arguments of the studies that compare trackers. TMP is a folder of the test."""


def check_words(*words):
    """In place of the command line: checks the words."""
    assert problem_of(shlex.join(["gridtrack", *map(str, words)])) == ""


def gridtrack(*words):
    """In place of the command line: checks the words, and draws the results of the first four recordings."""
    check_words(*words)
    rest = list(map(str, words[1:]))
    out = Path(rest[rest.index("--out") + 1])
    recordings = rest[: next(k for k, word in enumerate(rest) if word.startswith("--"))]
    names = [Path(recording).name.partition(".")[0] for recording in recordings[:4]]
    chosen = [after for word, after in pairwise(rest) if word == "--tracker"]
    labels = [text.partition("=")[0] if "=" in text.partition(":")[0] else text.partition(":")[0] for text in chosen]
    skills = {label: 0.5 + 0.05 * k for k, label in enumerate(labels)} | {"oracle": 1.0}
    described, trials = trials_of(out, names, skills, periods_s=(0.5,), longest_s=2.5, scores=WITH_CONTACTS)
    summarise(described, trials, [], interrupted=False).write(out)


@pytest.mark.parametrize("name", RUNS)
def test_a_study_compares_with_valid_commands_and_writes_its_results(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr("studies.support.comparison.gridtrack", gridtrack)
    monkeypatch.setattr("studies.worlds_results.laser_of", lambda _: STANDS)
    monkeypatch.setattr(real_results, "imported", lambda chosen, *_: [Path(f"{one.name}.mcap") for one in chosen])
    monkeypatch.setattr(moving, "recording_of", lambda kind, drive, *_: Path(f"{drive}.mcap"))
    monkeypatch.setattr(moving, "errors_of", lambda _: (np.ones((2, 2)), 1.0))
    monkeypatch.setattr(moving, "KINDS", ("perfect", "ignored", "beside"))
    words = [word.replace("TMP", str(tmp_path)) for word in RUNS[name].split()]
    importlib.import_module(f"studies.{name}").main(words)
    sections = read_sections(Path(words[-1]))
    assert any(table.rows for section in sections.values() for table in section.tables.values())
    assert capsys.readouterr().out


def every_number(_):
    """In place of the scores of a run: they have each number."""
    return SimpleNamespace(
        table=lambda corner, rows, columns, _: measured_table((corner, *columns), [[row, *columns] for row in rows]),
    )


@pytest.mark.parametrize(
    ("which", "result", "row"),
    [("ablations", "ABLATIONS", "no-gates less whole"), ("returns", "RETURNS", "cold less kalman")],
)
def test_variants_are_compared_with_the_whole_at_the_junction(which, result, row, tmp_path, monkeypatch):
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr("studies.support.comparison.gridtrack", check_words)
    card = ROOT / "data" / "weights" / "dilated-convgru" / "junction.toml"
    monkeypatch.setattr(variants, "trained", lambda: {"whole": card, "no-gates": card})
    monkeypatch.setattr(variants, "RunScores", every_number)
    for name in ("ABLATIONS", "RETURNS", "OF_ABLATIONS", "OF_RETURNS"):
        monkeypatch.setattr(variants, name, tmp_path / name)
    variants.main([which])
    (section,) = read_sections(tmp_path / result).values()
    assert [one[0] for one in section.tables["differences"].rows] == [row]
