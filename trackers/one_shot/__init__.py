"""The one-shot classifier: classes from one scan alone, the baseline of the latent state's."""

from gridtrack.trackers.one_shot.tracker import OneShotTracker

__all__ = ["OneShotTracker"]
