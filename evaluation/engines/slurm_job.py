"""A job of Slurm: it carries out attempts one after another, its own first, and ends early where Slurm asks for that.

To start a job and import libraries takes longer than a short trial. While a job is young it therefore takes further
attempts of its array, from the end, where they would wait longest. Which job has an attempt is the target of a symbolic
link in its folder: a link is made whole or not at all, by one job only.
"""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from gridtrack.common.files import write_text

YOUNG_S = 60.0
"""Age until which a job takes a further attempt: long beside its start, short beside what people wait for a node."""
TAKEN = "taken"


class Taken(NamedTuple):
    """Which job has taken an attempt, by its id in Slurm, and how many it had taken before."""

    job_id: str
    before: int


def write_array(path: Path, folders: Sequence[Path]) -> None:
    """Write the folders of the attempts of an array, of which each job is one. Raises OSError."""
    write_text(path, json.dumps([str(folder) for folder in folders]))


def taken(folder: Path) -> Taken | None:
    """Which job has the attempt in `folder`; None where it waits, or where its folder is gone."""
    try:
        job_id, _, before = str((folder / TAKEN).readlink()).rpartition(" ")
    except FileNotFoundError:
        return None
    return Taken(job_id, int(before))


def in_a_job(carry_out: Callable[[str], bool], array: str, number: int) -> None:
    """Carry out the attempt `number` of an `array`, where no other job has taken it, and then further ones.

    `carry_out` returns whether nothing interrupted the attempt. SIGTERM interrupts it, which submitit would ignore:
    Slurm sends it before it ends a job.
    """
    young_until = time.monotonic() + YOUNG_S
    signal.signal(signal.SIGTERM, _interrupt)
    folders = [Path(name) for name in json.loads(Path(array).read_text("utf-8"))]
    count = 0
    for folder in (folders[number], *reversed(folders)):
        if _take(folder, count):
            count += 1
            if not carry_out(str(folder)) or time.monotonic() > young_until:
                return
        elif count == 0:
            return


def _take(folder: Path, before: int) -> bool:
    """Take the attempt in `folder`; whether it was there and no job had it."""
    # FileNotFoundError: the host has taken the reply already, or has given the attempt up
    with suppress(FileExistsError, FileNotFoundError):
        (folder / TAKEN).symlink_to(f"{_job_id()} {before}")
        return True
    return False


def _job_id() -> str:
    """The id of this job, as squeue and submitit write it."""
    array = os.environ.get("SLURM_ARRAY_JOB_ID")
    return f"{array}_{os.environ['SLURM_ARRAY_TASK_ID']}" if array else os.environ["SLURM_JOB_ID"]


def _interrupt(*_: object) -> None:
    """Interrupt once: Slurm repeats its signal, and the reply is being written then."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    raise KeyboardInterrupt
