"""Speed of the recurrent networks: one update and one forecast step on one thread, and training frames a second."""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable

import numpy as np
import torch

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec
from gridtrack.trackers.contract import StreamSpec
from gridtrack.trackers.recurrent import DeepTrackingRNNTracker, DilatedConvGRUTracker
from gridtrack.trackers.recurrent.tracker import RecurrentTracker

SIZE, STEPS = 100, 20


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


def inference(kind: type[RecurrentTracker]) -> None:
    torch.set_num_threads(1)
    network = kind.build(SIZE, kind.Options(), 0).eval()
    kind.prepare_inference(network)
    tracker = kind(StreamSpec(GridSpec(SIZE), 0.125), kind.Options(), network)
    frame = busy_frame(0)
    update, forecast = median_ms(lambda: tracker.update(frame)), median_ms(lambda: tracker.predict(STEPS), runs=5)
    print(f"{kind.name}: update {update:.1f} ms, forecast step {forecast / STEPS:.1f} ms (one thread, float32)")


def training(kind: type[RecurrentTracker], threads: int) -> None:
    from gridtrack.trackers.recurrent.training import sequence_loss

    torch.set_num_threads(threads)
    options = kind.Options()
    network = kind.build(SIZE, options, 0).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    kind.prepare_training(network, 0.02)
    frames = [busy_frame(t) for t in range(options.length)]
    window = torch.from_numpy(np.stack([np.stack([f.visible, f.occupied]) for f in frames]).astype(np.float32))
    windows = window.expand(options.batch, -1, -1, -1, -1)

    def one_update() -> None:
        with torch.autocast("cpu", torch.bfloat16):
            sequence_loss(network, windows, options).backward()  # type: ignore[no-untyped-call]

    seconds = median_ms(one_update, runs=3) / 1e3
    print(f"{kind.name}: {options.batch * options.length / seconds:.0f} training frames/s ({threads} threads, bf16)")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--threads", type=int, default=torch.get_num_threads())
    threads = parser.parse_args().threads
    for kind in (DilatedConvGRUTracker, DeepTrackingRNNTracker):
        inference(kind)
        training(kind, threads)
