"""The pipeline's handful of parameters, stage by stage; `fit` tunes those that the place and its movers decide."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from gridtrack.common.config import Settings
from gridtrack.trackers.label_settings import LabelSettings
from gridtrack.trackers.model_free.motion.parameters import MotionModel, Regimes

AssociationMethod = Literal["hungarian", "jcbb"]
"""How clusters are assigned to tracks: by gating each pair, or the whole set of pairs."""


class PipelineSettings(Settings):
    """Settings of the model-free pipeline; defaults suit walking people and an indoor laser."""

    # Static background
    background: Literal["fitted", "none"] = "fitted"
    """Where the map comes from: the place's own, or none of it (a cold start), and walls have to sink in first."""
    explained_above: float = Field(0.96, gt=0, lt=1)
    """A return is explained by the background where that has one, in its cell or beside it, in this share of frames."""
    untracked_share: float = Field(0.05, ge=0, le=1)
    """The share of the past traffic through open cells that no track announces, in a cell that is seen empty."""
    rate_recovery_s: float = Field(1.0, gt=0, le=1000)
    """Time constant with which a cell that was seen empty comes back to all of its past traffic."""
    static_above: float = Field(0.5, gt=0, lt=1)
    """The share of the recent frames in which a cell must have been occupied to be forecast as background."""
    adaptation_s: float = Field(5.0, gt=0, le=3600)
    """Time constant of that record: how long something stands before it sinks in, or is gone before it is forgotten."""
    map_weight_s: float = Field(2.0, gt=0, le=3600)
    """How long a cell has to be seen for that record to weigh as much as the map's."""

    # Segmentation
    link_m: float = Field(0.45, gt=0, le=10)
    """Two returns belong to one cluster when they are this near, at the sensor: the gap between two legs."""
    link_per_m: float = Field(0.01, ge=0, le=1)
    """By how much that distance grows with every metre of range, as neighbouring beams part."""

    # Estimation
    acceleration: float = Field(0.1, gt=0, le=100)
    """White-noise acceleration along each axis: square root of its density, m/s^2 per sqrt(Hz)."""
    speed_noise: float = Field(0.05, gt=0, le=10)
    """White noise of the speed's relative growth, 1/s per sqrt(Hz): of what is fast, along its motion."""
    velocity_memory_s: float = Field(3.0, gt=0, le=1000)
    """Time constant with which a velocity is forgotten; large: truly constant velocity, small: a walk at random."""
    turn_acceleration: float = Field(0.05, gt=0, le=100)
    """White-noise acceleration of the turn rate, rad/s^2 per sqrt(Hz)."""
    turn_memory_s: float = Field(1.0, gt=0, le=1000)
    """Time constant with which a turn rate is forgotten."""
    manoeuvre_noise: float = Field(8.0, ge=1, le=100)
    """How many times these three noises are larger while an object brakes, sets off or turns."""
    steady_duration_s: float = Field(5.0, gt=0, le=1000)
    """For how long an object moves steadily, in the mean."""
    manoeuvre_duration_s: float = Field(1.0, gt=0, le=1000)
    """For how long it then does not."""
    initial_speed: float = Field(0.7, gt=0, le=100)
    """Standard deviation of a new track's velocity along each axis, m/s."""
    initial_turn_rate: float = Field(0.2, gt=0, le=10)
    """Standard deviation of a new track's turn rate, rad/s."""

    # Measurement
    surface_noise_m: float = Field(0.1, gt=0, le=2)
    """Standard deviation of a return about the boundary it is matched to; boundary points are so far apart."""
    position_noise_m: float = Field(0.08, gt=0, le=10)
    """Standard deviation of a matched position beside that: legs alternate, surfaces come and go."""
    heading_noise: float = Field(0.05, gt=0, le=3)
    """The same of a matched heading, rad."""

    # Association
    association: AssociationMethod = "hungarian"
    """How clusters are assigned: `hungarian` gates each pair, `jcbb` the whole set of pairs."""
    gate_probability: float = Field(0.9997, gt=0.5, lt=1)
    """The share of an object's own clusters that its gate lets in."""
    reach_m: float = Field(0.45, gt=0, le=20)
    """How far from a track's boundary further returns of it may lie."""

    # Life of a track
    initiation_probability: float = Field(0.4, gt=0, lt=1)
    """Existence probability of a track that has just been born."""
    detection_probability: float = Field(0.85, gt=0, lt=1)
    """Probability that an object standing where the laser sees it gives a cluster."""
    clutter_probability: float = Field(0.15, gt=0, lt=1)
    """Probability of a cluster inside a track's gate where there is no object."""
    mean_lifetime_s: float = Field(15.0, gt=0)
    """Mean time until an object leaves unseen."""
    confirm_above: float = Field(0.8, gt=0, lt=1)
    """Existence probability at which a tentative track becomes confirmed."""
    delete_below: float = Field(0.1, gt=0, lt=1)
    """Existence probability below which a track is dropped."""

    # Merging
    background_merge_s: float = Field(60.0, gt=0, le=3600)
    """A track whose velocity could not be told from zero for so long becomes background."""
    track_merge_s: float = Field(2.0, gt=0, le=3600)
    """Two tracks that touch and whose velocities could not be told apart for so long become one."""

    # Shape and forecast
    shape_memory_s: float = Field(0.8, gt=0, le=60)
    """How long a track's points count: about half a stride, so that both legs are in the shape."""
    residence_speed: float = Field(10.0, gt=0, le=1000)
    """Speed, m/s, from which on returns do not stay in place: a walker's feet do, a vehicle's side does not."""
    return_noise_m: float = Field(0.05, gt=0, le=10)
    """Standard deviation of one return about its surface, along each axis."""

    def motion(self, period_s: float) -> Regimes:
        """The motion models of every track."""
        steady = MotionModel(
            self.acceleration,
            self.speed_noise,
            self.turn_acceleration,
            self.velocity_memory_s,
            self.turn_memory_s,
            self.initial_speed,
            self.initial_turn_rate,
            period_s,
        )
        return Regimes.of(steady, self.manoeuvre_noise, self.steady_duration_s, self.manoeuvre_duration_s)


class ModelFreeSettings(LabelSettings, PipelineSettings):
    """The pipeline's settings, and what is fitted: its motion and background, the classes of its tracks, or both."""

    stage: Literal["both", "occupancy", "classes"] = "both"
    """`classes` adds classes to the weights that are there; `both` where a recording has classes."""
