"""Model-free trackers: a pipeline of stages after Wang, Posner and Newman (IJRR 2015), with two state estimators.

The kernels index single numbers: array operations of NumPy and its linear algebra take numba seconds each to compile.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gridtrack.trackers.model_free.factor_graph import FactorGraphTracker
    from gridtrack.trackers.model_free.kalman import KalmanTracker

__all__ = ["FactorGraphTracker", "KalmanTracker"]


def __getattr__(name: str) -> Any:
    """Imports each tracker at first use: `kalman` runs without gtsam."""
    if name == "KalmanTracker":
        from gridtrack.trackers.model_free.kalman import KalmanTracker

        return KalmanTracker
    if name == "FactorGraphTracker":
        from gridtrack.trackers.model_free.factor_graph import FactorGraphTracker

        return FactorGraphTracker
    raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
