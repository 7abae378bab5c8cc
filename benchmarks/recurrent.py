"""Speed of training the recurrent networks on a processor: our variants beside PyTorch and `torch.compile`.

`python -m benchmarks.recurrent [--peers] [--out FILE]` (two minutes; with the peers ten). Speed of inference:
`benchmarks/inference.py`.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any, get_args

import numpy as np
import torch

from gridtrack.trackers.recurrent.convgru_tracker import DilatedConvGRUTracker
from gridtrack.trackers.recurrent.deep_tracking_rnn import DeepTrackingRNNTracker
from gridtrack.trackers.recurrent.settings import Precision

from benchmarks.inference import compiled, observed
from studies.support.results_file import measured_table, study_parser, write_table

SIZE = 100
TRACKERS = {"dilated-convgru": DilatedConvGRUTracker, "deep-tracking-rnn": DeepTrackingRNNTracker}


def networks(kind: Any, *, peers: bool) -> dict[str, Any]:
    """Ours, and with `peers` the plain network and the compiled one."""
    network = kind.build(SIZE, kind.Options(), 0).to(memory_format=torch.channels_last)
    ours = {"ours": kind.prepare_training(network, "cpu")}
    return ours | {"PyTorch": network, "torch.compile": compiled(network)} if peers else ours


def training_rates(
    found: Mapping[str, Any], options: Any, precision: Precision, threads: int, runs: int = 4
) -> dict[str, float]:
    """Frames of training a second of each network; they alternate, and the fastest run counts."""
    from gridtrack.trackers.recurrent.training_module import sequence_loss

    torch.set_num_threads(threads)
    window = torch.cat([observed(t) for t in range(options.length)])
    windows = window.expand(options.batch, -1, -1, -1, -1)
    least_s = dict.fromkeys(found, np.inf)
    for run, (name, network) in product(range(runs), found.items()):
        began = time.perf_counter()
        with torch.autocast("cpu", torch.bfloat16, enabled=precision == "bf16-mixed"):
            sequence_loss(network, windows, options, 0.02).mean.backward()  # type: ignore[no-untyped-call]
        if run:
            least_s[name] = min(least_s[name], time.perf_counter() - began)
    return {name: options.batch * options.length / least for name, least in least_s.items()}


def main(arguments: Sequence[str] | None = None) -> None:
    parser = study_parser(__doc__)
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--peers", action="store_true", help="time PyTorch and torch.compile too")
    parser.add_argument("--out", type=Path, help="results file, such as docs/results/trackers/recurrent.json")
    given = parser.parse_args(arguments)
    cases = list(product(get_args(Precision), given.threads))
    rows, values = [], {}
    for label, kind in TRACKERS.items():
        found, rates = networks(kind, peers=given.peers), []
        for precision, threads in cases:
            for name, rate in training_rates(found, kind.Options(), precision, threads).items():
                print(f"{label}, {name}: {rate:.0f} frames/s ({threads} threads, {precision})", flush=True)
                rates += [rate] if name == "ours" else []
        rows.append([label, *(f"{rate / rates[0]:.2f}" for rate in rates)])
        values[f"{label}, frames a second"] = f"{rates[0]:.0f}"
    columns = [f"{precision}, {threads} thread{'s' if threads > 1 else ''}" for precision, threads in cases]
    table = measured_table(("frames a second, times the first", *columns), rows)
    write_table(given.out, "training speed", table, "python -m benchmarks.recurrent", values)


if __name__ == "__main__":
    main()
