"""The settings of the one-shot classifier; those that are not given are tuned when it is trained."""

from __future__ import annotations

from gridtrack.trackers.label_settings import ClassifierSettings, LabelSettings

ONE_SHOT = "one-shot"
LAYERS = 3


class OneShotSettings(LabelSettings, ClassifierSettings):
    """The width of the classifier, its training, and how many labels it is given."""

    @property
    def hidden(self) -> tuple[int, ...]:
        """Channels of every layer but the last."""
        return (self.channels,) * (LAYERS - 1)
