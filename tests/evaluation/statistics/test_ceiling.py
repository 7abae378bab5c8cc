"""Shares of the way from floor to ceiling, by hand."""

from gridtrack.evaluation.runs.summary import TrackerSummary
from gridtrack.evaluation.runs.summary import PooledSummary, StratumScores, TrialSummary
from gridtrack.evaluation.statistics.ceiling import incomplete_floors, with_ceiling

FLOORS = ("persistence", "static-map")
REQUIRED = [name for name, field in StratumScores.model_fields.items() if field.is_required()]


def scores(f1, nll=None):
    return StratumScores(**{**dict.fromkeys(REQUIRED, ()), "f1": f1, "nll": nll or [None] * len(f1)})


def row(tracker, dynamic, occluded=None, outcome="ok", pooled=None, nll=None):
    strata = {"visible": scores(dynamic), "dynamic": scores(dynamic, nll)}
    strata |= {"occluded": scores(occluded)} if occluded else {}
    return TrackerSummary(
        tracker=tracker,
        role="floor" if tracker in FLOORS else "tracker",
        recordings={"room": TrialSummary(outcome=outcome, strata=strata)},
        pooled=pooled and PooledSummary(outcome="ok", strata={"visible": scores(pooled)}),
    )


def shares(trackers, label):
    return with_ceiling(trackers)[label].recordings["room"].strata["dynamic"].share_of_oracle


def test_the_floor_of_each_step_is_the_better_row():
    trackers = {
        "good": row("kalman", [0.9, 0.5]),
        "oracle": row("oracle", [1.0, 0.8]),
        "persistence": row("persistence", [0.8, 0.2]),
        "static-map": row("static-map", [0.1, 0.4]),
    }
    assert shares(trackers, "good") == (0.5, 0.25)
    assert shares(trackers, "oracle") is None
    assert shares(trackers, "static-map")[1] == 0.0


def test_the_share_of_log_loss_starts_at_the_lowest_floor_and_ends_at_the_oracle():
    trackers = {
        "good": row("kalman", [0.5] * 4, nll=[0.3, 0.5, 0.05, 0.3]),
        "oracle": row("oracle", [1.0] * 4, nll=[0.1, 0.1, 0.1, 0.3985]),
        "persistence": row("persistence", [0.0] * 4, nll=[0.5, 0.4, 0.4, 0.4]),
        "static-map": row("static-map", [0.0] * 4, nll=[0.6, None, 0.3, 0.4]),
    }
    found = with_ceiling(trackers)["good"].recordings["room"].strata["dynamic"].share_of_oracle_nll
    assert found == (0.5, -0.333333, 1.25, None), "below the floor it is negative, and without a gap there is none"
    floor = with_ceiling(trackers)["persistence"].recordings["room"].strata["dynamic"].share_of_oracle_nll
    assert str(floor[0]) == "0.0", "and not -0.0"


def test_a_floor_is_a_row_of_that_role_whatever_its_name():
    trackers = {"a": row("a", [0.5]), "oracle": row("oracle", [1.0]), "other": row("other", [0.0])}
    assert shares(trackers, "a") == (None,)
    floor = {"other": trackers["other"].model_copy(update={"role": "floor"})}
    assert shares(trackers | floor, "a") == (0.5,)


def test_there_is_no_share_without_an_oracle_a_floor_or_room_between_them():
    assert shares({"a": row("a", [0.5]), "persistence": row("persistence", [0.4])}, "a") is None
    assert shares({"a": row("a", [0.5]), "oracle": row("oracle", [0.9])}, "a") == (None,)
    flat = {"a": row("a", [0.5]), "oracle": row("oracle", [0.909]), "p": row("persistence", [0.9])}
    assert shares(flat, "a") == (None,)
    crashed = {"a": row("a", [0.5]), "oracle": row("oracle", [0.9]), "p": row("persistence", [0.4], outcome="crashed")}
    assert shares(crashed, "a") == (None,), "half a floor is none"


def test_there_is_no_share_where_one_of_two_floors_is_not_complete_for_it_may_be_the_best():
    floors = {"p": row("persistence", [0.6], outcome="crashed"), "s": row("static-map", [0.1])}
    trackers = {"a": row("a", [0.8]), "oracle": row("oracle", [0.9]), **floors}
    assert shares(trackers, "a") == (None,)
    assert incomplete_floors(trackers) == ["no share of the oracle: p, a floor, is not complete"]
    assert incomplete_floors({**trackers, "p": row("persistence", [0.6])}) == []


def test_recordings_pooled_have_shares_of_their_own():
    trackers = {
        "a": row("a", [0.5], pooled=[0.25]),
        "oracle": row("oracle", [1.0], pooled=[1.0]),
        "p": row("persistence", [0.0], pooled=[0.0]),
    }
    assert with_ceiling(trackers)["a"].pooled.strata["visible"].share_of_oracle == (0.25,)


def test_a_row_scored_in_part_has_no_share_of_a_whole_oracle():
    part = PooledSummary(outcome="partial", strata={"visible": scores([0.9])})
    trackers = {
        "a": row("a", [0.5], outcome="crashed").model_copy(update={"pooled": part}),
        "oracle": row("oracle", [1.0], pooled=[0.5]),
        "p": row("persistence", [0.0], pooled=[0.0]),
    }
    found = with_ceiling(trackers)["a"]
    assert found.pooled.strata["visible"].share_of_oracle is None, "other frames than the oracle's"
    assert found.recordings["room"].strata["dynamic"].share_of_oracle is None


def test_the_gap_is_what_is_seen_less_what_is_hidden():
    trackers = {"a": row("a", [0.9, None], occluded=[0.2, 0.1])}
    assert with_ceiling(trackers)["a"].recordings["room"].gap_to_truth == (0.7, None)
