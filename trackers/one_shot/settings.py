"""Settings of the one-shot classifier; those of the classifier that are not set are tuned in training."""

from __future__ import annotations

from gridtrack.trackers.label_settings import ClassifierSettings, LabelSettings

ONE_SHOT = "one-shot"
LAYERS = 3


class OneShotSettings(LabelSettings, ClassifierSettings):
    """The width of the classifier, its training, and its number of labelled scans."""

    @property
    def hidden(self) -> tuple[int, ...]:
        """Channels of every layer but the last."""
        return (self.channels,) * (LAYERS - 1)
