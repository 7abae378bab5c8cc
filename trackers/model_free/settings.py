"""Settings of the model-free pipeline, stage by stage; `fit` tunes the ones that depend on the site and its traffic."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from gridtrack.common.config import Settings
from gridtrack.trackers.model_free.motion import MotionModel, Regimes
from gridtrack.trackers.training.labelled_scans import LabelSettings

AssociationMethod = Literal["hungarian", "jcbb"]
"""The assignment of clusters to tracks: it gates each pair, or the whole set of pairs."""


class PipelineSettings(Settings):
    """Settings of the model-free pipeline; the defaults are for pedestrians and an indoor laser."""

    # Static background
    background: Literal["fitted", "none"] = "fitted"
    """`fitted`: the map counted at the site; `none`: start without a map, and learn walls from the stream only."""
    explained_above: float = Field(0.96, gt=0, lt=1)
    """A return is background if its cell or a neighbour is occupied in more than this share of frames."""
    untracked_share: float = Field(0.05, ge=0, le=1)
    """P(occupied) of a cell just seen empty, without a track, as a share of its fitted occupancy rate."""
    rate_recovery_s: float = Field(1.0, gt=0, le=1000)
    """Time constant of the recovery of P(occupied) to the fitted rate, in a cell that was seen empty."""
    static_above: float = Field(0.5, gt=0, lt=1)
    """A cell is forecast as background if it was occupied in more than this share of the recent frames."""
    adaptation_s: float = Field(5.0, gt=0, le=3600)
    """Adaptation time: time constant of the record of recent frames."""
    map_weight_s: float = Field(2.0, gt=0, le=3600)
    """Map weight: the fitted rate counts in the record like observation for this time."""

    # Segmentation
    link_m: float = Field(0.45, gt=0, le=10)
    """Linking distance of two returns of one cluster at range 0: the gap between two legs."""
    link_per_m: float = Field(0.01, ge=0, le=1)
    """Increase of the linking distance per metre of range, because beams diverge."""

    # Estimation
    acceleration: float = Field(0.1, gt=0, le=100)
    """White-noise acceleration along each axis: square root of its density, m/s^2 per sqrt(Hz)."""
    speed_noise: float = Field(0.05, gt=0, le=10)
    """White noise of the relative change of speed, along the motion: square root of its density, 1/s per sqrt(Hz)."""
    velocity_memory_s: float = Field(3.0, gt=0, le=1000)
    """Correlation time of the velocity; large: constant velocity, small: random walk."""
    turn_acceleration: float = Field(0.05, gt=0, le=100)
    """White-noise acceleration of the turn rate, rad/s^2 per sqrt(Hz)."""
    turn_memory_s: float = Field(1.0, gt=0, le=1000)
    """Correlation time of the turn rate."""
    manoeuvre_noise: float = Field(8.0, ge=1, le=100)
    """Factor on these three noises during a manoeuvre: braking, setting off, turning."""
    steady_duration_s: float = Field(5.0, gt=0, le=1000)
    """Mean duration of steady motion."""
    manoeuvre_duration_s: float = Field(1.0, gt=0, le=1000)
    """Mean duration of a manoeuvre."""
    initial_speed: float = Field(0.7, gt=0, le=100)
    """Standard deviation of a new track's velocity along each axis, m/s."""
    initial_turn_rate: float = Field(0.2, gt=0, le=10)
    """Standard deviation of a new track's turn rate, rad/s."""

    # Measurement
    surface_noise_m: float = Field(0.1, gt=0, le=2)
    """Standard deviation of a return about the boundary that it is matched to; also the spacing of boundary points."""
    position_noise_m: float = Field(0.08, gt=0, le=10)
    """Standard deviation added to each matched position: legs alternate, surfaces appear and disappear."""
    heading_noise: float = Field(0.05, gt=0, le=3)
    """Standard deviation added to each matched heading, rad."""

    # Association
    association: AssociationMethod = "hungarian"
    """Assignment of clusters: `hungarian` gates each pair, `jcbb` the whole set of pairs."""
    gate_probability: float = Field(0.9997, gt=0.5, lt=1)
    """Probability that the gate of an object contains its own cluster."""
    reach_m: float = Field(0.45, gt=0, le=20)
    """Largest distance of further returns of an object from the boundary of its track."""

    # Existence
    initiation_probability: float = Field(0.4, gt=0, lt=1)
    """Existence probability of a new track."""
    detection_probability: float = Field(0.85, gt=0, lt=1)
    """Probability that an object in view of the laser yields a cluster."""
    clutter_probability: float = Field(0.15, gt=0, lt=1)
    """Probability of a cluster inside a track's gate if there is no object."""
    mean_lifetime_s: float = Field(15.0, gt=0)
    """Mean time until an object leaves unobserved."""
    confirm_above: float = Field(0.8, gt=0, lt=1)
    """A tentative track is confirmed at this existence probability."""
    delete_below: float = Field(0.1, gt=0, lt=1)
    """Existence probability below which a track is deleted."""

    # Merging
    background_merge_s: float = Field(60.0, gt=0, le=3600)
    """A track becomes background after its velocity has not differed significantly from zero for this long."""
    track_merge_s: float = Field(2.0, gt=0, le=3600)
    """Two touching tracks are merged after their velocities have not differed significantly for this long."""

    # Shape and forecast
    shape_memory_s: float = Field(0.8, gt=0, le=60)
    """Time constant of a track's boundary points: about half a stride, so that the shape has both legs."""
    residence_speed: float = Field(10.0, gt=0, le=1000)
    """Speed scale, m/s, above which returns do not stay in place: a walker's feet do, a vehicle's side does not."""
    return_noise_m: float = Field(0.05, gt=0, le=10)
    """Standard deviation of one return about its surface, along each axis."""

    def motion(self, period_s: float, window_m: float) -> Regimes:
        """The motion models of every track, in a window with sides of `window_m`."""
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
        durations_s = self.steady_duration_s, self.manoeuvre_duration_s
        return Regimes.of(steady, self.manoeuvre_noise, *durations_s, window_m)


class ModelFreeSettings(LabelSettings, PipelineSettings):
    """Settings of the pipeline, and of its training: motion and background, classes of tracks, or both."""

    stage: Literal["both", "occupancy", "classes"] = "both"
    """The stage to train: `classes` adds classes to existing weights; `both` needs recordings with labels."""
