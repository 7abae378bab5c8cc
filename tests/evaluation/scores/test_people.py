"""Annotated people as targets: hand-drawn 5x5 windows, a window that moves, and a trial from a recording."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridSpec
from gridtrack.common.scan import Scan
from gridtrack.common.scene import Person
from gridtrack.evaluation.referee.kinds import KindsOfWindow, Regions
from gridtrack.evaluation.referee.motion import OnceFree
from gridtrack.evaluation.referee.people import PeopleInWindow, people_in
from gridtrack.evaluation.referee.referee import Moment
from gridtrack.evaluation.referee.strata import PARTS
from gridtrack.evaluation.referee.targets import Target
from gridtrack.evaluation.scores.contact_foresight import CONTACT_FORESIGHT
from gridtrack.evaluation.scores.people import PEOPLE_SCORE
from gridtrack.recordings import RecordingInfo, write_native
from gridtrack.recordings.observation import Observation

from scenes import drive
from scenes.room import curve, trial_of
from scenes.scored_cells import DYNAMIC_CELL, STATIC_CELL, counted, facts_of, frame, region_maps, scored, values

GRID = GridSpec(5, 0.4, (0.0, 0.0))
OPEN, STANDING, IN_MOTION = range(len(PARTS))


def cells(rows, mark):
    """The cells (5, 5) with this mark in text, the upper row first."""
    return np.array([[one == mark for one in row] for row in reversed(rows)])


def observation(rows, people, window=None):
    """A frame as text: # occupied, . free, blank unseen; with people as (track, x, y, speed)."""
    seen = frame(~cells(rows, " "), cells(rows, "#"), window=window or SE2())
    scan = Scan(0, np.zeros(1, np.float32), 0.0, 0.0, 0.1, 5.0, people=people and tuple(Person(*one) for one in people))
    return Observation(seen, (scan,), (SE2(),))


def near(rows, people, window=None):
    return drawn(people_in(observation(rows, people, window), GRID, np.ones((5, 5), bool)).near)


def drawn(mask):
    """The cells as text, the upper row first: P near a person."""
    return ["".join(".P"[int(one)] for one in row) for row in mask[::-1]]


EMPTY = ["....."] * 5


def test_the_cells_of_a_person_have_their_centres_within_0_4_m():
    assert near(EMPTY, [(1, 1.0, 1.0, 0.0)]) == [".....", "..P..", ".PPP.", "..P..", "....."]
    assert near(EMPTY, [(1, 1.2, 1.0, 0.0)]) == [".....", ".....", "..PP.", ".....", "....."]
    assert near(EMPTY, [(1, 0.1, 0.1, 0.0), (2, 50.0, 0.0, 0.0)]) == [*EMPTY[:4], "P...."]
    assert near(EMPTY, []) == EMPTY


def test_people_are_in_the_world_whatever_the_window():
    assert near(EMPTY, [(1, 1.0, 1.0, 0.0)], SE2(0.4, 0.8)) == [".....", ".....", ".....", ".P...", "PPP.."]
    turned = near(EMPTY, [(1, -1.0, 1.4, 0.0)], SE2(0.0, 0.0, np.pi / 2))
    assert turned == [".....", "...P.", "..PPP", "...P.", "....."]


def test_returns_on_a_person_who_walks_are_in_motion_and_others_stand():
    rows = ["#....", ".....", "..#..", ".....", "....."]
    walking = people_in(observation(rows, [(1, 1.0, 1.0, 0.5)]), GRID, np.ones((5, 5), bool)).motion
    assert walking[2, 2] == walking[2, 1] == IN_MOTION, "with the free cells beside it"
    assert walking[4, 0] == STANDING
    assert walking[0, 0] == OPEN
    standing = people_in(observation(rows, [(1, 1.0, 1.0, 0.2)]), GRID, np.ones((5, 5), bool)).motion
    assert standing[2, 2] == STANDING


def test_without_annotation_there_is_no_target_of_people():
    assert people_in(observation(EMPTY, None), GRID, np.ones((5, 5), bool)) is None


class Source:
    """A FrameSource of hand-drawn frames."""

    name, sha256, site, classes, grid, period_s = "drawn", "", "here", (), GRID, 1.0


def test_a_moment_gives_the_people_of_a_later_frame_in_the_window_of_the_forecast():
    regions = Regions(GRID, KindsOfWindow(np.full((5, 5), DYNAMIC_CELL, np.uint8)))
    moments = [
        Moment(observation(EMPTY, people, SE2(x)), OnceFree(None), Source(), regions)
        for x, people in ((0.0, None), (0.8, [(1, 1.0, 1.0, 1.0)]))
    ]
    now, later = moments
    assert now.target.people is None
    in_window_of_now = later.target_in(now.window, now.region_maps).people.near
    assert drawn(in_window_of_now) == [".....", "..P..", ".PPP.", "..P..", "....."]
    assert drawn(later.target.people.near) == [".....", "P....", "PP...", "P....", "....."]


# a person who walks and is seen (left), and one who stands behind a wall (right); # a wall, W its column
SEEN = ["....#", ".....", ".#...", "...  ", "...  "]
PEOPLE = [(1, 0.6, 1.0, 1.0), (2, 1.8, 0.2, 0.0)]


def forecast_of(called, kinds=None, people=PEOPLE):
    """A forecast of step 0 and 1 that calls these cells, as text; only step 1 is annotated."""
    seen = observation(SEEN, people)
    kinds = np.full((5, 5), DYNAMIC_CELL, np.uint8) if kinds is None else kinds
    maps = region_maps(kinds)
    target = Target.of_frame(seen.frame)
    annotated = replace(target, people=people_in(seen, GRID, maps.dynamic))
    occupancy = np.where(cells(called, "o"), np.float32(0.9), np.float32(0.1))
    return scored(np.stack([occupancy, occupancy]), [target, annotated], maps)


def people_counts(forecast):
    """The values of the score, by stratum at step 1."""
    strata, sums = counted(PEOPLE_SCORE, forecast, has_people=True)
    found = values(PEOPLE_SCORE, sums)
    assert not sums["persons"][0].any(), "nobody is annotated at step 0"
    return {name: {key: float(own[1, k]) for key, own in found.items()} for k, name in enumerate(strata)}


def test_a_person_is_found_by_one_cell_hidden_or_seen():
    of = people_counts(forecast_of([".....", ".....", "..o..", ".....", "....."]))
    found = {name: (own["persons"], own["found"]) for name, own in of.items()}
    assert found == {
        "people": (2, 0.5),
        "people in motion": (1, 1.0),
        "people seen": (1, 1.0),
        "people hidden": (1, 0.0),
    }
    assert people_counts(forecast_of([*EMPTY[:4], "....o"]))["people hidden"]["found"] == 1.0


def test_the_price_is_the_share_of_free_and_of_unseen_cells_away_from_people_that_are_called():
    called = ["..o..", ".....", ".....", "...o.", "....."]
    of = people_counts(forecast_of(called))
    away_seen = 25 - 4 - 1 - 5  # not: unseen ones, the wall, and the walker's cells
    assert of["people seen"]["called_away"] == pytest.approx(1 / away_seen)
    assert of["people hidden"]["called_away"] == pytest.approx(1 / 1), "the others are of the hidden person"
    assert of["people"]["called_away"] == pytest.approx(2 / (away_seen + 1))
    assert people_counts(forecast_of(["ooooo"] * 5))["people"] | {"persons": 2.0} == pytest.approx(
        {"found": 1.0, "at_half": 1.0, "called_away": 1.0, "f1": np.nan, "area": np.nan, "persons": 2.0}, nan_ok=True
    )


def test_a_wall_beside_a_person_finds_nobody():
    kinds = np.where(cells([*EMPTY[:3], "...WW", "...WW"], "W"), STATIC_CELL, DYNAMIC_CELL)
    of = people_counts(forecast_of([*EMPTY[:3], "...oo", "...oo"], kinds))
    assert of["people"]["persons"] == 1, "all cells of the other are static"


def test_f1_and_pr_auc_are_those_of_the_cells_in_motion_by_the_annotation():
    rng = np.random.default_rng(3)
    forecast = forecast_of(EMPTY)
    occupancy = rng.random((2, 5, 5)).astype(np.float32)
    forecast = replace(forecast, forecast=replace(forecast.forecast, occupancy=occupancy))
    of = people_counts(forecast)["people in motion"]
    target = forecast.targets[1]
    part = target.frame.visible & (target.people.motion != STANDING)
    occupied, called = target.frame.occupied[part], occupancy[1][part] >= 0.5
    tp, fp, fn = (occupied & called).sum(), (~occupied & called).sum(), (occupied & ~called).sum()
    assert of["f1"] == pytest.approx(2 * tp / (2 * tp + fp + fn))
    assert occupied.sum() == 1
    rank = (occupancy[1][part] >= occupancy[1][2, 1]).sum()
    assert of["area"] == pytest.approx(1 / rank, rel=0.2), "one positive: the precision at its rank, by bins"


def test_a_recording_without_annotations_has_no_strata_of_people():
    forecast = forecast_of(EMPTY)
    assert PEOPLE_SCORE.strata(facts_of(forecast)) == ()
    assert "contacts with people" not in CONTACT_FORESIGHT.strata(facts_of(forecast))
    nobody = replace(forecast, targets=(forecast.targets[0],) * 2)
    assert PEOPLE_SCORE.count(nobody, facts_of(nobody, has_people=True), None) is None


@pytest.mark.parametrize("of_people", [True, False])
def test_contacts_with_people_are_those_whose_first_cell_is_a_persons_in_annotated_frames(of_people):
    size, steps = 40, 8
    occupied = np.zeros((size, size), bool)
    occupied[20, 20] = occupied[20, 5] = True
    free = Target.of_frame(frame(np.ones((size, size), bool), np.zeros((size, size), bool)))
    met = Target.of_frame(frame(np.ones((size, size), bool), occupied))
    nobody, somebody = (
        PeopleInWindow(own, np.ones(len(own), bool), met.motion) for own in ((), (np.array([20 * size + 20]),))
    )
    first = replace(free, people=nobody if of_people else None)
    targets = [first, *[replace(met, people=somebody)] * steps]
    occupancy = np.full((steps + 1, size, size), 0.5, np.float32)
    forecast = scored(occupancy, targets, region_maps(np.full((size, size), DYNAMIC_CELL)))
    strata, sums = counted(CONTACT_FORESIGHT, forecast, has_people=True, cell_m=0.2, period_s=0.25)
    contacts = dict(zip(strata, sums.block("contacts").sum(axis=-1)[-1], strict=True))
    clears = dict(zip(strata, sums.block("clears").sum(axis=-1)[-1], strict=True))
    assert bool(0 < contacts["contacts with people"] < contacts["dynamic"]) is of_people
    assert clears["contacts with people"] == (clears["dynamic"] if of_people else 0)


@pytest.mark.usefixtures("trackers_here")
def test_a_run_on_a_drive_past_people_is_scored_with_the_people_where_they_truly_are(compare, tmp_path):
    def annotated(index):
        made = drive.scan(index, with_truth=False)
        bodies = drive.scene(index).objects
        people = [
            Person(one.track, one.world_T_object.x, one.world_T_object.y, 1.2 if one.track < 2 else 0.0)
            for one in bodies
        ]
        return replace(made, people=tuple(people) if 30 <= index < 50 else None)

    with (tmp_path / "d.mcap").open("wb") as file:
        write_native(file, RecordingInfo(site="rooms", grid=drive.GRID), (annotated(index) for index in range(70)))
    summary = compare("persistence", recordings=(str(tmp_path / "d.mcap"),), horizon_s=0.5)
    trial = trial_of(summary, "persistence", "d")
    assert curve(trial, "people seen", "people.found")[0] == 1.0, "copying the frame finds all who are seen"
    f1 = curve(trial, "people in motion", "people.f1")
    assert f1[0] == 1.0
    assert f1[5] < 0.3, "half a second later they are elsewhere"
    assert max(curve(trial, "people", "people.called_away")) < 0.02
