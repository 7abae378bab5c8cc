"""A drift of matches from odometry, that of a crowd, beside the slip of a wheel."""

from __future__ import annotations

from collections.abc import Iterable

from gridtrack.common.geometry import SE2
from gridtrack.recordings.ego_motion.matching import DriftFromOdometry

PERIOD_NS, POSITION_M = 100_000_000, 0.006


def verdicts(differences_m: Iterable[float]) -> list[bool]:
    """Of matches that differ from odometry by so much along x, ten a second."""
    drift, predicted = DriftFromOdometry(max_deviations=5.0), SE2(3.0, 4.0, 0.5)
    return [
        drift.grows(k * PERIOD_NS, predicted, SE2(3.0 + off_m, 4.0, 0.5), POSITION_M)
        for k, off_m in enumerate(differences_m)
    ]


def test_differences_of_every_scan_in_one_direction_are_a_drift_until_a_second_after_they_end() -> None:
    found = verdicts([0.0] * 10 + [0.04] * 15 + [0.0] * 15)
    assert not any(found[:15])
    assert all(found[20:25])
    assert not any(found[35:])


def test_one_slip_and_the_noise_of_matches_are_no_drift() -> None:
    assert not any(verdicts([0.02, -0.02] * 10 + [0.5] + [-0.02, 0.02] * 10))


def test_a_few_scans_say_nothing() -> None:
    assert not any(verdicts([0.2] * 3))
