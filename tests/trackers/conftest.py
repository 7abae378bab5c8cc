"""Tests of trackers need their extras: without them they are not collected, and a warning names the tests."""

from __future__ import annotations

import warnings
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
if collect_ignore_glob:
    warnings.warn(f"extras are missing: not collected: {', '.join(collect_ignore_glob)}", stacklevel=1)
