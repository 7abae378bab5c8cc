"""A job of Slurm: it carries out one attempt, and ends it early where Slurm asks for that."""

from __future__ import annotations

import signal
from collections.abc import Callable


def in_a_job(carry_out: Callable[[str], None], folder: str) -> None:
    """Carry out the attempt in `folder`, which SIGTERM interrupts: Slurm sends it before it ends a job.

    submitit would ignore it.
    """
    signal.signal(signal.SIGTERM, _interrupt)
    carry_out(folder)


def _interrupt(*_: object) -> None:
    """Interrupt once: Slurm repeats its signal, and the reply is being written then."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    raise KeyboardInterrupt
