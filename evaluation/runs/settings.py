"""The settings of a comparison. Light to import: the options of the command line are generated from them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from gridtrack.common.config import Settings
from gridtrack.common.errors import ConfigurationError
from gridtrack.common.options import Option, Seconds, from_text
from gridtrack.evaluation.engines.slurm_cluster import SLURM_OPTION, SlurmSettings, parse_slurm
from gridtrack.evaluation.hosting.limits import Limits
from gridtrack.evaluation.scores.robot import SMALL_ROBOT, Robot, parse_robot
from gridtrack.recordings.degradation import Degradation, parse_degradation
from gridtrack.recordings.read_options import PoseSource

EngineName = Literal["local", "ray", "slurm"]
"""Where trials run: in threads of this process, or on the nodes of a Ray or a Slurm cluster."""


class CompareSettings(Settings):
    """A requested comparison. Its fields are the options of `gridtrack compare` and the arguments of
    `gridtrack.compare`; durations may be text, such as 2.5s."""

    recordings: Annotated[tuple[str, ...], Option(metavar="RECORDING[@RANGE]", argument=True)] = Field(min_length=1)
    """For example demo.mcap@30s-90s, or s3://bucket/demo.mcap"""
    trackers: Annotated[tuple[str, ...], Option("tracker", "[LABEL=]NAME[:OPTIONS]")] = ()
    """Tracker, and its options as KEY=VALUE,...; repeat for several; default: every tracker"""
    no_floors: bool = False
    """Leave out the floors, which every tracker must beat, except floors named by --tracker"""
    out: Annotated[Path, Option(metavar="FOLDER")] = Path("runs/latest")
    """Folder of the run, or its URL"""
    validation: Annotated[str | None, Option(metavar="RECORDING[@RANGE]")] = None
    """Recording to choose thresholds on; default: the validation stretch of each recording"""
    reference: Annotated[str | None, Option(metavar="LABEL")] = None
    """Tracker that the others are compared with; default: persistence, else the first"""
    horizon_s: Seconds = Field(2.5, gt=0.0, le=60.0)
    """Longest horizon of a forecast"""
    every_s: Seconds | None = Field(None, gt=0.0, le=3600.0)
    """Time between scored forecasts; default: 1 s, or less so that a short recording has 30"""
    segment_s: Seconds | None = Field(None, ge=10.0, le=86_400.0)
    """Cut longer test stretches into segments of at most this length, each a trial of its own"""
    warm_up_s: Seconds = Field(60.0, ge=0.0, le=3600.0)
    """Time before each segment in which frames are delivered and not scored, at least; the first segment has 20
    frames"""
    grid: Annotated[str | None, Option(metavar="CELLSxMETRES[@X,Y]")] = None
    """Grid, such as 100x0.2; default: the grid of the recording"""
    rate_hz: float | None = Field(None, gt=0.0, le=1000.0)
    """Frames per second; default: the rate of the recording"""
    format: Annotated[str | None, Option(metavar="NAME")] = None
    """Recording format of another package, which is loaded only by this name"""
    ego_motion: Annotated[PoseSource, Option(metavar="SOURCE")] = "recorded"
    """Source of the poses: recorded; kiss-icp, from the scans alone; refined, from the scans with the recorded motion
    as a prior"""
    jobs: int | None = Field(None, ge=1)
    """Trials at the same time; default: one per processor core"""
    engine: EngineName = "local"
    """Where the trials run: on this machine, or on the nodes of a Ray or a Slurm cluster"""
    address: Annotated[str | None, Option(metavar="HOST:PORT")] = None
    """Address of the Ray cluster; default: the cluster that this machine belongs to"""
    slurm: Annotated[SlurmSettings | None, Option(metavar="KEY=VALUE,..."), from_text(parse_slurm)] = None
    """Resources of each Slurm job: partition, account, timeout_min, mem_gb; default: only --threads cores"""
    limits: Limits = Limits()
    seed: int = Field(0, ge=0, lt=2**31)
    """Seed of every tracker and of degraded input"""
    weights: Annotated[Path | None, Option(metavar="FOLDER")] = None
    """Folder of learned weights, or its URL, searched before your own and the shipped ones"""
    trackers_toml: Annotated[Path | None, Option(metavar="FILE")] = None
    """File that names trackers of other environments, and programs"""
    scores: Annotated[tuple[str, ...], Option("score", "NAME")] = ()
    """Score of another package, which is loaded only by this name; repeat for several"""
    headline: Annotated[str, Option(metavar="NAME")] = ""
    """Score that leads table, page and sentence, such as f1; default: contact_foresight where there are enough
    contacts, else f1"""
    robot: Annotated[Robot, Option(metavar="car|KEY=VALUE,..."), from_text(parse_robot)] = SMALL_ROBOT
    """Virtual robot of contact foresight: car, or its radius (metres) and highest speed (m/s); default: radius=0.3,
    speed=1"""
    resume: bool = False
    """Run only the trials that are missing in the run's folder"""
    allow_leak: bool = False
    """Also score a tracker on frames that it learned from: it is marked and not ranked"""
    latency: bool = False
    """After the scores, measure the time of each tracker alone on the machine"""
    deadline: bool = False
    """After the scores, measure the time of each tracker alone, and score under a deadline"""
    degrade: Annotated[Degradation | None, Option(metavar="KIND=VALUE,..."), from_text(parse_degradation)] = None
    """After the scores, score on degraded frames: beam-dropout, sector-dropout and frame-drop (probabilities),
    range-noise and pose-jitter (standard deviations, metres); one kind at a time, at a quarter, half and all of its
    value"""
    follow: bool = False
    """The recording, an MCAP file, is still being written: process it to its end"""
    idle_timeout_s: Seconds = Field(60.0, gt=0.0, le=86_400.0)
    """With --follow, the recording ends when nothing was written for this long"""


def check_together(settings: CompareSettings) -> None:
    """Raise ConfigurationError for settings that cannot be combined."""
    if settings.follow and settings.segment_s is not None:
        raise ConfigurationError("--segment cuts a finished recording: leave it out with --follow")
    if settings.follow and settings.ego_motion != "recorded":
        raise ConfigurationError("--ego-motion matches the scans of a finished recording: leave it out with --follow")
    _check_engine(settings)


def _check_engine(settings: CompareSettings) -> None:
    """Raise ConfigurationError for settings that the engine does not support."""
    engine = settings.engine
    if settings.address is not None and engine != "ray":
        raise ConfigurationError("--address is for a Ray cluster: leave it out, or choose --engine ray")
    if settings.slurm is not None and engine != "slurm":
        raise ConfigurationError(f"{SLURM_OPTION} is for a Slurm cluster: leave it out, or choose --engine slurm")
    if engine == "local":
        return
    for name in ("latency", "deadline"):
        if getattr(settings, name):
            raise ConfigurationError(
                f"--{name} times each tracker alone on a machine, which --engine {engine} cannot guarantee: leave it"
                f" out, then measure on one machine with --engine local --resume --{name}"
            )
    if settings.follow:
        raise ConfigurationError(f"--follow runs on this machine: leave --engine {engine} out")
    if settings.jobs is not None:
        raise ConfigurationError(
            f"--jobs is for --engine local: with --engine {engine} as many trials run as the cluster has room for"
        )
