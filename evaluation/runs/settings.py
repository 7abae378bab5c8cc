"""The settings of a comparison. Light to import: the command line reads its defaults here."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field

from gridtrack.common.config import Settings
from gridtrack.common.errors import ConfigurationError
from gridtrack.evaluation.engines.slurm_settings import SLURM_OPTION, SlurmSettings
from gridtrack.evaluation.hosting.limits import Limits
from gridtrack.recordings.degradation import Degradation

EngineName = Literal["local", "ray", "slurm"]
"""What carries out the trials: threads of this process, or the nodes of a Ray or a Slurm cluster."""


class CompareSettings(Settings):
    """A requested comparison.

    `recordings` as RECORDING[@range], `trackers` as [LABEL=]NAME[:key=value,...] (none: every registered one);
    `reference` the label of the row that the others are compared with (none: `persistence`, else the first);
    `validation` a RECORDING[@range] to choose thresholds on, instead of each recording's own validation stretch. With
    `segment_s` longer test stretches are cut into trials of their own, each after `warm_up_s` that are not scored. With
    `follow` the recording is still being written, and it ends when nothing was written for `idle_timeout_s`.
    """

    recordings: tuple[str, ...] = Field(min_length=1)
    trackers: tuple[str, ...] = ()
    out: Path = Path("runs/latest")
    validation: str | None = None
    reference: str | None = None
    horizon_s: float = Field(2.5, gt=0.0, le=60.0)
    every_s: float = Field(1.0, gt=0.0, le=3600.0)
    segment_s: float | None = Field(None, ge=10.0, le=86_400.0)
    warm_up_s: float = Field(60.0, ge=0.0, le=3600.0)
    """Of segments after the first, at least."""
    grid: str | None = None
    rate_hz: float | None = Field(None, gt=0.0, le=1000.0)
    seed: int = Field(0, ge=0, lt=2**31)
    weights: Path | None = None
    trackers_toml: Path | None = None
    limits: Limits = Limits()
    jobs: int | None = Field(None, ge=1)
    engine: EngineName = "local"
    address: str | None = None
    """Of the Ray cluster; None: the one that this machine belongs to."""
    slurm: SlurmSettings | None = None
    allow_leak: bool = False
    resume: bool = False
    latency: bool = False
    deadline: bool = False
    degrade: Degradation | None = None
    follow: bool = False
    idle_timeout_s: float = Field(60.0, gt=0.0, le=86_400.0)


def check_together(settings: CompareSettings) -> None:
    """Raise ConfigurationError for settings that are not possible together."""
    if settings.follow and settings.segment_s is not None:
        raise ConfigurationError("--segment cuts a finished recording: leave it out with --follow")
    _check_engine(settings)


def _check_engine(settings: CompareSettings) -> None:
    """Raise ConfigurationError for settings that the engine does not have."""
    engine = settings.engine
    if settings.address is not None and engine != "ray":
        raise ConfigurationError("--address is of a Ray cluster: leave it out, or choose --engine ray")
    if settings.slurm is not None and engine != "slurm":
        raise ConfigurationError(f"{SLURM_OPTION} is of a Slurm cluster: leave it out, or choose --engine slurm")
    if engine == "local":
        return
    for name in ("latency", "deadline"):
        if getattr(settings, name):
            raise ConfigurationError(
                f"--{name} times each tracker alone on a machine, which --engine {engine} does not give: leave it out,"
                f" then measure on one machine with --engine local --resume --{name}"
            )
    if settings.follow:
        raise ConfigurationError(f"--follow runs on this machine: leave --engine {engine} out")
    if settings.jobs is not None:
        raise ConfigurationError(
            f"--jobs is of --engine local: with --engine {engine} as many trials run as the cluster has room for"
        )
