"""Contact foresight, against a second implementation of the definition and on small hand-made cases."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gridtrack.common.errors import ConfigurationError
from gridtrack.common.geometry import SE2
from gridtrack.evaluation.referee.strata import PARTS, RANGE_NAMES, RANGES_M
from gridtrack.evaluation.referee.targets import HIDDEN_FREE, HIDDEN_OCCUPIED, NOT_SCORED, Target
from gridtrack.evaluation.scores.cells import (
    CALIBRATION_BINS,
    CALIBRATION_EDGES,
    CLIP,
    PROBABILITY_BINS,
    PROBABILITY_EDGES,
)
from gridtrack.evaluation.scores.contact_foresight import (
    CONTACT_FORESIGHT,
    ROBOTS_AHEAD_S,
    _first_at,
    _last_at,
    alarm_risk,
    paths_of,
    robots_of,
)
from gridtrack.evaluation.scores.contact_paths import MOST_PATHS, NEVER, draw_paths, events_of, paths_along, risks_of
from gridtrack.evaluation.scores.definition import Sums
from gridtrack.evaluation.scores.robot import CAR, SMALL_ROBOT, Robot, parse_robot

from scenes.scored_cells import DYNAMIC_CELL, STATIC_CELL, counted, facts_of, frame, region_maps, scored, values

STEPS, SIZE, PERIOD_S = 8, 40, 0.25
ROBOT = Robot(radius=1.5, speed=4.8)


def cells_of_step(start, stride, radius, n):
    """Cells (M, M) with a centre in the disc at step n, or between its positions at n-1 and n."""
    rows, columns = np.indices((SIZE, SIZE)) + 0.5
    east, north = columns - start[0] - (n - 1) * stride[0], rows - start[1] - (n - 1) * stride[1]
    share = np.clip((east * stride[0] + north * stride[1]) / max(stride @ stride, 1e-300), 0.0, 1.0)
    return np.hypot(east - share * stride[0], north - share * stride[1]) <= radius


def random_scene(seed, hidden=True):
    """A forecast of random cells, of frames with a few occupied cells and, if `hidden`, a hidden band."""
    rng = np.random.default_rng(seed)
    visible = np.ones((STEPS + 1, SIZE, SIZE), bool)
    if hidden:
        visible[1:, :, 25:28] = rng.random((STEPS, SIZE, 3)) < 0.5
    occupied = rng.random((STEPS + 1, SIZE, SIZE)) < 0.004
    kinds = np.full((SIZE, SIZE), DYNAMIC_CELL)
    kinds[:, 0] = STATIC_CELL
    targets = [Target.of_frame(frame(v, o, 10**8 * n)) for n, (v, o) in enumerate(zip(visible, occupied, strict=True))]
    for target in targets:
        target.motion[:] = rng.integers(0, len(PARTS), target.motion.shape)
    return scored(rng.random((STEPS + 1, SIZE, SIZE)).astype(np.float32) ** 8, targets, region_maps(kinds))


def states_of(targets):
    return np.stack([target.state for target in targets])


def moving_scenes():
    """Forecasts a second apart, of windows that move by a cell to the right and two up."""
    scenes = [random_scene(n) for n in range(3)]
    for number, scene in enumerate(scenes):
        moved = [
            replace(t, frame=replace(t.frame, stamp_ns=10**9 * number, world_T_grid=SE2(1.0 * number, 2.0 * number)))
            for t in scene.targets
        ]
        scenes[number] = replace(scene, targets=tuple(moved))
    return scenes


def risks_by_definition(cells, occupancy):
    """Within 1..L steps: the largest probability on the `cells` (L, M, M), and that of independent cells."""
    p = np.maximum.accumulate(np.where(cells, occupancy, 0.0))
    return p.max(axis=(1, 2)), 1.0 - np.prod(1.0 - p.astype(np.float64), axis=(1, 2))


def leads_by_definition(scenes, first, cells, contact):
    """Seconds (L+1, C) from the alarm that stays on until the contact, by each edge of the bins as its threshold."""
    lead_s = np.zeros((len(cells) + 1, CALIBRATION_BINS))
    for n in range(contact, len(cells) + 1):
        risks = []
        for moved, scene in enumerate(scenes[first : first + -(-contact // 4)]):  # until before the contact
            seen = np.roll(cells[4 * moved : n], (-2 * moved, -moved), axis=(1, 2))
            seen[:, SIZE - 2 * moved :] = seen[:, :, SIZE - moved :] = False
            risks.append(np.where(seen, scene.forecast.occupancy[1 : n - 4 * moved + 1], 0.0).max())
        stays_on = np.array([min(risks[number:]) >= CALIBRATION_EDGES[:-1] for number in range(len(risks))])
        lead_s[n] = np.where(stays_on.any(axis=0), contact * PERIOD_S - stays_on.argmax(axis=0), 0.0)
    return lead_s


def sums_by_definition(scenes, facts):
    """The sums of all scenes, path by path, without the kernels of the score.

    At every step, in the strata of all contacts, of those in motion and standing, and of each distance.
    """
    last = len(scenes[0].targets) - 1
    sums = Sums(np.zeros((last + 1, 6, len(CONTACT_FORESIGHT.parts(facts)))), CONTACT_FORESIGHT.parts(facts))
    lead_s = np.zeros((last + 1, 6, CALIBRATION_BINS))  # of alarms by each edge as threshold
    for first, scene in enumerate(scenes):
        paths = paths_of(scene, facts)
        sums["forecasts"][1:] += 1
        for start, stride in zip(paths.starts, paths.strides, strict=True):
            cells = np.stack([cells_of_step(start, stride, 1.5, n) for n in range(1, last + 1)])
            states = np.where(cells, states_of(scene.targets[1:]), 0)
            met, unseen = (states == 1).any(axis=(1, 2)), (states == NOT_SCORED).any(axis=(1, 2))
            largest, independent = risks_by_definition(cells, scene.forecast.occupancy[1:])
            slices = [True] + [False] * 5
            if met.any():
                contact = int(met.argmax()) + 1
                rows, columns = np.nonzero(states[contact - 1] == 1)
                nearest = np.argmin((columns + 0.5 - start[0]) * stride[0] + (rows + 0.5 - start[1]) * stride[1])
                part = PARTS[scene.targets[contact].motion[rows[nearest], columns[nearest]]]
                far = np.searchsorted(RANGES_M, np.hypot(columns[nearest] + 0.5, rows[nearest] + 0.5) * facts.cell_m)
                slices = [True, part == "in-motion", part == "standing", *(far == band for band in range(3))]
                if first == 0:  # others have their contacts after the last forecast
                    lead_s[:, slices] += leads_by_definition(scenes, first, cells, contact)[:, None]
                    sums["followed"][contact:] += slices
            for n in range(1, last + 1):
                bins = (
                    np.searchsorted(PROBABILITY_EDGES[1:-1], largest[n - 1], side="right"),
                    np.searchsorted(CALIBRATION_EDGES[1:-1], independent[n - 1], side="right"),
                )
                if met[:n].any():
                    sums["seconds"][n] += PERIOD_S * contact
                    for name, bin_ in zip(("contacts", "independent contacts"), bins, strict=True):
                        sums.block(name)[n, slices, bin_] += 1
                elif unseen[:n].any():
                    sums["unknown"][n] += 1
                else:
                    sums["seconds"][n] += PERIOD_S * n
                    for name, bin_ in zip(("clears", "independent clears"), bins, strict=True):
                        sums.block(name)[n, :, bin_] += 1
    return sums, lead_s


def test_sums_are_those_of_the_definition():
    scenes = moving_scenes()
    facts = facts_of(scenes[0], robot=ROBOT, period_s=PERIOD_S)
    memory = CONTACT_FORESIGHT.new_memory(facts)
    counted = sum(CONTACT_FORESIGHT.count(one, facts, memory) for one in scenes)
    steps, strata = list(CONTACT_FORESIGHT.steps(facts)), CONTACT_FORESIGHT.strata(facts)
    assert steps == [2, 4, 8]
    found = Sums(counted[:, :6], CONTACT_FORESIGHT.parts(facts))
    assert strata[:6] == ("dynamic", "in-motion", "standing", *(f"contacts {name}" for name in RANGE_NAMES))
    expected, lead_s = sums_by_definition(scenes, facts)
    assert found["followed"].max() > 50
    for name in ("contacts", "clears", "independent contacts", "independent clears"):
        assert np.array_equal(found.block(name), expected.block(name)[steps]), name
    for name in ("followed", "unknown", "seconds", "forecasts", "skipped"):
        assert np.allclose(found[name], expected[name][steps], rtol=1e-12), name
    assert np.allclose(np.cumsum(found.block("lead")[..., ::-1], axis=-1)[..., ::-1], lead_s[steps], atol=1e-9)


def test_paths_start_safe_and_stay_in_the_window_and_off_static_cells_and_ring():
    kinds = np.full((SIZE, SIZE), DYNAMIC_CELL)
    kinds[20:24, 20:24] = STATIC_CELL
    free, passable = np.ones((SIZE, SIZE), bool), kinds == DYNAMIC_CELL
    free[:, :10] = False
    paths = draw_paths(7, free & passable, passable, 1.5, 1.2, STEPS)
    assert len(paths) == MOST_PATHS
    assert np.hypot(*paths.strides.T).max() <= 1.2
    for start, stride in zip(paths.starts[:40], paths.strides[:40], strict=True):
        ends = np.stack([start, start + STEPS * stride])
        assert ends.min() >= 1.5 - 0.5
        assert ends.max() <= SIZE - 1.5 + 0.5
        for share in np.linspace(0, STEPS, 200):
            x, y = start + share * stride
            rows, columns = np.indices((SIZE, SIZE)) + 0.5
            disc = np.hypot(columns - x, rows - y) <= 1.5
            assert passable[disc].all()
            assert share > 0 or free[disc].all()


def test_paths_are_the_same_for_every_forecast_of_a_frame_and_change_with_the_frame():
    one, same, other = random_scene(1), random_scene(1), random_scene(2)
    same.forecast.occupancy[:] = 0.5
    facts = facts_of(one, robot=ROBOT, period_s=PERIOD_S)
    assert np.array_equal(paths_of(one, facts).starts, paths_of(same, facts).starts)
    assert not np.array_equal(paths_of(one, facts).starts, paths_of(other, facts).starts)


def test_the_numbers_are_those_of_splitmix64():
    """Its first number for the seed 1: scores of earlier runs are of these paths."""
    everywhere = np.ones((SIZE, SIZE), bool)
    first = (0x910A2DEC89025CC1 >> 11) / 2**53
    assert draw_paths(1, everywhere, everywhere, 1.5, 1.2, STEPS).starts[0, 0] == SIZE * first


def hand_drawn(occupied_at, p_at, size=9, steps=3, hidden=()):
    """A robot of one cell that drives right by a cell a step from the centre of cell (4, 1); `occupied_at` and `p_at`
    are (step, row, column)."""
    visible = np.ones((steps + 1, size, size), bool)
    occupied, p = np.zeros((steps + 1, size, size), bool), np.zeros((steps + 1, size, size), np.float32)
    for n, row, column in hidden:
        visible[n, row, column] = False
    for n, row, column in occupied_at:
        occupied[n, row, column] = True
    for n, row, column, value in p_at:
        p[n, row, column] = value
    targets = [Target.of_frame(frame(v, o, 10**8 * n)) for n, (v, o) in enumerate(zip(visible, occupied, strict=True))]
    return paths_along(np.array([[1.5, 4.5]]), np.array([[1.0, 0.0]]), 0.6, steps, size), targets, p


@pytest.mark.parametrize(
    ("occupied", "hidden", "contact", "unseen"),
    [
        pytest.param([(1, 4, 4), (2, 4, 4)], [], NEVER, NEVER, id="somebody crosses before the robot"),
        pytest.param([(3, 4, 4)], [], 3, NEVER, id="somebody is there in time"),
        pytest.param([(3, 4, 4)], [(2, 4, 3)], 3, 2, id="a contact after an unseen cell"),
        pytest.param([], [(2, 4, 3)], NEVER, 2, id="an unseen cell"),
    ],
)
def test_contacts_and_unseen_cells_of_a_path_by_hand(occupied, hidden, contact, unseen):
    paths, targets, _ = hand_drawn(occupied, [], hidden=hidden)
    events = events_of(paths, states_of(targets[1:]), has_truth=False)
    assert (events.contact, events.unseen) == ([contact], [unseen])
    assert contact == NEVER or events.hit == [4 * 9 + 4]


def test_a_cell_without_a_number_gives_a_path_without_a_risk_from_then_on():
    paths, _, p = hand_drawn([], [(2, 4, 3, np.nan), (2, 4, 2, 0.5), (3, 4, 4, 0.2)])
    for risks in risks_of(paths, np.array([0]), p[1:]):
        assert np.isnan(risks[0]).tolist() == [False, True, True]


def test_with_truth_hidden_outlines_and_interiors_are_contacts_and_nothing_is_unknown():
    for state in (HIDDEN_OCCUPIED, NOT_SCORED, HIDDEN_FREE):
        paths, targets, _ = hand_drawn([], [], hidden=[(2, 4, 3)])
        targets[2].state[4, 3] = state
        events = events_of(paths, states_of(targets[1:]), has_truth=True)
        assert events.contact == [NEVER if state == HIDDEN_FREE else 2]
        assert events.unseen == [NEVER]


def walker_scene(forecast_of, frames=3):
    """Scored forecasts of a person who walks up through a hall, one cell per step; `forecast_of(t)` gives each."""
    size, made = 40, []
    kinds = region_maps(np.full((size, size), DYNAMIC_CELL))
    for t in range(0, 5 * frames, 5):
        targets = []
        for n in range(STEPS + 1):
            occupied = np.zeros((size, size), bool)
            occupied[5 + t + n : 8 + t + n, 18:21] = True
            targets.append(Target.of_frame(frame(np.ones_like(occupied), occupied, 25 * 10**7 * (t + n))))
        made.append(scored(forecast_of(targets), targets, kinds))
    return made


def foresight(forecasts):
    facts = facts_of(forecasts[0], robot=ROBOT, period_s=PERIOD_S)
    memory = CONTACT_FORESIGHT.new_memory(facts)
    sums = sum(CONTACT_FORESIGHT.count(one, facts, memory) for one in forecasts)
    strata = CONTACT_FORESIGHT.strata(facts)
    found = values(CONTACT_FORESIGHT, Sums(sums, CONTACT_FORESIGHT.parts(facts)))
    return {name: value[-1, strata.index("dynamic")] for name, value in found.items()}


def oracle(targets):
    return np.stack([target.frame.occupied for target in targets]).astype(np.float32)


def persistence(targets):
    return np.repeat(oracle(targets)[:1], len(targets), axis=0)


def test_the_true_future_foresees_every_contact_and_persistence_some():
    best, stays = (foresight(walker_scene(kind)) for kind in (oracle, persistence))
    assert best["foreseen"] == best["roc_auc"] == best["average_precision"] == 1.0
    assert best["false_alarms"] == best["needless_stops"] == 0.0
    assert best["contacts"] == stays["contacts"] > 20
    assert 0.05 < stays["foreseen"] < 0.9


@pytest.mark.parametrize("constant", [0.0, 0.5, 1.0])
def test_a_constant_foresees_as_many_contacts_as_it_has_false_alarms(constant):
    found = foresight(walker_scene(lambda targets: np.full((len(targets), 40, 40), constant, np.float32)))
    assert found["foreseen"] == pytest.approx(0.05)
    assert found["roc_auc"] == pytest.approx(0.5)
    assert found["average_precision"] == pytest.approx(found["contact_share"])


def test_a_forecast_without_a_number_is_missed_and_an_alarm():
    nothing = foresight(walker_scene(lambda targets: np.full((len(targets), 40, 40), np.nan, np.float32)))
    assert nothing["foreseen"] == 0.0
    assert nothing["roc_auc"] == 0.0


def test_a_dilated_forecast_pays_with_false_alarms():
    def dilated(targets):
        p = persistence(targets)
        return np.maximum.reduce([np.roll(p, (a, b), (1, 2)) for a in range(-9, 10) for b in range(-9, 10)])

    best, wide = (foresight(walker_scene(kind)) for kind in (oracle, dilated))
    assert wide["foreseen"] < 0.8 * best["foreseen"]
    assert wide["needless_stops"] > 1.0


def test_lead_time_is_the_time_until_the_contact_of_an_alarm_that_stays_on():
    whole = foresight(walker_scene(oracle, frames=6))["lead_time"]
    assert 0.2 < whole < 2.0
    late = walker_scene(oracle, frames=6)
    for one in late[::2]:  # every other forecast sees nothing coming
        one.forecast.occupancy[:] = 0.0
    assert foresight(late)["lead_time"] < 0.8 * whole


@pytest.mark.parametrize("dtype", [bool, np.float16])
def test_sampled_futures_give_the_probability_of_a_contact(dtype):
    scenes = walker_scene(oracle)
    for number, one in enumerate(scenes):
        later = one.forecast.occupancy
        futures = np.stack([later, later, later, np.zeros_like(later)]).astype(dtype)
        scenes[number] = replace(one, forecast=replace(one.forecast, futures=futures))
    found = foresight(scenes)
    share = found["contact_share"]
    assert found["sampled_log_loss"] == pytest.approx(-share * np.log(0.75) - (1 - share) * np.log(1 - CLIP))


def test_too_few_paths_leave_a_forecast_out_and_are_counted():
    kinds = np.full((40, 40), STATIC_CELL)
    targets = [Target.of_frame(frame(np.ones((40, 40)), np.zeros((40, 40)), 10**8 * n)) for n in range(STEPS + 1)]
    found = foresight([scored(np.zeros((STEPS + 1, 40, 40), np.float32), targets, region_maps(kinds))])
    assert found["skipped"] == 1.0
    assert np.isnan(found["foreseen"])


def test_points_of_the_curve_are_joined_by_lines():
    x, y = np.array([0.0, 0.0, 0.2, 1.0]), np.array([0.1, 0.4, 0.8, 1.0])
    assert _last_at(x, y, 0.05) == pytest.approx(0.5)
    assert _last_at(x, y, 0.0) == pytest.approx(0.4)
    assert _first_at(y, x, 0.4) == pytest.approx(0.0)
    assert _first_at(y, x, 0.9) == pytest.approx(0.6)


def test_a_robot_is_read_from_its_name_or_its_values():
    assert parse_robot("car") == CAR
    assert parse_robot("radius=0.25,speed=0.8") == Robot(radius=0.25, speed=0.8)
    assert str(SMALL_ROBOT) == "radius 0.3 m, up to 1 m/s"
    with pytest.raises(ConfigurationError, match="--robot: there is no option 'width'"):
        parse_robot("width=2")


def test_strata_are_of_the_contact():
    forecast = random_scene(0)
    strata = CONTACT_FORESIGHT.strata(facts_of(forecast))
    of_cells, of_contacts = strata[:3], strata[3:]
    with_truth = facts_of(forecast, has_truth=True, classes=("car", "person"))
    added = ("occluded dynamic", "dynamic car", "dynamic person")
    assert CONTACT_FORESIGHT.strata(with_truth) == (*of_cells, *added, *of_contacts)


@pytest.mark.parametrize("crowded", [False, True])
def test_contacts_are_apart_by_their_time_and_by_the_density_of_the_frame(crowded):
    scene = walker_scene(oracle)[0]
    scene.targets[0].frame.occupied[:, 20] = crowded  # 6 cells or 46 of 1600 are occupied
    strata, sums = counted(CONTACT_FORESIGHT, scene, robot=ROBOT, period_s=PERIOD_S)
    contacts, clears = (sums.block(name).sum(axis=-1) for name in ("contacts", "clears"))
    of = {name: contacts[:, k] for k, name in enumerate(strata)}
    times = [of[f"contacts {name} s ahead"] for name in ("0-0.5", "0.5-1", "1-2")]
    assert np.array_equal(sum(times), of["dynamic"])
    assert times[0].tolist() == [of["dynamic"][0]] * 3
    assert times[2][1] == 0 < times[2][2]
    own, other = ("contacts among few", "contacts in a crowd")[:: -1 if crowded else 1]
    assert np.array_equal(of[own], of["dynamic"])
    assert not of[other].any()
    assert np.array_equal(clears[:, strata.index(own)], clears[:, 0])
    assert not clears[:, strata.index(other)].any()


def test_the_paths_that_are_kept_have_the_contacts_and_the_alarms_of_the_score():
    forecast = random_scene(3)
    known = {"robot": ROBOT, "period_s": PERIOD_S}
    strata, sums = counted(CONTACT_FORESIGHT, forecast, **known)
    step = round(ROBOTS_AHEAD_S / PERIOD_S)
    at = CONTACT_FORESIGHT.steps(facts_of(forecast, **known)).index(step), strata.index("dynamic")
    contacts, clears = (sums.block(name)[at] for name in ("contacts", "clears"))
    robots = robots_of(forecast, facts_of(forecast, **known), (-2.0, 5.0))
    met = robots.contact == 1
    assert (met.sum(), (~met).sum()) == (contacts.sum(), clears.sum())
    assert robots.until_s[~met].tolist() == [ROBOTS_AHEAD_S] * int((~met).sum())
    assert set((robots.until_s[met] / PERIOD_S).tolist()) <= set(range(1, step + 1))
    alarm = robots.risks >= alarm_risk(clears)
    assert 0.02 < alarm[~met].mean() <= 0.05
    foreseen = values(CONTACT_FORESIGHT, sums)["foreseen"][at]
    assert alarm[met].mean() == pytest.approx(foreseen, abs=0.05)


def test_the_paths_that_are_kept_lie_in_the_window_in_metres():
    forecast = random_scene(3)
    facts = facts_of(forecast, robot=Robot(radius=0.75, speed=2.4), period_s=PERIOD_S, cell_m=0.5)
    robots, paths = robots_of(forecast, facts, (-2.0, 5.0)), paths_of(forecast, facts)
    first = np.flatnonzero(np.all(np.isclose(paths.starts * 0.5 + (-2.0, 5.0), robots.places[0]), axis=1))
    assert len(first) == 1
    assert robots.velocities[0] == pytest.approx(paths.strides[first[0]] * 0.5 / PERIOD_S)


def test_without_a_clear_path_only_a_certain_risk_is_an_alarm():
    assert alarm_risk(np.zeros(PROBABILITY_BINS)) == 1.0


def test_no_paths_are_kept_beyond_the_horizon_of_the_run():
    forecast = random_scene(3)
    assert robots_of(forecast, facts_of(forecast, robot=ROBOT, period_s=0.1), (0.0, 0.0)) is None
