"""Cost of the learned peers beside the dilated ConvGRU: size, inference and training on one thread.

`python -m benchmarks.peers [--out FILE]` (three minutes). The processor time is measured: other work on the machine
affects the caches only.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from torch.utils.flop_counter import FlopCounterMode

from gridtrack.common.config import validated
from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec
from gridtrack.trackers.contract import StreamSpec
from gridtrack.trackers.recurrent.motion import moving_shapes
from gridtrack.trackers.recurrent.training_module import sequence_loss
from gridtrack.trackers.registry import load

from studies.support.results_file import measured_table, study_parser, write_table

SIZE, BATCH, STEPS, RUNS, LONG_S = 64, 8, 20, 3, 5.0
WINDOW = {"observed_frames": 10, "blank_frames": 10, "repetitions": 1}
ROWS: Sequence[tuple[str, dict[str, Any]]] = (
    ("dilated-convgru", {"static_gates": ()}),
    ("conv-lstm", {}),
    ("simvp", {}),
    ("sogmp", {}),
    ("sogmp", {"channels": 16, "hidden": 32, "samples": 2}),
)
COLUMNS = (
    "tracker", "parameters", "GMAC a window", "update, ms", f"forecast of {STEPS} steps, ms", "training update, s",
)  # fmt: skip


def least_s(run: Callable[[], Any]) -> float:
    """Least processor time of RUNS runs, or of one that is longer than LONG_S."""
    times: list[float] = []
    while len(times) < RUNS and max(times, default=0.0) < LONG_S:
        began = time.process_time()
        run()
        times.append(time.process_time() - began)
    return min(times)


def frames(windows: torch.Tensor) -> list[GridFrame]:
    """The frames of the first of `windows`, at 10 Hz."""
    nothing = np.zeros((0, 2), np.float32)
    return [
        GridFrame(t * 10**8, visible, occupied, SE2(0.0, 0.0), nothing, nothing, np.zeros(0, np.uint8))
        for t, (visible, occupied) in enumerate(windows[0].bool().numpy())
    ]


def cost_of(name: str, given: dict[str, Any]) -> list[str]:
    """A row of the table."""
    kind: Any = load(name)
    options = validated(kind.Options, WINDOW | given, name)
    network = kind.build(SIZE, options, 0).to(memory_format=torch.channels_last)
    draws = [moving_shapes(np.random.default_rng(k), options.length, SIZE) for k in range(BATCH)]
    windows = torch.from_numpy(np.stack(draws)).float()
    with FlopCounterMode(display=False) as counter, torch.no_grad():
        network.requires_grad_(requires_grad=False).forecast_windows(windows[:1], options)
    in_training = kind.prepare_training(network.requires_grad_(), "cpu")

    def train() -> None:
        sequence_loss(in_training, windows, options, 0.02).mean.backward()  # type: ignore[no-untyped-call]

    train_s = least_s(train)

    stream = StreamSpec(GridSpec(SIZE, 0.2), 0.1)
    tracker = kind(stream, options, kind.inference_for(network, stream, options))

    def follow() -> None:
        tracker.reset(0)
        for frame in frames(windows):
            tracker.update(frame)

    update_ms = 1e3 * least_s(follow) / options.length
    predict_ms = 1e3 * least_s(lambda: tracker.predict(STEPS))
    label = ", ".join([name, *(f"{key}={value}" for key, value in given.items() if key != "static_gates")])
    size = sum(parameter.numel() for parameter in network.parameters())
    macs = counter.get_total_flops() / 2e9
    return [label, f"{size:,}", f"{macs:.1f}", f"{update_ms:.2f}", f"{predict_ms:,.0f}", f"{train_s:.1f}"]


def main(arguments: Sequence[str] | None = None) -> None:
    given = study_parser(__doc__, "docs/results/trackers/peers.json").parse_args(arguments)
    torch.set_num_threads(1)
    rows = []
    for name, options in ROWS:
        rows.append(cost_of(name, options))
        print("  ".join(rows[-1]), flush=True)
    write_table(given.out, "cost", measured_table(COLUMNS, rows), "python -m benchmarks.peers", {})


if __name__ == "__main__":
    main()
