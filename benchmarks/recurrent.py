"""Speed of training the recurrent networks, frames a second.

`python -m benchmarks.recurrent` (one minute). How fast they follow a stream: `benchmarks/inference.py`.
"""

from __future__ import annotations

import argparse
from typing import Any, get_args

import numpy as np
import torch

from gridtrack.trackers.recurrent.convgru_tracker import DilatedConvGRUTracker
from gridtrack.trackers.recurrent.recurrent_tracker import RecurrentTracker
from gridtrack.trackers.recurrent.rnn_tracker import DeepTrackingRNNTracker
from gridtrack.trackers.recurrent.settings import Precision

from benchmarks.timing import median_ms

SIZE = 100


def random_planes(seed: int) -> np.ndarray:
    """A frame's planes (2, M, M): half of the cells visible, one in fifty of these occupied."""
    rng = np.random.default_rng(seed)
    visible = rng.random((SIZE, SIZE)) < 0.5
    occupied = visible & (rng.random((SIZE, SIZE)) < 0.02)
    return np.stack([visible, occupied]).astype(np.float32)


def print_training_rate(kind: type[RecurrentTracker], precision: Precision, threads: int) -> None:
    from gridtrack.trackers.recurrent.training import sequence_loss

    torch.set_num_threads(threads)
    options: Any = kind.Options()
    network = kind.build(SIZE, options, 0).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    on_processor = kind.prepare_training(network, 0.02)
    window = torch.from_numpy(np.stack([random_planes(t) for t in range(options.length)]))
    windows = window.expand(options.batch, -1, -1, -1, -1)

    def one_update() -> None:
        with torch.autocast("cpu", torch.bfloat16, enabled=precision == "bf16-mixed"):
            sequence_loss(on_processor, windows, options).backward()  # type: ignore[no-untyped-call]

    seconds = median_ms(one_update, runs=3) / 1e3
    rate = options.batch * options.length / seconds
    print(f"{kind.name}: {rate:.0f} training frames/s ({threads} threads, {precision})")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--threads", type=int, default=torch.get_num_threads())
    threads = parser.parse_args().threads
    for kind in (DilatedConvGRUTracker, DeepTrackingRNNTracker):
        for precision in get_args(Precision):
            print_training_rate(kind, precision, threads)


if __name__ == "__main__":
    main()
