"""Speed of the recurrent networks on one thread: our variants beside PyTorch, `torch.compile` and ONNX Runtime.

`python -m benchmarks.inference [--peers] [--out FILE]` (two minutes; with `torch.compile` and ONNX Runtime five). ONNX
Runtime is in the extra `export`. All have the same weights; that their forecasts agree is asserted. They alternate, and
the thread's processor time is measured: other work on the machine affects the caches only. A variant that is not 1.15
times as fast as the fastest of the others is to go. Aim: 5 ms in float32.
"""

from __future__ import annotations

import functools
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from gridtrack.trackers.recurrent.convgru_tracker import DilatedConvGRUTracker
from gridtrack.trackers.recurrent.deep_tracking_rnn import DeepTrackingRNNTracker
from gridtrack.trackers.recurrent.kernels import convgru, rnn
from gridtrack.trackers.recurrent.network import Recurrence, State, as_tensor, channels_last

from studies.support.results_file import ResultSection, ResultTable, measured_table, study_parser, write_section

SIZE, STEPS = 100, 20
TOLERANCE = {"float32": 1e-4, "bfloat16": 0.05}
"""Largest difference of P(occupied) after some frames and a forecast, by precision."""


class Replaced:
    """A Recurrence with other functions for its step and its decoder."""

    def __init__(self, network: Recurrence, step: Callable[..., Any], occupancy: Callable[..., Any]) -> None:
        self.initial, self.features = network.initial, network.features
        self.step, self.occupancy = step, occupancy


def compiled(network: Any) -> Replaced:
    """By `torch.compile`."""
    return Replaced(network, torch.compile(network.step, dynamic=False), torch.compile(network.occupancy))


def in_bfloat16(network: Any) -> Replaced:
    """By PyTorch's automatic precision."""
    autocast = torch.autocast("cpu", torch.bfloat16)
    return Replaced(network, autocast(network.step), autocast(network.occupancy))


def onnx_runtime(network: Any) -> Replaced:
    """Exported to ONNX: a session each for a step with and without input and for the decoder, on one thread."""
    state = network.initial(1)
    with_input = _session(lambda x, *h: network.step(x, h), network, (observed(0), *state))
    without = _session(lambda *h: network.step(None, h), network, state)
    decode = _session(network.occupancy, network, (network.features(state),))

    def step(x: Tensor | None, state: State) -> State:
        return without(*state) if x is None else with_input(x, *state)

    return Replaced(network, step, lambda features: decode(features)[0])


def _session(function: Callable[..., Any], network: nn.Module, arguments: tuple[Tensor, ...]) -> Callable[..., Any]:
    import onnxruntime

    class Exported(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.network = network

        def forward(self, *given: Tensor) -> Any:
            return function(*given)

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    with tempfile.NamedTemporaryFile(suffix=".onnx") as file:
        plain = tuple(each.contiguous() for each in arguments)
        torch.onnx.export(Exported(), plain, file.name, dynamo=True, external_data=False, verbose=False)
        session = onnxruntime.InferenceSession(file.name, options, providers=["CPUExecutionProvider"])
    names = [each.name for each in session.get_inputs()]

    def run(*given: Tensor) -> tuple[Tensor, ...]:
        fed = dict(zip(names, (each.contiguous().numpy() for each in given), strict=True))
        return tuple(torch.from_numpy(found) for found in session.run(None, fed))

    return run


def contestants(network: Any, variants: Mapping[str, Callable[[Any], Any]], *, peers: bool) -> dict[str, Any]:
    """Ours in each precision, first, and the others."""
    found = {f"ours, {precision}": variant(network) for precision, variant in variants.items()}
    others = {"PyTorch, float32": network}
    if peers:
        others |= {"torch.compile, float32": compiled(network), "ONNX Runtime, float32": onnx_runtime(network)}
    if "bfloat16" in variants:
        others["PyTorch, bfloat16"] = in_bfloat16(network)
        others |= {"torch.compile, bfloat16": in_bfloat16(compiled(network))} if peers else {}
    return found | others


def forecast(network: Recurrence, state: State, steps: int) -> Tensor:
    """P(occupied) (steps + 1, M, M)."""
    decoded = [network.occupancy(network.features(state))]
    for _ in range(steps):
        state = network.step(None, state)
        decoded.append(network.occupancy(network.features(state)))
    return torch.sigmoid(torch.cat(decoded))


def trained_like(network: Any) -> Any:
    """`network` with weights of a trained one's size, which keep the state from fading."""
    torch.manual_seed(0)
    for parameter in network.parameters():
        nn.init.normal_(parameter, std=0.1)
    return channels_last(network.eval())


@functools.cache
def observed(seed: int) -> Tensor:
    """Planes (1, 2, M, M) of a frame in which half of the grid is visible."""
    rng = np.random.default_rng(seed)
    visible = rng.random((SIZE, SIZE)) < 0.5
    occupied = visible & (rng.random((SIZE, SIZE)) < 0.02)
    return as_tensor(np.stack([visible, occupied], axis=2).astype(np.float32))


def assert_agreement(found: dict[str, Any]) -> dict[str, State]:
    """The state of each after some frames; their forecasts agree."""
    states, forecasts = {}, {}
    for name, network in found.items():
        states[name] = network.initial(1)
        for seed in range(5):
            states[name] = network.step(observed(seed), states[name])
        forecasts[name] = forecast(network, states[name], STEPS)
    first = next(iter(forecasts.values()))
    for name, values in forecasts.items():
        difference = float((values - first).abs().max())
        print(f"  {name:24} P(occupied) within {difference:.1e} of ours")
        assert difference <= TOLERANCE[name.split(", ")[1]], name
    return states


def processor_times_ms(calls: Mapping[str, Callable[[], object]], rounds: int) -> dict[str, np.ndarray]:
    """Processor time of each call; they alternate, each after a call of its own that is not counted."""
    times: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(rounds):
        for name, call in calls.items():
            call()
            begun = time.thread_time_ns()
            call()
            times[name].append(1e-6 * (time.thread_time_ns() - begun))
    return {name: np.array(values) for name, values in times.items()}


FORECAST = f"forecast of {STEPS} steps"
CASES: dict[str, tuple[int, Callable[[Any, State], object]]] = {
    "update with input": (1, lambda network, state: network.step(observed(9), state)),
    "update without": (1, lambda network, state: network.step(None, state)),
    "forecast step, decoded": (1, lambda network, state: forecast(network, network.step(None, state), 0)),
    FORECAST: (STEPS, lambda network, state: forecast(network, state, STEPS)),
}
"""Number of steps of each case, and its call on a network and its state."""


def compared(found: dict[str, Any], rounds: int) -> dict[str, dict[str, float]]:
    """Median milliseconds of each case by implementation."""
    states = assert_agreement(found)
    medians_ms: dict[str, dict[str, float]] = {name: {} for name in found}
    for case, (steps, call) in CASES.items():
        calls = {name: lambda name=name, call=call: call(found[name], states[name]) for name in found}
        for name, times_ms in processor_times_ms(calls, max(3, rounds // steps)).items():
            medians_ms[name][case] = float(np.median(times_ms))
            print(f"  {case:22} {name:24} median {medians_ms[name][case]:7.2f} ms, least {times_ms.min():7.2f} ms")
    for precision in TOLERANCE:
        ms = {name: each[FORECAST] for name, each in medians_ms.items() if name.endswith(precision)}
        if (ours := ms.pop(f"ours, {precision}", None)) is not None:
            gain = min(ms.values()) / ours
            print(f"  {FORECAST}: {precision} is {gain:.2f} times as fast as the fastest of the others")
    return medians_ms


def table_of(name: str, medians_ms: dict[str, dict[str, float]]) -> ResultTable:
    """Ratios of the medians to the first implementation's, ours."""
    first, *_ = medians_ms.values()
    rows = [[label, *(f"{cases[case] / first[case]:.2f}" for case in CASES)] for label, cases in medians_ms.items()]
    return measured_table((f"{name}, times ours in float32", *CASES), rows)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = study_parser(__doc__)
    parser.add_argument("--rounds", type=int, default=40)
    parser.add_argument("--peers", action="store_true", help="time torch.compile and ONNX Runtime too")
    parser.add_argument("--out", type=Path, help="results file, such as docs/results/trackers/recurrent.json")
    given = parser.parse_args(arguments)
    torch.set_num_threads(1)
    tables: dict[str, ResultTable] = {}
    values: dict[str, str] = {}
    for name, kind, kernels in (
        ("dilated-convgru", DilatedConvGRUTracker, convgru),
        ("deep-tracking-rnn", DeepTrackingRNNTracker, rnn),
    ):
        print(name)
        with torch.inference_mode():
            network = trained_like(kind.build(SIZE, kind.Options(), 0))
            medians_ms = compared(contestants(network, kernels.INFERENCE, peers=given.peers), given.rounds)
        tables[name] = table_of(name, medians_ms)
        ours, *_ = medians_ms.values()
        values |= {f"{name}: {case}, ms": f"{ms:.1f}" for case, ms in ours.items()}
    if given.out:
        command = f"python -m benchmarks.inference{' --peers' if given.peers else ''} --rounds {given.rounds}"
        write_section(given.out, "speed", ResultSection(command=command, tables=tables, values=values))


if __name__ == "__main__":
    main()
