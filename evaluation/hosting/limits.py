"""The limits of a trial: time of each call, memory, threads. Light to import: they are options of the command line."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from gridtrack.common.config import Settings
from gridtrack.common.options import Option, Seconds

SCRATCH = ".engine"
"""The folder of an engine, in the folder of its run, which the sandbox hides; on a cluster each log is below it."""


class Limits(Settings):
    """Limits of a trial: seconds for each kind of call, resident memory of all its processes, threads, a sandbox."""

    threads: int = Field(1, gt=0)
    """Compute threads of each tracker"""
    memory_mb: int = Field(4096, gt=0)
    """Memory limit of each tracker"""
    start_s: Annotated[Seconds, Option("start-timeout")] = Field(600.0, gt=0)
    """Time limit for the start of a tracker, which may compile at its first start on a machine"""
    update_s: Annotated[Seconds, Option("update-timeout")] = Field(5.0, gt=0)
    """Time limit for each frame"""
    predict_s: Annotated[Seconds, Option("predict-timeout")] = Field(30.0, gt=0)
    """Time limit for each forecast"""
    sandbox: bool = False
    """Trackers see their own code and weights only: no network, no file, no process (bubblewrap; docs/wire.md)"""
