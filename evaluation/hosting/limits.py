"""The limits of a trial. Light to import: the command line reads its defaults."""

from __future__ import annotations

from pydantic import Field

from gridtrack.common.config import Settings

SCRATCH = ".engine"
"""The folder of an engine, in the folder of its run, which the sandbox hides; on a cluster each log is below it."""


class Limits(Settings):
    """Limits of a trial: seconds for each kind of call, resident memory of all its processes, threads, a sandbox."""

    start_s: float = Field(600.0, gt=0)
    """A tracker may compile at its first start on a machine, for a minute, or several minutes on a busy one."""
    update_s: float = Field(5.0, gt=0)
    predict_s: float = Field(30.0, gt=0)
    memory_mb: int = Field(4096, gt=0)
    threads: int = Field(1, gt=0)
    sandbox: bool = False
    """Whether the tracker sees only its own code and weights, and no network: docs/wire.md, "Isolation"."""
