"""Shares of the way from floor to ceiling, by hand."""

from gridtrack.evaluation.statistics.ceiling import add_ceiling


def row(tracker, moving, occluded=None, outcome="ok"):
    strata = {"visible": {"f1": moving}, "moving": {"f1": moving}}
    strata |= {"occluded": {"f1": occluded}} if occluded else {}
    return {"tracker": tracker, "pooled": None, "recordings": {"room": {"outcome": outcome, "strata": strata}}}


def shares(trackers, label):
    add_ceiling(trackers)
    return trackers[label]["recordings"]["room"]["strata"]["moving"]["share_of_oracle"]


def test_the_floor_of_each_step_is_the_better_row():
    trackers = {
        "good": row("kalman", [0.9, 0.5]),
        "oracle": row("oracle", [1.0, 0.8]),
        "persistence": row("persistence", [0.8, 0.2]),
        "static-map": row("static-map", [0.1, 0.4]),
    }
    assert shares(trackers, "good") == [0.5, 0.25]
    assert shares(trackers, "oracle") is None
    assert shares(trackers, "static-map")[1] == 0.0


def test_there_is_no_share_without_an_oracle_a_floor_or_room_between_them():
    assert shares({"a": row("a", [0.5]), "persistence": row("persistence", [0.4])}, "a") is None
    assert shares({"a": row("a", [0.5]), "oracle": row("oracle", [0.9])}, "a") == [None]
    flat = {"a": row("a", [0.5]), "oracle": row("oracle", [0.909]), "p": row("persistence", [0.9])}
    assert shares(flat, "a") == [None]
    crashed = {"a": row("a", [0.5]), "oracle": row("oracle", [0.9]), "p": row("persistence", [0.4], outcome="crashed")}
    assert shares(crashed, "a") == [None], "half a floor is none"


def test_recordings_pooled_have_shares_of_their_own():
    trackers = {"a": row("a", [0.5]), "oracle": row("oracle", [1.0]), "p": row("persistence", [0.0])}
    for label, f1 in (("a", 0.25), ("oracle", 1.0), ("p", 0.0)):
        trackers[label]["pooled"] = {"outcome": "ok", "strata": {"visible": {"f1": [f1]}}}
    add_ceiling(trackers)
    assert trackers["a"]["pooled"]["strata"]["visible"]["share_of_oracle"] == [0.25]


def test_the_gap_is_what_is_seen_less_what_is_hidden():
    trackers = {"a": row("a", [0.9, None], occluded=[0.2, 0.1])}
    add_ceiling(trackers)
    assert trackers["a"]["recordings"]["room"]["gap_to_truth"] == [0.7, None]
