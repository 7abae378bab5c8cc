"""The life of a track: born tentative, confirmed by what it explains, coasting while unseen, dead when disproved."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from gridtrack.trackers.model_free.estimation import MotionEstimator

Array = NDArray[np.float64]

MAX_POINTS = 512
"""The most points a track carries; the oldest go first."""


class Status(Enum):
    """Where a track stands in its life."""

    TENTATIVE = "tentative"
    CONFIRMED = "confirmed"
    COASTING = "coasting"


@dataclass(slots=True)
class Shape:
    """The points a track carries: `offsets` (N, 2) from its position, metres, grid frame axes, and `weights` (N,).

    A frame's points enter with one weight and fade from frame to frame; the weights of all frames sum to 1, so a
    weight is the share that its frame has in what the object is expected to look like.
    """

    offsets: Array
    weights: Array

    @classmethod
    def of(cls, offsets: Array) -> Shape:
        """The shape that one frame's points make."""
        return cls(offsets, np.ones(len(offsets)))

    def extend(self, offsets: Array, keep: float) -> None:
        """Let what is known fade to the share `keep`, and add this frame's points."""
        weights = np.concatenate([np.full(len(offsets), 1.0 - keep), self.weights * keep])
        keep_points = weights[:MAX_POINTS] > 0.02 * (1.0 - keep)
        self.offsets = np.concatenate([offsets, self.offsets])[:MAX_POINTS][keep_points]
        self.weights = weights[:MAX_POINTS][keep_points]


@dataclass(slots=True)
class Track:
    """One object followed over time; `existence` is the probability that there is one."""

    identity: int
    estimator: MotionEstimator
    shape: Shape
    returns: Array
    """Its newest returns (N, 2), metres, grid frame, seen `unseen` frames ago."""
    ages: NDArray[np.int64]
    """For how many frames each return (N,) had then been in place."""
    existence: float
    confirmed: bool = False
    unseen: int = 0
    """Frames since returns were last given to it."""

    @property
    def position(self) -> Array:
        """Position (2,), metres, grid frame."""
        return self.estimator.mean[:2]

    @property
    def status(self) -> Status:
        """Where it stands in its life."""
        if not self.confirmed:
            return Status.TENTATIVE
        return Status.COASTING if self.unseen else Status.CONFIRMED


def existence_when_detected(existence: float, detection_probability: float, false_alarm: float) -> float:
    """Bayes' rule for the existence probability after a detection in the gate (Musicki and Evans 1994)."""
    hit = existence * detection_probability
    return hit / (hit + (1.0 - existence) * false_alarm)


def existence_when_missed(existence: float, detection_probability: float) -> float:
    """Bayes' rule for the existence probability after no detection.

    `detection_probability` is that of an object which is there: 0 where it would be hidden, and the miss says nothing.
    """
    return existence * (1.0 - detection_probability) / (1.0 - existence * detection_probability)
