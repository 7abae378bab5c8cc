"""The torch device of a network: the processor, or an accelerator of this machine."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Literal

from gridtrack.common.config import Settings
from gridtrack.common.errors import ConfigurationError

if TYPE_CHECKING:
    import torch

os.environ.setdefault("PYTORCH_NVML_BASED_CUDA_CHECK", "1")  # else the query would start CUDA: no forks


class DeviceSettings(Settings):
    """The device on which a network tracks."""

    device: Literal["cpu", "cuda", "auto"] = "cpu"
    """Device of inference: the processor, an NVIDIA GPU, or `auto`, an accelerator if there is one."""


def device_kind(kind: str) -> str:
    """The `kind` of torch device itself; for `auto` that of this machine's accelerator, or "cpu"."""
    import torch

    if kind != "auto":
        return kind
    accelerator = torch.accelerator.current_accelerator(check_available=True)
    return "cpu" if accelerator is None else accelerator.type


def device_count(kind: str) -> int:
    """Number of devices of this `kind` that this process may use."""
    import torch

    if kind == "cpu":
        return len(os.sched_getaffinity(0))
    accelerator = torch.accelerator.current_accelerator(check_available=True)
    return torch.accelerator.device_count() if accelerator is not None and accelerator.type == kind else 0


def inference_device(setting: str) -> torch.device:
    """The device for a `setting` of DeviceSettings; convolutions on it keep all digits of float32.

    Raises ConfigurationError if torch has no such device.
    """
    import torch

    kind = device_kind(setting)
    if not device_count(kind):
        raise ConfigurationError(
            f"device={setting}: torch {torch.__version__} finds no such device here (in a sandbox there is none): use"
            " device=cpu or device=auto"
        )
    if kind == "cuda":
        torch.backends.cudnn.allow_tf32 = False  # TF32, the default of convolutions, has 10 bits
    return torch.device(kind)


def device_name(device: torch.device) -> str:
    """The name of a device, such as "NVIDIA H100"; "" for the processor."""
    import torch

    if device.type == "cpu":
        return ""
    name_of = getattr(torch.get_device_module(device), "get_device_name", None)
    return str(name_of(device)) if name_of else device.type


def wait_for(device: torch.device) -> None:
    """Wait until the device has finished its work, so that the clock of a call includes it."""
    import torch

    if device.type != "cpu":
        torch.accelerator.synchronize(device)
