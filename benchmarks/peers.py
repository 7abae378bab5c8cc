"""Cost of the learned trackers: size, inference and training on one thread, and what their general weights had.

`python -m benchmarks.peers [--out FILE]` (five minutes). The processor time is measured: other work on the machine
affects the caches only. The minutes of a training are its updates times the time of one here, wherever it ran.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
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
from gridtrack.trackers.training.card import Card
from gridtrack.trackers.training.weights import read_card

from studies.support.results_file import measured_table, study_parser, write_table
from studies.support.shipped import WEIGHTS

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
TRAININGS = Path("studies/trainings")
TRAINED = ("deep-tracking-rnn", "dilated-convgru", "conv-lstm", "simvp", "sogmp")
MEASURED = 4
"""Windows of a measured update: those of larger batches are in proportion."""
TRAINED_COLUMNS = ("weights", "updates", "windows an update", "thousands of frames", "minutes of a core")


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


def drawn(count: int, length: int) -> torch.Tensor:
    """Windows (count, length, 2, SIZE, SIZE) of moving shapes."""
    draws = [moving_shapes(np.random.default_rng(k), length, SIZE) for k in range(count)]
    return torch.from_numpy(np.stack(draws)).float()


def update_s(kind: Any, network: Any, options: Any, windows: torch.Tensor) -> float:
    """The time of one training update."""
    in_training = kind.prepare_training(network.requires_grad_(), "cpu")

    def train() -> None:
        sequence_loss(in_training, windows, options, 0.02).mean.backward()  # type: ignore[no-untyped-call]

    return least_s(train)


def cost_of(name: str, given: dict[str, Any]) -> list[str]:
    """A row of the table of costs."""
    kind: Any = load(name)
    options = validated(kind.Options, WINDOW | given, name)
    network = kind.build(SIZE, options, 0).to(memory_format=torch.channels_last)
    windows = drawn(BATCH, options.length)
    with FlopCounterMode(display=False) as counter, torch.no_grad():
        network.requires_grad_(requires_grad=False).forecast_windows(windows[:1], options)
    train_s = update_s(kind, network, options, windows)

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


def general_cards() -> Iterator[tuple[str, Card]]:
    """The shipped general weights of the networks and those of an equal budget, each after those it started from."""
    for label, folder in (("", WEIGHTS), (", equal budget", TRAININGS / "equal-budget")):
        for path in (folder / name / "general.toml" for name in TRAINED):
            if not path.exists():
                continue
            card = read_card(path)
            if card.started_from:
                yield (
                    f"{card.tracker}, first stage",
                    read_card(TRAININGS / "batches-of-32" / f"seed-{card.seed}" / card.started_from.name),
                )
            yield f"{card.tracker}{label}", card


def training_of(label: str, card: Card) -> list[str]:
    """A row of the table of trainings."""
    kind: Any = load(card.tracker)
    known = {name: value for name, value in card.settings.items() if name in kind.Options.model_fields}
    options = validated(kind.Options, known | {"precision": "32-true"}, label)
    windows = min(MEASURED, options.batch)
    measured_s = update_s(kind, kind.build(SIZE, options, 0), options, drawn(windows, options.length))
    minutes = options.updates * measured_s * options.batch / windows / 60
    frames_k = options.updates * options.batch * options.length / 1000
    return [label, f"{options.updates:,}", str(options.batch), f"{frames_k:,.0f}", f"{minutes:,.0f}"]


def main(arguments: Sequence[str] | None = None) -> None:
    given = study_parser(__doc__, "docs/results/trackers/peers.json").parse_args(arguments)
    torch.set_num_threads(1)
    rows = []
    for name, options in ROWS:
        rows.append(cost_of(name, options))
        print("  ".join(rows[-1]), flush=True)
    trained = [training_of(label, card) for label, card in general_cards()]
    tables = {"cost": measured_table(COLUMNS, rows), "training": measured_table(TRAINED_COLUMNS, trained)}
    print(tables["training"].markdown())
    for name, table in tables.items():
        write_table(given.out, name, table, "python -m benchmarks.peers", {})


if __name__ == "__main__":
    main()
