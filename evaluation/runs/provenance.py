"""Provenance of a run: versions of distributions, and the machine."""

from __future__ import annotations

import platform
from functools import cache
from importlib import metadata
from pathlib import Path

import psutil

from gridtrack.evaluation.results.run_record import Machine

DISTRIBUTIONS = (
    "gridtrack", "numpy", "numba", "pydantic", "polars", "pyarrow", "mcap", "safetensors",
    "torch", "filterpy", "scipy", "scikit-learn", "gtsam",
)  # fmt: skip
"""Distributions whose version can change a score."""


@cache
def versions() -> dict[str, str]:
    """Versions of Python and of the installed distributions of DISTRIBUTIONS, read once."""
    found = {"python": platform.python_version()}
    for name in DISTRIBUTIONS:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found


def machine() -> Machine:
    """The properties of the machine that latency depends on; no host name, no address."""
    return Machine(
        cpu=_cpu_model(),
        cores=usable_cores(),
        memory_gb=round(psutil.virtual_memory().total / 1e9, 1),
        system=f"{platform.system()} {platform.machine()}",
    )


def usable_cores() -> int:
    """Cores that this process may use."""
    return len(psutil.Process().cpu_affinity() or ()) or psutil.cpu_count() or 1


def _cpu_model() -> str:
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        for line in cpuinfo.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
