"""Speed of the recurrent networks on one thread: our variants beside PyTorch, compiled and exported ones.

`python -m benchmarks.inference [--peers] [--out FILE]` (two minutes; five with the peers `torch.compile`, ONNX Runtime,
in the extra `export`, and OpenVINO, `pip install openvino`). All have the same weights; that their forecasts agree is
asserted. They alternate, and the processor time of the process is measured: other work on the machine affects the
caches only. A variant that is not 1.15 times as fast as the fastest of the others is to go. Aim: 5 ms in float32.
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
from numpy.typing import NDArray
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


Runner = Callable[[dict[str, NDArray[np.float32]]], Sequence[NDArray[np.float32]]]
"""A graph that is ready: from its inputs by name to its outputs."""


def exported(network: Any, runner_of: Callable[[bytes], Runner]) -> Replaced:
    """Exported to ONNX: a graph each for a step with and without input and for the decoder."""
    state = network.initial(1)
    with_input = _graph(lambda x, *h: network.step(x, h), network, (observed(0), *state), runner_of)
    without = _graph(lambda *h: network.step(None, h), network, state, runner_of)
    decode = _graph(network.occupancy, network, (network.features(state),), runner_of)

    def step(x: Tensor | None, state: State) -> State:
        return without(*state) if x is None else with_input(x, *state)

    return Replaced(network, step, lambda features: decode(features)[0])


def _graph(
    function: Callable[..., Any],
    network: nn.Module,
    arguments: tuple[Tensor, ...],
    runner_of: Callable[[bytes], Runner],
) -> Callable[..., tuple[Tensor, ...]]:
    class Exported(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.network = network

        def forward(self, *given: Tensor) -> Any:
            return function(*given)

    names = [f"given_{n}" for n in range(len(arguments))]
    plain = tuple(each.contiguous() for each in arguments)
    with tempfile.NamedTemporaryFile(suffix=".onnx") as file:
        torch.onnx.export(
            Exported(), plain, file.name, input_names=names, dynamo=True, external_data=False, verbose=False
        )
        run_graph = runner_of(Path(file.name).read_bytes())

    def run(*given: Tensor) -> tuple[Tensor, ...]:
        found = run_graph(dict(zip(names, (each.contiguous().numpy() for each in given), strict=True)))
        return tuple(map(torch.from_numpy, found))

    return run


def onnx_runtime(graph: bytes) -> Runner:
    """ONNX Runtime, on one thread."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session = onnxruntime.InferenceSession(graph, options, providers=["CPUExecutionProvider"])
    return lambda given: session.run(None, given)


def openvino(graph: bytes) -> Runner:
    """OpenVINO, on one thread."""
    import openvino as ov

    options = {"INFERENCE_NUM_THREADS": 1, "NUM_STREAMS": 1, "INFERENCE_PRECISION_HINT": "f32"}
    core = ov.Core()
    model = core.compile_model(core.read_model(graph), "CPU", options)
    return lambda given: list(model(given).values())


def contestants(network: Any, variants: Mapping[str, Callable[[Any], Any]], *, peers: bool) -> dict[str, Any]:
    """Ours in each precision, first, and the others."""
    found = {f"ours, {precision}": variant(network) for precision, variant in variants.items()}
    others = {"PyTorch, float32": network}
    if peers:
        others["torch.compile, float32"] = compiled(network)
        others["ONNX Runtime, float32"] = exported(network, onnx_runtime)
        others["OpenVINO, float32"] = exported(network, openvino)
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
            begun = time.process_time_ns()
            call()
            times[name].append(1e-6 * (time.process_time_ns() - begun))
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
    parser.add_argument("--peers", action="store_true", help="time torch.compile, ONNX Runtime and OpenVINO too")
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
