"""The pipeline's handful of parameters, stage by stage; `fit` tunes those that the place and its movers decide."""

from __future__ import annotations

from pydantic import Field

from gridtrack.common.config import Settings

NAME = "kalman"
"""What the tracker that runs this pipeline is called."""


class PipelineSettings(Settings):
    """Settings of the model-free pipeline; defaults suit walking people and an indoor laser."""

    # Static background
    explained_above: float = Field(0.15, gt=0, lt=1)
    """A return in or beside a cell that the background holds occupied this often is explained by it."""
    unforeseen_share: float = Field(0.05, ge=0, le=1)
    """The share of the past traffic through open cells that no track announces, in a cell that is seen empty."""
    return_s: float = Field(1.0, gt=0, le=1000)
    """Time constant with which a cell that was seen empty comes back to all of its past traffic."""
    sink_above: float = Field(0.5, gt=0, lt=1)
    """The share of the recent frames in which a cell must have been occupied to be forecast as background."""
    sink_s: float = Field(5.0, gt=0, le=3600)
    """Time constant of that record: how long something stands before it sinks in, or is gone before it is forgotten."""

    # Segmentation
    link_m: float = Field(0.45, gt=0, le=10)
    """Two returns belong to one cluster when they are this near, at the sensor: the gap between two legs."""
    link_per_m: float = Field(0.01, ge=0, le=1)
    """By how much that distance grows with every metre of range, as neighbouring beams part."""

    # Estimation
    velocity_memory_s: float = Field(3.0, gt=0, le=1000)
    """Time constant with which a velocity is forgotten; large: truly constant velocity, small: a walk at random."""
    acceleration: float = Field(0.45, gt=0, le=100)
    """White-noise acceleration of the constant-velocity model: square root of its density, m/s^2 per sqrt(Hz)."""
    position_noise_m: float = Field(0.08, gt=0, le=10)
    """Standard deviation of a cluster's centre about the object's: legs alternate, surfaces come and go."""
    initial_speed: float = Field(0.7, gt=0, le=100)
    """Standard deviation of a new track's velocity along each axis, m/s."""

    # Association
    gate_probability: float = Field(0.999, gt=0.5, lt=1)
    """The share of an object's own clusters that its gate lets in."""
    reach_m: float = Field(0.45, gt=0, le=20)
    """How far from a track's centre its returns may lie: half an object's size, generously."""

    # Life of a track
    birth_probability: float = Field(0.4, gt=0, lt=1)
    """Existence probability of a track that has just been born."""
    detection_probability: float = Field(0.85, gt=0, lt=1)
    """Probability that an object standing where the laser sees it gives a cluster."""
    false_alarm: float = Field(0.15, gt=0, lt=1)
    """Probability of a cluster inside a track's gate where there is no object."""
    life_s: float = Field(15.0, gt=0)
    """Mean time until an object leaves unseen."""
    confirm_above: float = Field(0.8, gt=0, lt=1)
    """Existence probability at which a tentative track becomes confirmed."""
    dead_below: float = Field(0.1, gt=0, lt=1)
    """Existence probability below which a track is dropped."""

    # Shape and forecast
    shape_memory_s: float = Field(0.8, gt=0, le=60)
    """How long a track's points count: about half a stride, so that both legs are in the shape."""
    return_noise_m: float = Field(0.05, gt=0, le=10)
    """Standard deviation of one return about its surface, along each axis."""
