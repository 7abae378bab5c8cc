"""The commands of the first page run as they stand, on the recording that ships."""

from __future__ import annotations

import shlex
import subprocess
import sys
from pathlib import Path

from docs.pages import ROOT, commands


def test_the_commands_of_the_first_comparison_run_in_their_order(tmp_path: Path) -> None:
    (tmp_path / "data").symlink_to(ROOT / "data")
    lines = [line for line in commands(ROOT / "docs/first-comparison.md") if line.startswith("gridtrack ")]
    assert len(lines) == 3
    for line in lines:
        command = [sys.executable, "-m", "gridtrack.cli", *shlex.split(line)[1:]]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"{line}\n{done.stderr}"
    assert done.stdout.startswith("recording,run,tracker")
