"""Trackers that look for forbidden files, and write their findings to the file named in the option `found`."""

from __future__ import annotations

import gc
import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gridtrack.common.config import Settings
from gridtrack.common.grid import GridFrame
from gridtrack.trackers.contract import FitTask, Forecast, StreamSpec, Tracker
from gridtrack.trackers.training.card import card_for
from gridtrack.trackers.training.weights import save_weights

MEMBERS = {"name", "sha256", "grid", "period_s", "site", "classes", "labelled"}


class Found(Settings):
    found: str = ""
    secret: str = ""
    """The name of a file that no tracker may learn, reversed, so that it is in no argument of a process itself."""


class Nosy(Tracker):
    """Looks around in `fit`."""

    Options = Found
    learns = True

    def reset(self, seed: int) -> None: ...

    def update(self, frame: GridFrame) -> None: ...

    def predict(self, steps: int) -> Forecast:
        return Forecast(np.zeros((steps + 1, *self.stream.grid.shape), np.float32))

    @classmethod
    def fit(cls, task: FitTask) -> None:
        sources, options = (*task.train, *task.validation), task.options
        found = {
            "members": sorted({n for s in sources for n in dir(s) if n[0] != "_"} - MEMBERS),
            "attributes": reached((task,)),
            "objects": suspects(gc.get_objects()),
            "stack": stack(),
            "frames": [sum(1 for _ in source) for source in sources],
            "command": [task.command] if options.secret[::-1] in task.command else [],
            "traces": traces(options.secret[::-1]),
        }
        Path(options.found).write_text(json.dumps(found))
        task.report("looked around")
        save_weights(task.out, card_for("nosy", task, {}), {})


class NosyInTrial(Tracker):
    """Looks around when it starts: its own process and those above it, as far as /proc shows them."""

    Options = Found

    def __init__(self, stream: StreamSpec, options: Any) -> None:
        super().__init__(stream, options)
        Path(options.found).write_text(json.dumps({"traces": traces(options.secret[::-1])}))

    def reset(self, seed: int) -> None: ...

    def update(self, frame: GridFrame) -> None: ...

    def predict(self, steps: int) -> Forecast:
        return Forecast(np.zeros((steps + 1, *self.stream.grid.shape), np.float32))


def reached(roots: Sequence[Any]) -> list[str]:
    """Types of the suspect objects that attributes, cells of closures and elements lead to from `roots`."""
    seen: dict[int, Any] = {}
    waiting = list(roots)
    while waiting and len(seen) < 20_000:
        item = waiting.pop()
        if id(item) not in seen:
            seen[id(item)] = item
            waiting += [value for value in gc.get_referents(item) if not isinstance(value, type | np.ndarray)]
    return suspects(seen.values())


def suspects(objects: Any) -> list[str]:
    """Names of the types of recordings, streams of them and scenes among `objects`."""
    names = {type(item).__name__ for item in objects}
    return sorted(n for n in names if n in {"GridStream", "Observation", "Scene", "Scan"} or n.endswith("Recording"))


def stack() -> list[str]:
    """Types of the suspect objects in the local variables of the calls above this one."""
    found, frame = [], sys._getframe()
    while frame is not None:
        found += suspects(frame.f_locals.values())
        frame = frame.f_back  # type: ignore[assignment]
    return found


def traces(secret: str) -> list[str]:
    """Where /proc shows the text `secret` for this process and its ancestors."""
    found, pid = [], os.getpid()
    while pid > 1:
        process = Path(f"/proc/{pid}")
        for part in ("cmdline", "environ", "maps"):
            found += [f"{part} of {pid}"] if secret in text(process / part) else []
        for link in (process / "cwd", process / "exe", *listed(process / "fd")):
            found += [f"{link}"] if secret in target(link) else []
        pid = int(text(process / "stat").rpartition(")")[2].split()[1])
    return found


def text(path: Path) -> str:
    try:
        return path.read_bytes().decode(errors="replace")
    except OSError:
        return ""


def listed(path: Path) -> list[Path]:
    try:
        return list(path.iterdir())
    except OSError:
        return []


def target(link: Path) -> str:
    try:
        return str(link.readlink())
    except OSError:
        return ""
