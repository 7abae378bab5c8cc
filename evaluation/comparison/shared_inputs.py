"""What the works of a run share: its settings, the regions of each recording, and thresholds chosen so far."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from gridtrack.evaluation.comparison.settings import CompareSettings
from gridtrack.evaluation.comparison.shared_thresholds import SharedThresholds
from gridtrack.evaluation.scoring.splits import EvaluationSplit, SplitRegions


class SharedInputs:
    """Settings, and regions and thresholds, each made once in a process.

    `note` receives a line for the user where that takes a while.
    """

    def __init__(self, settings: CompareSettings, note: Callable[[str], None], folder: Path) -> None:
        """`folder` is that of `SharedThresholds`."""
        self.settings, self.folder = settings, folder
        self.thresholds = SharedThresholds(folder)
        self._note = note
        self._regions: dict[str, SplitRegions] = {}

    def regions_of(self, split: EvaluationSplit) -> SplitRegions:
        """The regions of a split. Raises RecordingError."""
        if split.name not in self._regions:
            self._note(f"{split.name}: finding its static cells")
            self._regions[split.name] = split.regions()
        return self._regions[split.name]
