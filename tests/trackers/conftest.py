"""Tests of trackers whose extras are not installed are left out."""

from __future__ import annotations

from importlib.util import find_spec

DEEP, SEARCH = ("torch", "lightning"), ("optuna",)
NEEDED = {
    "model_free/test_*.py": ("filterpy", "gtsam", "sklearn", *SEARCH),
    "recurrent/test_*.py": DEEP,
    "past_frames/test_*.py": DEEP,
    "dogma/test_fit.py": SEARCH,
    "test_calibration.py": ("filterpy",),
    "test_classes.py": DEEP,
    "test_search.py": SEARCH,
}
collect_ignore_glob = [tests for tests, modules in NEEDED.items() if not all(map(find_spec, modules))]
