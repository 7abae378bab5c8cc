"""Settings of scan matching. Kernel and voxels are chosen by `python -m studies.ego_motion`."""

from __future__ import annotations

from pydantic import Field

from gridtrack.common.config import Settings


class MatchingSettings(Settings):
    """How scans are matched with the local map, and when a match is not used. Metres, radians, seconds."""

    max_range_m: float = Field(default=20.0, gt=0.0, le=1e3)
    """Returns beyond it are not matched, and the map is forgotten beyond it."""
    voxel_m: float = Field(default=0.3, gt=0.0, le=10.0)
    """Side of the voxels of the local map."""
    point_spacing_m: float = Field(default=0.1, gt=0.0, le=10.0)
    """Returns nearer to one another than this are registered as one."""
    map_spacing_m: float = Field(default=0.03, gt=0.0, le=10.0)
    """The same of the returns that are added to the map."""
    kernel_m: float = Field(default=0.1, gt=0.0, le=10.0)
    """Scale of the robust kernel: a return this far from the map has a quarter of the weight, at three times none."""
    coarse_kernel_m: float = Field(default=0.5, gt=0.0, le=10.0)
    """Kernel of the registration where there is no odometry."""
    return_noise_m: float = Field(default=0.02, gt=0.0, le=10.0)
    """Standard deviation of one return's distance to its wall, which weighs the match against the prior."""
    odometry_drift: float = Field(default=0.05, ge=0.0, le=10.0)
    """Standard deviation of odometry's position, metres for each metre driven."""
    odometry_turn_drift: float = Field(default=1.0, ge=0.0, le=10.0)
    """Standard deviation of odometry's heading, radians for each radian turned, and half of it for each metre."""
    acceleration: float = Field(default=3.0, ge=0.0, le=100.0)
    """Without odometry: m/s^2, standard deviation of the change of the velocity."""
    turn_acceleration: float = Field(default=10.0, ge=0.0, le=1e3)
    """Without odometry: rad/s^2, as above."""
    min_returns: int = Field(default=20, ge=3)
    """A scan with fewer returns in range is not matched."""
    min_inlier_share: float = Field(default=0.4, ge=0.0, le=1.0)
    """Share of the returns that must lie on the map."""
    min_constraint: float = Field(default=0.01, ge=0.0, le=0.5)
    """A direction is left to the prior in which less than this share of the surface constrains the pose, the compact
    cluster left out that constrains it most: it may move."""
    max_deviations: float = Field(default=5.0, gt=0.0)
    """A match is not used that is further from the prior than so many of its deviations, and 20 cm or 15 deg."""
