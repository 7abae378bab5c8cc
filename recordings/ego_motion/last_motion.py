"""The velocity of the last motion, which predicts the next pose where there is no odometry."""

from __future__ import annotations

import numpy as np

from gridtrack.common.geometry import SE2
from gridtrack.common.pose_quality import PoseQuality
from gridtrack.recordings.ego_motion.prior import Velocity, inverse
from gridtrack.recordings.ego_motion.returns import PlaneArray
from gridtrack.recordings.ego_motion.settings import MatchingSettings

MIN_VELOCITY_S = 0.04
"""The velocity is measured over at least this time: stamps of a log that come in bursts would give any velocity."""
MAX_COAST_S, MAX_OPEN_S = 1.0, 5.0
"""The last motion is continued for this long where scans cannot be matched, and where they leave a direction open; then
the sensor is taken to stand."""
UNKNOWN_VELOCITY = np.array([3.0, 3.0, 1.0])
"""Standard deviations at the beginning, m/s and rad/s."""
MAX_DEVIATION = np.array([10.0, 10.0, 3.0])
"""They never grow beyond these."""


class LastMotion:
    """The velocity from scan to scan; its covariance grows in each direction until a match constrains it again."""

    def __init__(self, stamp_ns: int, world_T_sensor: SE2, settings: MatchingSettings) -> None:
        self._from = stamp_ns, world_T_sensor
        self._stamp_ns = self._matched_ns = self._constrained_ns = stamp_ns
        self._velocity = Velocity(SE2(), np.diag(UNKNOWN_VELOCITY**2))
        self._change = np.array([settings.acceleration, settings.acceleration, settings.turn_acceleration])

    def velocity(self, stamp_ns: int) -> Velocity:
        """The velocity with which to predict the pose at a stamp."""
        stands = stamp_ns - self._matched_ns > MAX_COAST_S * 1e9 or stamp_ns - self._constrained_ns > MAX_OPEN_S * 1e9
        return self._velocity._replace(mean=SE2()) if stands else self._velocity

    def add(self, stamp_ns: int, world_T_sensor: SE2, quality: PoseQuality, information: PlaneArray) -> None:
        """The next pose, with the information (3, 3) of its match."""
        since_s = (stamp_ns - self._stamp_ns) / 1e9
        grown = self._velocity.covariance + np.diag((self._change * since_s) ** 2)
        beyond = float(np.max(np.diag(grown) / MAX_DEVIATION**2))
        self._velocity = self._velocity._replace(covariance=grown / max(beyond, 1.0))
        self._stamp_ns = stamp_ns
        if quality.failed:
            return
        self._matched_ns = stamp_ns
        if not quality.fell_back:
            self._constrained_ns = stamp_ns
        self._measure(stamp_ns, world_T_sensor, information)

    def _measure(self, stamp_ns: int, world_T_sensor: SE2, information: PlaneArray) -> None:
        then_ns, then = self._from
        since_s = (stamp_ns - then_ns) / 1e9
        if since_s >= MIN_VELOCITY_S:
            motion = then.inverse() @ world_T_sensor
            mean = SE2(motion.x / since_s, motion.y / since_s, motion.theta / since_s)
            self._velocity = Velocity(mean, inverse(information) / since_s**2)
            self._from = stamp_ns, world_T_sensor
