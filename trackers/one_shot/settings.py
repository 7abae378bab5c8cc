"""The settings of the one-shot classifier; those that are not given are tuned when it is trained."""

from __future__ import annotations

from pydantic import Field

from gridtrack.trackers.labelled import LabelSettings

NAME = "one-shot"


class OneShotSettings(LabelSettings):
    """The width of the classifier, and its training by AdamW on the cells whose class is known."""

    channels: int = Field(32, ge=1, le=256)
    learning_rate: float = Field(3e-3, gt=0)
    weight_decay: float = Field(1e-2, ge=0)
    updates: int = Field(2000, ge=1)
    """At most; kept is the state that classifies the validation stretch best."""
    batch: int = Field(256, ge=1)
    """Labelled cells in an update."""
