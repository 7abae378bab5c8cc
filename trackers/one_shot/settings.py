"""Settings of the one-shot classifier; those of the classifier that are not set are tuned in training."""

from __future__ import annotations

from gridtrack.trackers.label_settings import ClassifierSettings, LabelSettings


class OneShotSettings(LabelSettings, ClassifierSettings):
    """The width of the classifier, its training, and its labelled scans."""
