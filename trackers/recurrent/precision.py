"""The precision of a training: the faster one on this machine, unless one is chosen.

bfloat16 is faster on accelerators and on most processors with instructions for it (AVX-512 BF16, AMX), slower on
others; what the processor has does not say which, so that one small convolution is timed.
"""

from __future__ import annotations

import json
import math
import time
from contextlib import suppress
from typing import get_args

import torch
from torch import nn

from gridtrack.trackers.contract import FitTask
from gridtrack.trackers.recurrent.devices import training_device
from gridtrack.trackers.recurrent.settings import Precision, TrainingSettings

ROUNDS, TURNS = 5, 8
"""Convolutions of one precision in a turn, and turns of each: they alternate, because what else runs on the machine
could slow one of them alone."""
BATCH, SIZE, INPUTS, OUTPUTS = 2, 100, 16, 48
"""The convolution of the states of a layer of the dilated ConvGRU, with a batch of two grids of 100 cells a side."""


def training_precision(settings: TrainingSettings, task: FitTask) -> Precision:
    """The precision of `settings`; for `auto` that of the training that `task.log_dir` resumes, or the faster one."""
    if settings.precision != "auto":
        return settings.precision
    if (resumed := _precision_in(task)) is not None:
        return resumed
    if settings.devices > 1 and training_device() != "cpu":
        return "bf16-mixed"  # a device that this process used to measure could not be used by those that it forks
    took_ms = dict.fromkeys(get_args(Precision), math.inf)
    for _ in range(TURNS):
        took_ms = {precision: min(ms, convolution_ms(precision)) for precision, ms in took_ms.items()}
    fastest: Precision = min(took_ms, key=lambda precision: took_ms[precision])
    times = ", ".join(f"{precision} {ms:.1f} ms" for precision, ms in took_ms.items())
    task.report(f"precision {fastest}: a convolution and its gradient take {times} on this machine")
    return fastest


def _precision_in(task: FitTask) -> Precision | None:
    """The precision of the training that has its checkpoints in the log folder; None without one."""
    with suppress(OSError, ValueError, KeyError, TypeError):
        recorded = json.loads((task.log_dir / "settings.json").read_text())["precision"]
        return next((precision for precision in get_args(Precision) if precision == recorded), None)
    return None


def convolution_ms(precision: Precision) -> float:
    """Least time of a small convolution with its gradient where the training runs, milliseconds."""
    device = training_device()
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
