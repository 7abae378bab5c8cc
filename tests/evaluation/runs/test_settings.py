"""Settings of a comparison and limits of a trial: light modules, for the defaults of the command line."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

HEAVY = {"numba", "polars", "pyarrow", "rosbags", "scipy", "torch"}


@pytest.mark.parametrize("module", ["evaluation.runs.settings", "evaluation.hosting.limits"])
def test_importing_the_settings_loads_no_heavy_library(module: str) -> None:
    code = f"import gridtrack.{module}, sys, json; print(json.dumps(sorted(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert HEAVY & set(json.loads(done.stdout)) == set()
