"""The scratch folder of an engine, below that of the run: gone when the engine is left, or when the next one begins."""

from __future__ import annotations

import shutil
from pathlib import Path
from tempfile import mkdtemp

from gridtrack.evaluation.hosting.tracker_process import SCRATCH


def new_scratch(run_folder: Path) -> Path:
    """An empty folder; what a run that was killed left behind is removed. Raises OSError."""
    remove_scratch(run_folder)
    (run_folder / SCRATCH).mkdir(exist_ok=True)
    return Path(mkdtemp(dir=run_folder / SCRATCH))


def remove_scratch(run_folder: Path) -> None:
    """Remove it, as far as possible."""
    shutil.rmtree(run_folder / SCRATCH, ignore_errors=True)
