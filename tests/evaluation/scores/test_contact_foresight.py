"""Contact foresight, against a second implementation of the definition and on small hand-made cases."""

from __future__ import annotations

import numpy as np
import pytest

from gridtrack.common.errors import ConfigurationError
from gridtrack.evaluation.referee.strata import STRATA
from gridtrack.evaluation.referee.targets import HIDDEN_FREE, HIDDEN_OCCUPIED, NOT_SCORED, Target
from gridtrack.evaluation.scores.cells import PROBABILITY_BINS
from gridtrack.evaluation.scores.contact_foresight import (
    CONTACT_FORESIGHT,
    LEAST_PATHS,
    ROBOTS_AHEAD_S,
    _first_at,
    _last_at,
    alarm_risk,
    paths_of,
    robots_of,
)
from gridtrack.evaluation.scores.contact_paths import NEVER, PATHS, draw_paths, events_of, paths_along, risks_of
from gridtrack.evaluation.scores.definition import Sums
from gridtrack.evaluation.scores.robot import CAR, SMALL_ROBOT, Robot, parse_robot

from scenes.scored_cells import DYNAMIC_CELL, STATIC_CELL, counted, facts_of, frame, region_maps, scored, values

STEPS, SIZE, PERIOD_S = 8, 40, 0.25
ROBOT = Robot(radius=1.5, speed=4.8)


def cells_of_step(start, stride, radius, n):
    """Cells with a centre in the disc at step n, or between its positions at n-1 and n, by points along the way."""
    rows, columns = np.indices((SIZE, SIZE)) + 0.5
    way = start + np.linspace(n - 1, n, 400)[:, None] * stride
    near = np.hypot(columns[..., None] - way[:, 0], rows[..., None] - way[:, 1]).min(axis=-1) <= radius
    return list(zip(*np.nonzero(near), strict=True))


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
    return scored(rng.random((STEPS + 1, SIZE, SIZE)).astype(np.float32) ** 8, targets, region_maps(kinds))


@pytest.mark.parametrize("seed", range(3))
def test_events_and_risks_are_those_of_the_definition(seed):
    forecast = random_scene(seed)
    paths = paths_of(forecast, facts_of(forecast, robot=ROBOT, period_s=PERIOD_S))
    paths = paths.at(np.arange(len(paths)) < 30)
    last = len(forecast.targets) - 1
    events = events_of(paths, forecast.targets[1:], has_truth=False)
    largest, independent = risks_of(paths, forecast.forecast.occupancy[1:])
    for i in range(len(paths)):
        contact, unseen, most, by_cell = NEVER, NEVER, 0.0, {}
        for n in range(1, last + 1):
            cells = cells_of_step(paths.starts[i], paths.strides[i], 1.5, n)
            state, p = forecast.targets[n].state, forecast.forecast.occupancy[n]
            if contact == NEVER and any(state[cell] == 1 for cell in cells):
                contact = n
            if unseen == NEVER and contact == NEVER and any(state[cell] == NOT_SCORED for cell in cells):
                unseen = n
            most = max([most, *(p[cell] for cell in cells)])
            for cell in cells:
                by_cell[cell] = max(by_cell.get(cell, 0.0), p[cell])
            assert largest[i, n - 1] == pytest.approx(most)
            clear = np.prod([1.0 - float(p) for p in by_cell.values()])
            assert independent[i, n - 1] == pytest.approx(1.0 - clear, abs=1e-6)
        assert events.contact[i] == contact
        if contact == NEVER:
            assert events.unseen[i] == unseen
        else:
            assert forecast.targets[contact].state.flat[events.hit[i]] == 1


def test_paths_start_safe_and_stay_in_the_window_and_off_static_cells_and_ring():
    kinds = np.full((SIZE, SIZE), DYNAMIC_CELL)
    kinds[20:24, 20:24] = STATIC_CELL
    free, passable = np.ones((SIZE, SIZE), bool), kinds == DYNAMIC_CELL
    free[:, :10] = False
    paths = draw_paths(7, free & passable, passable, 1.5, 1.2, STEPS)
    assert len(paths) == PATHS
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


def test_a_person_who_crosses_before_the_robot_is_no_contact_and_one_who_is_there_in_time_is():
    paths, targets, _ = hand_drawn([(1, 4, 4), (2, 4, 4)], [])
    assert events_of(paths, targets[1:], has_truth=False).contact == [NEVER]
    paths, targets, _ = hand_drawn([(3, 4, 4)], [])
    events = events_of(paths, targets[1:], has_truth=False)
    assert (events.contact, events.hit) == ([3], [4 * 9 + 4])


def test_the_risk_is_the_largest_probability_in_time_and_grows_with_the_horizon():
    paths, _, p = hand_drawn([], [(1, 4, 4, 0.9), (2, 4, 3, 0.3), (3, 4, 4, 0.2), (3, 4, 8, 1.0)])
    largest, independent = risks_of(paths, p[1:])
    assert largest[0].tolist() == pytest.approx([0.0, 0.3, 0.3])
    assert independent[0].tolist() == pytest.approx([0.0, 0.3, 1 - 0.7 * 0.8])


def test_an_unseen_cell_makes_a_path_unknown_from_then_on_unless_a_contact_came_first():
    paths, targets, _ = hand_drawn([(3, 4, 4)], [], hidden=[(2, 4, 3)])
    events = events_of(paths, targets[1:], has_truth=False)
    assert (events.unseen, events.contact) == ([2], [3])
    paths, targets, _ = hand_drawn([], [], hidden=[(2, 4, 3)])
    assert events_of(paths, targets[1:], has_truth=False).contact == [NEVER]


def test_with_truth_hidden_outlines_and_interiors_are_contacts_and_nothing_is_unknown():
    for state in (HIDDEN_OCCUPIED, NOT_SCORED, HIDDEN_FREE):
        paths, targets, _ = hand_drawn([], [], hidden=[(2, 4, 3)])
        targets[2].state[4, 3] = state
        events = events_of(paths, targets[1:], has_truth=True)
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


def test_too_few_paths_leave_a_forecast_out_and_are_counted():
    kinds = np.full((40, 40), STATIC_CELL)
    targets = [Target.of_frame(frame(np.ones((40, 40)), np.zeros((40, 40)), 10**8 * n)) for n in range(STEPS + 1)]
    found = foresight([scored(np.zeros((STEPS + 1, 40, 40), np.float32), targets, region_maps(kinds))])
    assert found["skipped"] == 1.0
    assert np.isnan(found["foreseen"])
    assert LEAST_PATHS == 50


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
    assert CONTACT_FORESIGHT.strata(facts_of(forecast)) == ("dynamic", "in-motion", "standing")
    with_truth = facts_of(forecast, has_truth=True, classes=("car", "person"))
    assert CONTACT_FORESIGHT.strata(with_truth)[3:] == ("occluded dynamic", "dynamic car", "dynamic person")
    assert set(CONTACT_FORESIGHT.strata(facts_of(forecast))) <= set(STRATA)


def test_the_paths_that_are_kept_have_the_contacts_and_the_alarms_of_the_score():
    forecast = random_scene(3)
    known = {"robot": ROBOT, "period_s": PERIOD_S}
    strata, sums = counted(CONTACT_FORESIGHT, forecast, **known)
    step = round(ROBOTS_AHEAD_S / PERIOD_S)
    contacts, clears = (sums.block(name)[step, strata.index("dynamic")] for name in ("contacts", "clears"))
    robots = robots_of(forecast, facts_of(forecast, **known), (-2.0, 5.0))
    met = robots.contact == 1
    assert (met.sum(), (~met).sum()) == (contacts.sum(), clears.sum())
    assert robots.until_s[~met].tolist() == [ROBOTS_AHEAD_S] * int((~met).sum())
    assert set((robots.until_s[met] / PERIOD_S).tolist()) <= set(range(1, step + 1))
    alarm = robots.risks >= alarm_risk(clears)
    assert 0.02 < alarm[~met].mean() <= 0.05
    foreseen = values(CONTACT_FORESIGHT, sums)["foreseen"][step, strata.index("dynamic")]
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
