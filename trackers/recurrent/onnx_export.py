"""A recurrent network as two ONNX graphs, a step and the decoder, with all that a program needs to run them.

The state is one array (C, M, M): the tensors of the latent state, one after the other. It begins with zeros. A step
without input has planes of zeros. The steps of a paced network are within the graph.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.metadata import version
from itertools import accumulate, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import onnxscript  # noqa: F401 the exporter of torch needs it
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from gridtrack.common.errors import ConfigurationError
from gridtrack.trackers.recurrent.inference import InferenceNetwork
from gridtrack.trackers.recurrent.network import State, map_state, tensors_of
from gridtrack.trackers.recurrent.network_tracker import MOST_MISSED
from gridtrack.trackers.recurrent.pacing import PacedNetwork
from gridtrack.trackers.recurrent.recurrent_tracker import RecurrentTracker
from gridtrack.trackers.training.exported import write_manifest, write_readme

STEP_FILE, DECODER_FILE, UNSEEN_FILE = "step.onnx", "decoder.onnx", "unseen.npy"
FOLDER_CONTENT = f"""- `{STEP_FILE}`: the state after a frame. `{DECODER_FILE}`: the forecast from a state.
- `{UNSEEN_FILE}` (F, C): the state of a cell that no frame has seen, after 0 to F - 1 frames; for a window that moves.
- `manifest.json`: inputs, outputs, grid, period, thresholds, versions, hashes.

`examples/onnx_runner/run.py` of gridtrack runs them with NumPy and ONNX Runtime."""
STEP_INPUTS = {
    "state": "(C, M, M) float32; zeros at the start",
    "visible": "(M, M) float32: 1 where a beam crossed or ended; zeros in a step without a frame",
    "occupied": "(M, M) float32: 1 in visible cells where a beam ended",
}
DECODER_OUTPUTS = {
    "occupancy": "(M, M) float32: P(occupied)",
    "classes": "(K, M, M) float32: P(class), sums to 1",
}
LONG = 1 << 40
"""A number of frames after which every state has converged."""
HOW_TO_FORECAST = "step 0: decode the state; each later step: a step with planes of zeros, then decode"


class _OneArray(nn.Module):
    """A network with its state as one array (C, M, M)."""

    def __init__(self, network: PacedNetwork) -> None:
        super().__init__()
        self.network, self.parameters_of = network, network.innermost
        self.zero = network.initial()
        if any(bool(part.any()) for part in tensors_of(self.zero)):
            raise ConfigurationError("the state of this network does not begin with zeros: it cannot be exported")
        ends = accumulate((part.shape[1] for part in tensors_of(self.zero)), initial=0)
        self.parts = list(pairwise(ends))

    @property
    def channels(self) -> int:
        """C, of the array."""
        return self.parts[-1][1]

    def state_of(self, array: Tensor) -> State:
        """The latent state in an array (C, M, M)."""
        parts = iter(self.parts)
        return map_state(lambda _: array[None, slice(*next(parts))], self.zero)


class _Step(_OneArray):
    """state, visible, occupied -> state."""

    def forward(self, state: Tensor, visible: Tensor, occupied: Tensor) -> Tensor:
        """The state after a frame, (C, M, M)."""
        new = self.network.step(torch.stack([visible, occupied])[None], self.state_of(state))
        return torch.cat(list(tensors_of(new)), dim=1)[0]


class _Decoder(_OneArray):
    """state -> occupancy and, with a class decoder, classes."""

    def forward(self, array: Tensor) -> tuple[Tensor, ...]:
        """P(occupied) (M, M), and P(class) (K, M, M)."""
        state = self.state_of(array)
        occupancy = torch.sigmoid(self.network.occupancy(state))[0]
        logits = self.network.semantics(state)
        return (occupancy,) if logits is None else (occupancy, torch.softmax(logits, dim=1)[0])


@torch.no_grad()
def export_network(tracker: RecurrentTracker, folder: Path) -> str:
    """Write the network of a `tracker` into `folder`; returns a line about it.

    Raises ConfigurationError for a network with a state that does not begin with zeros.
    """
    stream, network = tracker.stream, tracker.network
    network = PacedNetwork(InferenceNetwork(network.innermost), network.pace)  # PyTorch's operations alone
    size = stream.grid.size
    step, decoder = _Step(network), _Decoder(network)
    # each input is a tensor of its own: the exporter takes one that is given twice for one input
    state, visible, occupied = (torch.zeros(*channels, size, size) for channels in ((step.channels,), (), ()))
    outputs = {name: meaning for name, meaning in DECODER_OUTPUTS.items() if name == "occupancy" or tracker.classes}
    opset = _write_graph(
        folder / STEP_FILE, step, {"state": state, "visible": visible, "occupied": occupied}, ["new_state"]
    )
    _write_graph(folder / DECODER_FILE, decoder, {"state": state}, list(outputs))
    place = tracker.place_of_map
    if place is None:
        np.save(folder / UNSEEN_FILE, unseen_states(network), allow_pickle=False)
        of_place: dict[str, Any] = {"unseen": UNSEEN_FILE}
    else:
        x, y = stream.grid.origin
        of_place = {"corner_of_map_m": [place.x + x, place.y + y]}
    versions = {name: version(name) for name in ("gridtrack", "torch", "onnx")}
    entries = {
        "made_with": versions | {"opset": opset},
        "state_channels": step.channels,
        "step": {"file": STEP_FILE, "inputs": STEP_INPUTS, "outputs": {"new_state": "(C, M, M) float32"}},
        "decoder": {"file": DECODER_FILE, "inputs": {"state": "(C, M, M) float32"}, "outputs": outputs},
        "forecast": HOW_TO_FORECAST,
        "most_missed": MOST_MISSED,
        **of_place,
        **tracker.manifest_entries(),
    }
    write_manifest(folder, stream, entries)
    write_readme(folder, stream, FOLDER_CONTENT)
    pace = f"{stream.grid} at {1 / stream.period_s:g} Hz"
    return f"{STEP_FILE}, {DECODER_FILE} for {pace}; the state has {step.channels} channels"


def unseen_states(network: PacedNetwork) -> NDArray[np.float32]:
    """The state (F, C) of a cell that no frame has seen, after 0 to F - 1 frames; later ones are equal to the last."""

    def after(frames: int) -> NDArray[np.float32]:
        parts: list[NDArray[np.float32]] = []
        map_state(parts.append, network.unseen(frames))
        return np.concatenate(parts)

    states, last = [after(0)], after(LONG)
    while not np.array_equal(states[-1], last):
        states.append(after(len(states)))
    return np.stack(states)


def _write_graph(path: Path, module: nn.Module, inputs: Mapping[str, Tensor], outputs: Sequence[str]) -> int:
    """Write a module; returns the version of the operators."""
    program = torch.onnx.export(
        module.eval(),
        tuple(inputs.values()),
        input_names=list(inputs),
        output_names=list(outputs),
        dynamo=True,
        external_data=False,
        verbose=False,
    )
    assert program is not None
    program.save(path)
    return int(program.model.opset_imports[""])
