"""Speed of training the recurrent networks, frames a second. How fast they follow a stream: inference.py."""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable

import numpy as np
import torch

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame
from gridtrack.trackers.recurrent import DeepTrackingRNNTracker, DilatedConvGRUTracker
from gridtrack.trackers.recurrent.tracker import RecurrentTracker

SIZE = 100


def median_ms(call: Callable[[], object], runs: int = 20) -> float:
    call()
    times = []
    for _ in range(runs):
        start = time.perf_counter()
        call()
        times.append(1e3 * (time.perf_counter() - start))
    return statistics.median(times)


def busy_frame(seed: int) -> GridFrame:
    rng = np.random.default_rng(seed)
    visible = rng.random((SIZE, SIZE)) < 0.5
    occupied = visible & (rng.random((SIZE, SIZE)) < 0.02)
    nothing = np.zeros((0, 2), np.float32)
    return GridFrame(0, visible, occupied, SE2(), nothing, nothing, np.zeros(0, np.uint8))


def training(kind: type[RecurrentTracker], threads: int) -> None:
    from gridtrack.trackers.recurrent.training import sequence_loss

    torch.set_num_threads(threads)
    options = kind.Options()
    network = kind.build(SIZE, options, 0).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    on_processor = kind.prepare_training(network, 0.02)
    frames = [busy_frame(t) for t in range(options.length)]
    window = torch.from_numpy(np.stack([np.stack([f.visible, f.occupied]) for f in frames]).astype(np.float32))
    windows = window.expand(options.batch, -1, -1, -1, -1)

    def one_update() -> None:
        with torch.autocast("cpu", torch.bfloat16):
            sequence_loss(on_processor, windows, options).backward()  # type: ignore[no-untyped-call]

    seconds = median_ms(one_update, runs=3) / 1e3
    print(f"{kind.name}: {options.batch * options.length / seconds:.0f} training frames/s ({threads} threads, bf16)")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--threads", type=int, default=torch.get_num_threads())
    threads = parser.parse_args().threads
    for kind in (DilatedConvGRUTracker, DeepTrackingRNNTracker):
        training(kind, threads)
