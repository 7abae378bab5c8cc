"""The devices of a training: their kind and number, and the faster precision on them.

Several devices share each batch by Lightning's DDP; each has its own process, forked from the training process.
"""

from __future__ import annotations

import json
import math
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from multiprocessing import Pipe, active_children
from multiprocessing.connection import Connection
from threading import Thread
from typing import Any, NamedTuple, Self, get_args

import torch
from torch import nn

from gridtrack.common.errors import ConfigurationError
from gridtrack.trackers.contract import FitTask
from gridtrack.trackers.recurrent.settings import Precision, TrainingSettings
from gridtrack.trackers.training.checkpoints import TRAINING_FILE, training_device
from gridtrack.trackers.training.device import device_count

AT_THE_END_S = 10.0
"""Time limit for the last lines of a device process that was killed."""
TRIES, ROUNDS = 8, 5
"""Tries of each precision, which alternate because other work on the machine could slow one of them alone; convolutions
in one try."""
CLEARLY_SLOWER = 3.0
"""A precision that took more than this many times the time of the fastest one is not tried again."""
BATCH, SIZE, INPUTS, OUTPUTS = 2, 100, 16, 48
"""The convolution of the states of a layer of the dilated ConvGRU, with a batch of two grids of 100 cells a side."""


class Devices(NamedTuple):
    """`number` devices of one `kind`: "cpu", "cuda" or another accelerator."""

    kind: str
    number: int

    @classmethod
    def of(cls, kind: str, number: int, batch: int) -> Self:
        """Devices of this machine that share each `batch`; the kind `auto` is an accelerator if there is one.

        Raises ConfigurationError if there are too few, or if they cannot share the batch equally.
        """
        if batch % number:
            raise ConfigurationError(
                f"devices={number} cannot share batch={batch} equally: choose a multiple of {number}"
            )
        kind = training_device(kind).type
        if number > (found := device_count(kind)):
            raise ConfigurationError(f"devices={number}: this machine has {found} of kind {kind}")
        return cls(kind, number)

    @property
    def lightning(self) -> dict[str, Any]:
        """The options of Lightning's Trainer.

        A process of `ddp` would run the command line again, but a training process reads its data from standard input;
        a process of `ddp_spawn` could not call the function that scores on the validation stretch.
        """
        return {
            "accelerator": "cpu" if self.kind == "cpu" else "auto",
            "devices": self.number,
            "strategy": "auto" if self.number == 1 else "ddp_fork",
        }

    @property
    def loading_processes(self) -> int:
        """Processes that draw the windows of one device: none if a processor trains, which they would slow down."""
        return 0 if self.kind == "cpu" else max(1, len(os.sched_getaffinity(0)) // self.number - 1)

    def start_process(self) -> None:
        """Called in the process of a device before its first update: OpenMP's threads do not survive a fork."""
        if self.number > 1 and self.kind == "cpu":
            torch.set_num_threads(1)

    def end_processes(self) -> None:
        """End the processes of several devices, which Lightning leaves running after an interrupt."""
        for process in active_children() if self.number > 1 else ():
            process.kill()
            process.join()

    @contextmanager
    def called_here(self, *functions: Callable[[str], None]) -> Iterator[tuple[Callable[[str], None], ...]]:
        """Functions of a text that call the given `functions` in this process, also from the process of a device."""
        if self.number == 1:
            yield functions
            return
        receiver, sender = Pipe(duplex=False)

        def receive() -> None:
            for number, text in iter(receiver.recv, None):
                functions[number](text)

        thread = Thread(target=receive, name="calls of a device", daemon=True)
        thread.start()
        try:
            yield tuple(partial(_send, sender, number) for number in range(len(functions)))
        finally:
            sender.send(None)
            thread.join(AT_THE_END_S)


def _send(sender: Connection, number: int, text: str) -> None:
    sender.send((number, text))


def training_precision(settings: TrainingSettings, devices: Devices, task: FitTask) -> Precision:
    """The precision of `settings`; for `auto` the precision of the training that is resumed, or the faster one.

    bfloat16 is faster on accelerators and on most processors with instructions for it (AVX-512 BF16, AMX), slower on
    others. The instructions of a processor do not say which, so that one small convolution is timed.
    """
    if settings.precision != "auto":
        return settings.precision
    if (resumed := _precision_in(task)) is not None:
        return resumed
    if devices.number > 1 and devices.kind != "cpu":
        return "bf16-mixed"  # forked processes cannot use a device on which this process measures
    took_ms = dict.fromkeys(get_args(Precision), math.inf)
    for _ in range(TRIES):
        tried = [precision for precision, ms in took_ms.items() if ms <= CLEARLY_SLOWER * min(took_ms.values())]
        took_ms |= {precision: min(took_ms[precision], convolution_ms(precision, devices.kind)) for precision in tried}
    fastest: Precision = min(took_ms, key=lambda precision: took_ms[precision])
    times = ", ".join(f"{precision} {ms:.1f} ms" for precision, ms in took_ms.items())
    task.report(f"precision {fastest}: a convolution and its gradient take {times} on this machine")
    return fastest


def _precision_in(task: FitTask) -> Precision | None:
    """The precision of the training in the log folder; None without one."""
    with suppress(OSError, ValueError, KeyError, TypeError):
        recorded = json.loads((task.log_dir / TRAINING_FILE).read_text())["precision"]
        return next((precision for precision in get_args(Precision) if precision == recorded), None)
    return None


def convolution_ms(precision: Precision, device: str) -> float:
    """Least time of a small convolution with its gradient on a kind of `device`, milliseconds."""
    convolution = nn.Conv2d(INPUTS, OUTPUTS, 3, padding=1, device=device)
    planes = torch.ones(BATCH, INPUTS, SIZE, SIZE, device=device, requires_grad=True)
    planes = planes.contiguous(memory_format=torch.channels_last)
    least = float("inf")
    for _ in range(ROUNDS):
        started = time.perf_counter()
        with torch.autocast(device, torch.bfloat16, enabled=precision == "bf16-mixed"):
            total = convolution(planes).float().sum()
        total.backward()
        if device != "cpu":
            torch.accelerator.synchronize()
        least = min(least, time.perf_counter() - started)
    return 1e3 * least
