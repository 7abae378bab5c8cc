"""The devices that a network is trained on: of the fastest kind of a machine, one or, by Lightning's DDP, several.

Several devices share each batch; each has a process of its own, which is forked from that of the training.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from multiprocessing import Pipe, active_children
from multiprocessing.connection import Connection
from threading import Thread

import torch

from gridtrack.common.errors import ConfigurationError

AT_THE_END_S = 10.0
"""Time for the last lines of a device that was ended in the middle of one."""
ONE_DEVICE, SEVERAL_DEVICES = "auto", "ddp_fork"
"""Lightning's strategies. A process of `ddp` begins with the command line anew, and that of a training gets its data on
standard input; one of `ddp_spawn` gets no function that scores on the validation stretch."""
os.environ.setdefault("PYTORCH_NVML_BASED_CUDA_CHECK", "1")  # to ask for a CUDA device is not to use it: see CUDA, fork


def training_device() -> str:
    """The kind of device that a training runs on: "cuda" or another accelerator, where there is one, else "cpu"."""
    accelerator = torch.accelerator.current_accelerator(check_available=True)
    return "cpu" if accelerator is None else accelerator.type


def check_devices(devices: int, batch: int) -> None:
    """Raise ConfigurationError where there are not so many `devices`, or where they cannot share a `batch`."""
    if batch % devices:
        raise ConfigurationError(
            f"devices={devices} cannot share batch={batch} equally: choose a multiple of {devices}"
        )
    kind = training_device()
    found = len(os.sched_getaffinity(0)) if kind == "cpu" else torch.accelerator.device_count()
    if devices > found:
        raise ConfigurationError(f"devices={devices}: this machine has {found} of kind {kind}")


def drawing_processes(devices: int) -> int:
    """Processes that draw the windows of one device: none where a processor trains, which they would hold up."""
    return 0 if training_device() == "cpu" else max(1, len(os.sched_getaffinity(0)) // devices - 1)


@contextmanager
def called_here(devices: int, *functions: Callable[[str], None]) -> Iterator[tuple[Callable[[str], None], ...]]:
    """The `functions` of a text as ones that the process of the first device calls: they run in this process.

    So a line of progress is not written by two processes at once, and a count is one for both.
    """
    if devices == 1:
        yield functions
        return
    receiver, sender = Pipe(duplex=False)

    def receive() -> None:
        for number, text in iter(receiver.recv, None):
            functions[number](text)

    thread = Thread(target=receive, name="calls of a device", daemon=True)
    thread.start()
    try:
        yield tuple(partial(_call, sender, number) for number in range(len(functions)))
    finally:
        sender.send(None)
        thread.join(AT_THE_END_S)


def _call(sender: Connection, number: int, text: str) -> None:
    sender.send((number, text))


def end_devices(devices: int) -> None:
    """End the processes of several devices, which Lightning leaves at work when that of the training is interrupted."""
    for process in active_children() if devices > 1 else ():
        process.kill()
        process.join()


def begin_on_device(devices: int) -> None:
    """Called in the process of one of several devices, before its first update.

    A processor that trains is a device of one thread: OpenMP's threads do not survive a fork.
    """
    if devices > 1 and training_device() == "cpu":
        torch.set_num_threads(1)
