"""Checkpoints of the training of a network, in its log folder, and the device that it trains on."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from gridtrack.common.errors import ConfigurationError, one_line
from gridtrack.common.files import atomic_write, read_bounded, sha256_of, write_text
from gridtrack.common.untrusted import parse_json
from gridtrack.trackers.contract import FitTask
from gridtrack.trackers.training.device import device_count, device_kind
from gridtrack.trackers.training.weights import CHECKPOINT_FILE, read_card

TRAINING_FILE = "settings.json"
"""The description of the training that the checkpoints in a log folder belong to."""
MAX_RECORD_BYTES, MAX_DIFFERENCES = 1 << 24, 4
"""Limits of this file, and of the differences that a message names."""
CODE = "code of the tracker"


def training_device(kind: str) -> torch.device:
    """The device for `task.device`: for `auto` an accelerator if there is one, else the processor.

    Raises ConfigurationError if this machine has none of this kind.
    """
    found = device_kind(kind)
    if not device_count(found):
        raise ConfigurationError(f"device {kind}: this machine has none; train on cpu")
    return torch.device(found)


def save_checkpoint(task: FitTask, state: Mapping[str, Any]) -> None:
    """Write the checkpoint of a training: tensors, numbers and texts, in dicts and lists. Raises OSError.

    Call `load_checkpoint` first, which writes down the training that it belongs to. `gridtrack train` deletes it when
    all is done: a training with other code must not continue from it.
    """
    with atomic_write(task.log_dir / CHECKPOINT_FILE) as file:
        torch.save(dict(state), file)


def load_checkpoint(task: FitTask) -> dict[str, Any] | None:
    """The last checkpoint of this training, its tensors on the processor; None if it begins.

    Raises ConfigurationError if it is damaged, or of a training with other options, data or seed, or of another
    version of the module with the options.
    """
    path = task.log_dir / CHECKPOINT_FILE
    if not is_resumed(task, path, {**task.options.model_dump(mode="json"), CODE: _code_sha256(task)}):
        return None
    try:
        state: dict[str, Any] = torch.load(path, weights_only=True, map_location="cpu")
    except Exception as error:
        raise ConfigurationError(f"{path}: is damaged: delete the folder to train from the start ({error})") from error
    return state


def is_resumed(task: FitTask, checkpoint: Path, settings: Mapping[str, Any]) -> bool:
    """Whether there is a `checkpoint` of this training in its log folder; else writes down the training there.

    A training is its `settings`, data and seed, and the weights that it starts from. Raises ConfigurationError if the
    folder has checkpoints of another one.
    """
    start = {} if task.start is None else {"start": read_card(task.start).arrays_sha256}
    data = [[source.name, source.sha256] for source in task.train]
    described = json.loads(json.dumps({**start, "seed": task.seed, "train": data, **settings}))
    record = task.log_dir / TRAINING_FILE
    task.log_dir.mkdir(parents=True, exist_ok=True)
    if not (record.exists() and checkpoint.exists()):
        write_text(record, json.dumps(described, sort_keys=True))
        return False
    if (found := parse_json(read_bounded(record, MAX_RECORD_BYTES, ConfigurationError))) != described:
        raise ConfigurationError(
            f"{task.log_dir}: checkpoints of another training: {_difference(found, described)}; its own command"
            " continues it; delete the folder to train from the start"
        )
    return True


def _difference(found: Any, described: Mapping[str, Any]) -> str:
    """The first fields in which two descriptions of a training differ, for a message."""
    if not isinstance(found, dict):
        return f"{TRAINING_FILE} is damaged"
    names = [name for name in sorted(found.keys() | described.keys()) if found.get(name) != described.get(name)]
    plain = [name for name in names if isinstance(described.get(name), int | float)]
    texts = [f"{name} is {described[name]}, there {one_line(str(found.get(name)), 40)}" for name in plain]
    return ", ".join([*texts, *(f"another {name}" for name in names if name not in plain)][:MAX_DIFFERENCES])


def _code_sha256(task: FitTask) -> str:
    """The hash of the module that defines the options, and usually the tracker; "" without a file."""
    path = getattr(sys.modules.get(type(task.options).__module__), "__file__", None)
    return sha256_of(Path(path)) if path else ""
