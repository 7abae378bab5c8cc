"""Speed of the recurrent networks on one thread, beside other implementations of the same networks.

`python -m benchmarks.inference [--out FILE]` (two minutes). For the dilated ConvGRU: ours, also with
`inference=bfloat16`; a straightforward PyTorch ConvGRU, gate by gate on concatenated input; and that one in ONNX
Runtime, where `pip install onnxruntime onnx onnxscript` has been run. All have the same weights; that their forecasts
agree is asserted. They take turns, and the thread's processor time is measured: other work on the machine affects the
caches only. Aim: 5 ms in float32.
"""

from __future__ import annotations

import argparse
import functools
import importlib.util
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import conv2d

from gridtrack.trackers.recurrent.convgru_tracker import DilatedConvGRUTracker
from gridtrack.trackers.recurrent.deep_tracking_rnn import DeepTrackingRNN, DeepTrackingRNNTracker
from gridtrack.trackers.recurrent.dilated_convgru import DilatedConvGRU
from gridtrack.trackers.recurrent.kernels.convgru import InferenceConvGRU
from gridtrack.trackers.recurrent.kernels.rnn import InferenceRNN
from gridtrack.trackers.recurrent.network import LatentState, RecurrentNetwork, as_tensor, channels_last
from gridtrack.trackers.recurrent.settings import GATES

from studies.support.results_file import ResultSection, ResultTable, measured_table, write_section

SIZE, STEPS = 100, 20
FORECAST = f"forecast of {STEPS} steps"
TOLERANCE = {"ours, bfloat16": 0.05}
"""Of P(occupied) after some frames and a forecast; 1e-4 for the others."""


class StraightforwardStep(nn.Module):
    """A step without optimisation: keep and reset from [x, h], the candidate from x and from h; no input is zeros."""

    def __init__(self, network: DilatedConvGRU) -> None:
        super().__init__()
        self.network = network

    def forward(self, x: Tensor, *state: Tensor) -> LatentState:
        """x (1, 2, M, M) and h (1, C, M, M) of every layer -> h' of every layer."""
        new: list[Tensor] = []
        layers: Any = self.network.layers
        for layer, h in zip(layers, state, strict=True):
            x = new[-1] if new else x
            both = torch.cat([x, h], dim=1)
            weights = zip(layer.input_weight.chunk(3), layer.state_weight.chunk(3), strict=True)
            (keep_x, keep_h), (reset_x, reset_h), (candidate_x, candidate_h) = weights
            b_keep, b_reset, b_candidate = (layer.biases[gate] for gate in GATES)
            around = {"padding": layer.dilation, "dilation": layer.dilation}
            f = torch.sigmoid(conv2d(both, torch.cat([keep_x, keep_h], 1), **around) + b_keep)
            r = torch.sigmoid(conv2d(both, torch.cat([reset_x, reset_h], 1), **around) + b_reset)
            c = torch.tanh(conv2d(x, candidate_x, **around) + r * conv2d(h, candidate_h, **around) + b_candidate)
            new.append(f * h + (1 - f) * c)
        return tuple(new)


class Straightforward:
    """A RecurrentNetwork of a step and a decoder, whatever runs them; it keeps the state in their layout."""

    def __init__(self, network: DilatedConvGRU, step: Callable[..., Any], decoder: Callable[..., Any]) -> None:
        self.initial, self.features = network.initial, network.features
        self._step, self._decoder = step, decoder
        self._empty = torch.zeros(1, 2, SIZE, SIZE)

    def step(self, x: Tensor | None, state: LatentState) -> LatentState:
        """h_t."""
        return tuple(self._step(self._empty if x is None else x, *state))

    def occupancy(self, features: Tensor) -> Tensor:
        """Logits of P(occupied), (1, M, M)."""
        return torch.as_tensor(self._decoder(features)).squeeze(1)


def onnx_runtime(network: DilatedConvGRU) -> Straightforward:
    """Exported from the straightforward one; a session each for the step and the decoder, on one thread."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1

    def session(module: nn.Module, *example: Tensor) -> Callable[..., Any]:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "module.onnx"
            torch.onnx.export(module, example, path, dynamo=True, verbose=False)
            running = onnxruntime.InferenceSession(path, options)
        names = [each.name for each in running.get_inputs()]
        return lambda *values: running.run(None, dict(zip(names, map(np.asarray, values), strict=True)))

    state = [h.contiguous() for h in network.initial(1)]
    step = session(StraightforwardStep(network), torch.zeros(1, 2, SIZE, SIZE), *state)
    decoder = session(network.decode_occupancy, state[-1])
    return Straightforward(network, step, lambda features: decoder(features)[0])


def contestants(network: DilatedConvGRU) -> dict[str, Any]:
    found: dict[str, Any] = {
        "ours, float32": InferenceConvGRU(network),
        "ours, bfloat16": InferenceConvGRU(network, bfloat16=True),
        "straightforward PyTorch": Straightforward(network, StraightforwardStep(network), network.decode_occupancy),
    }
    if all(importlib.util.find_spec(name) for name in ("onnxruntime", "onnx", "onnxscript")):
        found["ONNX Runtime"] = onnx_runtime(network)
    else:
        print("ONNX Runtime is left out: pip install onnxruntime onnx onnxscript")
    return found


def forecast(network: RecurrentNetwork, state: LatentState, steps: int) -> Tensor:
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


def assert_agreement(found: dict[str, Any]) -> dict[str, LatentState]:
    """The state of each after some frames, from which its forecast is the others'."""
    states, forecasts = {}, {}
    for name, network in found.items():
        states[name] = network.initial(1)
        for seed in range(5):
            states[name] = network.step(observed(seed), states[name])
        forecasts[name] = forecast(network, states[name], STEPS)
    first = next(iter(forecasts.values()))
    for name, values in forecasts.items():
        difference = float((values - first).abs().max())
        print(f"  {name:28} P(occupied) within {difference:.1e} of ours")
        assert difference <= TOLERANCE.get(name, 1e-4), name
    return states


def processor_times_ms(calls: Mapping[str, Callable[[], object]], rounds: int) -> dict[str, np.ndarray]:
    """Processor time of each call, in turns, after one of its own that is not counted."""
    times: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(rounds):
        for name, call in calls.items():
            call()
            begun = time.thread_time_ns()
            call()
            times[name].append(1e-6 * (time.thread_time_ns() - begun))
    return {name: np.array(values) for name, values in times.items()}


def best_rate(rounds: int) -> float:
    """GFLOP/s of the fastest float32 convolution or matrix product found on one thread of this processor."""
    calls: dict[str, Callable[[], object]] = {}
    operations = {}
    for inputs, outputs in ((16, 48), (32, 32), (64, 64)):
        image, weight = (
            torch.randn(shape).contiguous(memory_format=torch.channels_last)
            for shape in ((1, inputs, SIZE, SIZE), (outputs, inputs, 3, 3))
        )
        name = f"convolution {inputs} -> {outputs}"
        calls[name] = lambda image=image, weight=weight: conv2d(image, weight, padding=1)
        operations[name] = 2 * 9 * inputs * outputs * SIZE**2
    for n in (256, 512):
        a, b, out = torch.randn(n, n), torch.randn(n, n), torch.empty(n, n)
        calls[f"product {n}"] = lambda a=a, b=b, out=out: torch.mm(a, b, out=out)
        operations[f"product {n}"] = 2 * n**3
    rates = {name: 1e-6 * operations[name] / values.min() for name, values in processor_times_ms(calls, rounds).items()}
    best = max(rates, key=lambda name: rates[name])
    print(f"best float32 rate: {rates[best]:.0f} GFLOP/s ({best})")
    return rates[best]


CASES: dict[str, tuple[int, Callable[[Any, LatentState], object]]] = {
    "update with input": (1, lambda network, state: network.step(observed(9), state)),
    "update without": (1, lambda network, state: network.step(None, state)),
    "forecast step, decoded": (1, lambda network, state: forecast(network, network.step(None, state), 0)),
    FORECAST: (STEPS, lambda network, state: forecast(network, state, STEPS)),
}
"""Steps, and what is timed from a network and its state."""


@dataclass(frozen=True)
class Comparison:
    """The median milliseconds of each case by implementation, and the least that a step's convolutions can take."""

    medians_ms: dict[str, dict[str, float]]
    at_best_ms: float

    def table(self, name: str) -> ResultTable:
        """Ratios of the medians to those of the first implementation, ours."""
        first, *_ = self.medians_ms.values()
        rows = [
            [label, *(f"{own / ours:.2f}" for own, ours in zip(cases.values(), first.values(), strict=True))]
            for label, cases in self.medians_ms.items()
        ]
        return measured_table((f"{name}, times ours in float32", *CASES), rows)

    def values(self, name: str) -> dict[str, str]:
        """Milliseconds of ours, and how near its forecast is to the best rate found on the processor."""
        ours, *_ = self.medians_ms.values()
        texts = {f"{name}: {case}, ms": f"{ms:.1f}" for case, ms in ours.items()}
        share = self.at_best_ms * STEPS / ours[FORECAST]
        return texts | {f"{name}: share of the best rate": f"{100 * share:.0f} %"}


def compared(found: dict[str, Any], operations: int, rate: float, rounds: int) -> Comparison:
    """Times of all cases; `operations` are those of a step's convolutions by the definition."""
    states = assert_agreement(found)
    at_best_ms = 1e-6 * operations / rate
    print(f"  a step's convolutions by the definition would take {at_best_ms:.2f} ms at the best rate")
    medians_ms: dict[str, dict[str, float]] = {name: {} for name in found}
    for case, (steps, call) in CASES.items():
        calls = {name: lambda name=name, call=call: call(found[name], states[name]) for name in found}
        for name, ms in processor_times_ms(calls, max(3, rounds // steps)).items():
            median = medians_ms[name][case] = float(np.median(ms))
            share = at_best_ms * steps / median
            print(f"  {case:22} {name:24} median {median:7.2f} ms, least {ms.min():7.2f} ms; {share:4.0%} of the rate")
    return Comparison(medians_ms, at_best_ms)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--rounds", type=int, default=40)
    parser.add_argument("--out", type=Path, help="results file, such as docs/results/trackers/recurrent.json")
    given = parser.parse_args(arguments)
    torch.set_num_threads(1)
    by_network = {}
    with torch.inference_mode():
        rate = best_rate(given.rounds)
        gru = trained_like(DilatedConvGRU(SIZE, DilatedConvGRUTracker.Options()))
        operations = 2 * 9 * SIZE**2 * 3 * gru.channels**2 * (2 * len(gru.layers) - 1)
        print("dilated-convgru")
        by_network["dilated-convgru"] = compared(contestants(gru), operations, rate, given.rounds)
        rnn = trained_like(DeepTrackingRNN(SIZE, DeepTrackingRNNTracker.Options()))
        print("deep-tracking-rnn")
        both = {"ours, float32": InferenceRNN(rnn), "straightforward PyTorch": rnn}
        operations = 2 * rnn.recur.weight.numel() * SIZE**2
        by_network["deep-tracking-rnn"] = compared(both, operations, rate, given.rounds)
    if given.out:
        tables = {name: found.table(name) for name, found in by_network.items()}
        values = {key: text for name, found in by_network.items() for key, text in found.values(name).items()}
        command = f"python -m benchmarks.inference --rounds {given.rounds}"
        write_section(given.out, "speed", ResultSection(command=command, tables=tables, values=values))


if __name__ == "__main__":
    main()
