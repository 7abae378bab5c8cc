"""Forecasts of an exported network with NumPy and ONNX Runtime: `python run.py EXPORT FRAMES.npz FORECASTS.npz STEPS`.

FRAMES.npz: `stamp_ns` (N,) int64, `visible` and `occupied` (N, M, M) bool with rows along y, and `origin_xy` (2,) or
(N, 2), the lower-left corner of cell [0, 0] in the world, metres. FORECASTS.npz is scored by
`gridtrack compare ... --tracker mine=recorded:file=FORECASTS.npz`.
"""

import json
import sys
from pathlib import Path

import numpy as np
import onnxruntime


class Network:
    """The network in an export, with its state."""

    def __init__(self, folder):
        self.manifest = json.loads((folder / "manifest.json").read_text())
        self.step, self.decoder = (
            onnxruntime.InferenceSession(folder / self.manifest[name]["file"]) for name in ("step", "decoder")
        )
        self.unseen = np.load(folder / self.manifest["unseen"]) if "unseen" in self.manifest else None
        size = self.manifest["size"]
        self.state = np.zeros((self.manifest["state_channels"], size, size), np.float32)
        self.nothing = np.zeros((size, size), np.float32)
        self.updates, self.stamp_ns, self.corner = 0, None, self.manifest.get("corner_of_map_m")

    def after(self, state, visible, occupied):
        """The state after a frame."""
        return self.step.run(None, {"state": state, "visible": visible, "occupied": occupied})[0]

    def update(self, stamp_ns, visible, occupied, corner):
        """Take in a frame; frames that are missing before it are steps without input."""
        periods = 1 if self.stamp_ns is None else round((stamp_ns - self.stamp_ns) / 1e9 / self.manifest["period_s"])
        missed = min(max(periods - 1, 0), self.manifest["most_missed"])
        for _ in range(missed):
            self.state = self.after(self.state, self.nothing, self.nothing)
        self.updates += missed
        self.follow(corner)
        self.state = self.after(self.state, visible.astype(np.float32), occupied.astype(np.float32))
        self.updates, self.stamp_ns = self.updates + 1, stamp_ns

    def follow(self, corner):
        """Move the window by whole cells: states keep their places, and cells that enter are unseen."""
        moved = np.subtract(corner, corner if self.corner is None else self.corner) / self.manifest["cell_m"]
        if self.unseen is None and np.abs(moved).max() > 1e-3:
            raise SystemExit(f"the static memory of this network is for the window at {self.corner}, not {corner}")
        self.corner, size = corner, len(self.nothing)
        x, y = np.clip(np.rint(moved), -size, size).astype(int)
        if x or y:
            fill = self.unseen[min(self.updates, len(self.unseen) - 1)]
            new = np.tile(fill[:, None, None], (1, size, size))
            inside = self.state[:, max(y, 0) : size + min(y, 0), max(x, 0) : size + min(x, 0)]
            new[:, max(-y, 0) : size - max(y, 0), max(-x, 0) : size - max(x, 0)] = inside
            self.state = new

    def forecast(self, steps):
        """P(occupied) (steps + 1, M, M); the state is not changed."""
        state, planes = self.state, []
        for step in range(steps + 1):
            state = self.after(state, self.nothing, self.nothing) if step else state
            planes.append(self.decoder.run(["occupancy"], {"state": state})[0])
        return np.stack(planes)


def main(export, frames_file, forecasts_file, steps):
    """Forecast at every frame of a file."""
    network, frames = Network(Path(export)), np.load(frames_file)
    stamps, corners = frames["stamp_ns"], np.broadcast_to(frames["origin_xy"], (len(frames["stamp_ns"]), 2))
    occupancy = []
    for stamp_ns, visible, occupied, corner in zip(stamps, frames["visible"], frames["occupied"], corners, strict=True):
        network.update(int(stamp_ns), visible, occupied, corner)
        occupancy.append(network.forecast(int(steps)))
    lead_s = np.arange(int(steps) + 1) * network.manifest["period_s"]
    cell_m, note = network.manifest["cell_m"], f"{network.manifest['tracker']} by ONNX Runtime"
    np.savez(
        forecasts_file, occupancy=occupancy, stamp_ns=stamps, lead_s=lead_s, cell_m=cell_m, origin_xy=corners, note=note
    )


if __name__ == "__main__":
    main(*sys.argv[1:])
