"""Checkpoints of the training of a network, in its log folder, and the device that it trains on."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from gridtrack.common.errors import ConfigurationError
from gridtrack.common.files import atomic_write, write_text
from gridtrack.trackers.contract import FitTask
from gridtrack.trackers.training.device import device_count, device_kind
from gridtrack.trackers.training.weights import read_card

TRAINING_FILE = "settings.json"
"""The description of the training that the checkpoints in a log folder belong to."""
CHECKPOINT_FILE = "last.ckpt"


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

    Call `load_checkpoint` first, which writes down the training that it belongs to.
    """
    with atomic_write(task.log_dir / CHECKPOINT_FILE) as file:
        torch.save(dict(state), file)


def load_checkpoint(task: FitTask) -> dict[str, Any] | None:
    """The last checkpoint of this training, its tensors on the processor; None if it begins.

    Raises ConfigurationError if it is damaged, or of a training with other options, data or seed.
    """
    path = task.log_dir / CHECKPOINT_FILE
    if not is_resumed(task, path, task.options.model_dump(mode="json")):
        return None
    try:
        state: dict[str, Any] = torch.load(path, weights_only=True, map_location="cpu")
    except Exception as error:
        raise ConfigurationError(f"{path}: is damaged: delete the folder to train from the start ({error})") from error
    return state


def delete_checkpoint(task: FitTask) -> None:
    """Delete the checkpoint after the weights are written: a training with other code must not continue from it."""
    (task.log_dir / CHECKPOINT_FILE).unlink(missing_ok=True)


def is_resumed(task: FitTask, checkpoint: Path, settings: Mapping[str, Any]) -> bool:
    """Whether there is a `checkpoint` of this training in its log folder; else writes down the training there.

    A training is its `settings`, data and seed, and the weights that it starts from. Raises ConfigurationError if the
    folder has checkpoints of another one.
    """
    start = {} if task.start is None else {"start": read_card(task.start).arrays_sha256}
    data = [[source.name, source.sha256] for source in task.train]
    described = json.dumps({**start, "seed": task.seed, "train": data, **settings}, sort_keys=True)
    record = task.log_dir / TRAINING_FILE
    task.log_dir.mkdir(parents=True, exist_ok=True)
    if not (record.exists() and checkpoint.exists()):
        write_text(record, described)
        return False
    if record.read_text() != described:
        raise ConfigurationError(
            f"{task.log_dir}: checkpoints of a training with other settings, data or seed: delete the folder to train"
            " from the start"
        )
    return True
