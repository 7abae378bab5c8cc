"""A comparison on the test recordings of the junction, as the studies run it: `gridtrack compare` in a new folder."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

RECORDINGS = Path("data/junction")
VALIDATION = RECORDINGS / "validation.tracks"


def compare_at_junction(trackers: Iterable[str], reference: str, out: Path, *options: str) -> None:
    """Compare `trackers`, each [LABEL=]NAME[:key=value,...]; `out` is made anew. Ends the program where it fails."""
    shutil.rmtree(out, ignore_errors=True)
    rows = [word for tracker in trackers for word in ("--tracker", tracker)]
    tests = map(str, sorted(RECORDINGS.glob("test-*.tracks")))
    words = ["compare", *tests, "--validation", VALIDATION, *rows, "--reference", reference, "--out", out, *options]
    done = subprocess.run([sys.executable, "-m", "gridtrack.cli", *map(str, words)], check=False)
    if done.returncode:
        raise SystemExit(done.returncode)
