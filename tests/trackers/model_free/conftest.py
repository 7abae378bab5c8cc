"""The tests of the model-free trackers need the extra `model-free`."""

from __future__ import annotations

from importlib.util import find_spec

collect_ignore_glob = [] if all(map(find_spec, ("filterpy", "gtsam", "optuna", "sklearn"))) else ["test_*.py"]
