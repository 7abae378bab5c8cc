"""What the works of a run share: its settings, the regions of each recording, and thresholds chosen so far."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path

from gridtrack.evaluation.runs.settings import CompareSettings
from gridtrack.evaluation.runs.shared_thresholds import SharedThresholds
from gridtrack.evaluation.scoring.splits import EvaluationSplit, SplitRegions


class SharedInputs:
    """Settings, and regions and thresholds, each made by the first work of a process that needs it. Thread-safe.

    `note` receives a line for the user where that takes a while.
    """

    def __init__(self, settings: CompareSettings, note: Callable[[str], None], folder: Path, works: int = 1) -> None:
        """`folder` is that of `SharedThresholds`; `works` run at the same time.

        The regions of as many recordings are kept: they are megabytes, and a run may have thousands of recordings.
        """
        self.settings, self.folder = settings, folder
        self.thresholds = SharedThresholds(folder)
        self._note, self._works = note, works
        self._guard = threading.Lock()
        self._regions: dict[str, Future[SplitRegions]] = {}
        """By the name of the whole split, those asked for last at the end."""

    def regions_of(self, split: EvaluationSplit, check: Callable[[], None] = lambda: None) -> SplitRegions:
        """The regions of a split; finding them calls `check()` now and then. Raises what it raises, RecordingError."""
        with self._guard:
            known = self._regions.pop(split.whole, None)
            found = self._regions[split.whole] = known or Future()
            while len(self._regions) > self._works:
                del self._regions[next(iter(self._regions))]
        if known is None:
            self._find(split, found, check)
        return found.result()

    def _find(self, split: EvaluationSplit, found: Future[SplitRegions], check: Callable[[], None]) -> None:
        """Make the regions of a split, or the error of all that wait for them."""
        self._note(f"{split.whole}: finding its static cells")
        try:
            found.set_result(split.regions(check))
        except Exception as error:  # noqa: BLE001 all works that wait for them raise it
            found.set_exception(error)
