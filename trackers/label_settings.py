"""Settings of learning classes from labelled scans: their number, and the classifier of cells and its training."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from gridtrack.common.config import Settings

ENOUGH_SCANS = 800
"""So many labelled scans are drawn where the user asks for no number: as many as in the paper."""

ClassWeights = Literal["inverse-frequency", "none"]


class LabelSettings(Settings):
    """Which labels a tracker learns from."""

    labelled_scans: int | None = Field(None, ge=1)
    """Number of labelled scans that the classes are learned from; the seed draws them. None: ENOUGH_SCANS, or all where
    fewer are labelled; the card states how many there were."""
    label_drawing: Literal["spread", "consecutive"] = "spread"
    """`spread`: scans from the whole training recordings, as a person would choose them; `consecutive`: in a row."""


class ClassifierSettings(Settings):
    """The width of a classifier, and its training by AdamW on the labelled cells."""

    channels: int = Field(32, ge=1, le=256)
    """Channels of every layer but the last."""
    learning_rate: float = Field(1e-2, gt=0)
    weight_decay: float = Field(1e-2, ge=0)
    class_weights: ClassWeights = "inverse-frequency"
    """Weights of the classes in the loss; the paper's are inverse to the frequency of a class among the labels."""
    updates: int = Field(1200, ge=1)
    """Number of updates; the state with the least log loss on the validation stretch is kept."""
    batch: int = Field(256, ge=1)
    """Labelled cells of one update."""
