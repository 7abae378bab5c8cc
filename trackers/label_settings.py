"""Settings of learning classes from labelled scans: their number, and the classifier of cells and its training."""

from __future__ import annotations

from pydantic import Field

from gridtrack.common.config import Settings


class LabelSettings(Settings):
    """How many labels a tracker learns from."""

    labelled_scans: int = Field(800, ge=1)
    """Number of consecutive labelled scans that the classes are learned from; the seed draws the first one."""


class ClassifierSettings(Settings):
    """The width of a classifier, and its training by AdamW on the labelled cells."""

    channels: int = Field(32, ge=1, le=256)
    """Channels of every layer but the last."""
    learning_rate: float = Field(3e-3, gt=0)
    weight_decay: float = Field(1e-2, ge=0)
    updates: int = Field(2000, ge=1)
    """Number of updates; the state with the least log loss on the validation stretch is kept."""
    batch: int = Field(256, ge=1)
    """Labelled cells of one update."""
