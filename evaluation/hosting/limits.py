"""The limits of a trial: time of each call, memory, threads. Light to import: the command line reads its defaults."""

from __future__ import annotations

from pydantic import Field

from gridtrack.common.config import Settings


class Limits(Settings):
    """Limits of a trial: seconds for each kind of call, resident memory of all its processes, threads, a sandbox."""

    start_s: float = Field(600.0, gt=0)
    """A tracker may compile at its first start on a machine: a minute, several times that on slow or busy cores."""
    update_s: float = Field(5.0, gt=0)
    predict_s: float = Field(30.0, gt=0)
    memory_mb: int = Field(4096, gt=0)
    threads: int = Field(1, gt=0)
    sandbox: bool = False
    """Whether the tracker sees nothing but its own code and weights, without network: docs/wire.md, "Isolation"."""
