"""Traffic from Eclipse SUMO with pedestrians by JuPedSim: run it, and read where everybody was.

SUMO gives the front bumper, and headings in degrees clockwise from north; here they become the body's middle, and
radians counter-clockwise from x.
"""

from __future__ import annotations

import subprocess
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl
from numpy.typing import NDArray

from gridtrack.common.errors import ConfigurationError, GridtrackError

STEP_S = 0.125
OPTIONS = {
    "step-length": str(STEP_S),
    "lateral-resolution": "0.8",
    "time-to-teleport": "-1",
    "pedestrian.model": "jupedsim",
    "pedestrian.jupedsim.step-length": "0.025",
}


class SimulationError(GridtrackError):
    """A simulation that did not run, or whose traffic cannot be used."""


@dataclass(frozen=True)
class Movements:
    """Who was where, sorted by road user and then step.

    `user` (N,) int64 numbers the road users in the order of their names; `kind` (users,) is the vehicle type of each;
    `step` (N,) int64 counts from the first; `position` (N, 2) float64 is SUMO's reference point, metres; `heading`
    (N,) float64, radians.
    """

    kind: tuple[str, ...]
    user: NDArray[np.int64]
    step: NDArray[np.int64]
    position: NDArray[np.float64]
    heading: NDArray[np.float64]


def run_sumo(
    folder: Path, network: Path, routes: str, additional: tuple[Path, ...], span_s: tuple[float, float], seed: int
) -> Movements:
    """Simulate from time 0 and give what happened in `span_s`; files that it needs are made in `folder`.

    `routes` is the XML of the demand. The same version and arguments give the same movements. Raises
    ConfigurationError where SUMO is not installed, SimulationError where it fails.
    """
    demand, output = folder / "demand.rou.xml", folder / "positions.csv"
    demand.write_text(routes)
    arguments = {
        "net-file": str(network),
        "route-files": str(demand),
        "additional-files": ",".join(map(str, additional)),
        "begin": "0",
        "end": f"{span_s[1]:g}",
        "seed": str(seed),
        "fcd-output": str(output),
        "fcd-output.attributes": "x,y,angle,type",
        "device.fcd.begin": f"{span_s[0]:g}",
    }
    options = [f"--{name}={value}" for name, value in (OPTIONS | arguments).items()]
    command = [str(_program()), *options, "--no-step-log", "--no-warnings"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0 or not output.is_file():
        raise SimulationError(
            f"SUMO failed with seed {seed}: {_reason(done.stderr, done.returncode)}; try another seed"
        )
    return _read(output, span_s)


def sumo_version() -> str:
    """The version of the installed SUMO. Raises ConfigurationError."""
    from importlib.metadata import version

    _program()
    return version("eclipse-sumo")


def _program() -> Path:
    try:
        import sumo
    except ImportError:
        raise ConfigurationError("simulating traffic needs SUMO: pip install 'gridtrack[sim]'") from None
    return Path(sumo.SUMO_HOME) / "bin" / "sumo"


def _reason(stderr: str, code: int) -> str:
    """The first error that SUMO told."""
    lines = [line for line in stderr.splitlines() if line.startswith("Error")]
    return lines[0] if lines else f"exit code {code}"


def _read(output: Path, span_s: tuple[float, float]) -> Movements:
    columns: Mapping[str, pl.DataType | type[pl.DataType]] = {
        "timestep_time": pl.Float64,
        "vehicle_id": pl.String,
        "vehicle_x": pl.Float64,
        "vehicle_y": pl.Float64,
        "vehicle_angle": pl.Float64,
        "vehicle_type": pl.String,
    }
    table = (
        pl.scan_csv(output, separator=";", schema_overrides=columns)
        .select(list(columns))
        .drop_nulls("vehicle_id")
        .sort("vehicle_id", "timestep_time")
        .with_columns(user=pl.col("vehicle_id").rle_id())
        .collect()
    )
    kinds = table.group_by("user", maintain_order=True).agg(pl.col("vehicle_type").first())["vehicle_type"]
    return Movements(
        kind=tuple(kinds.to_list()),
        user=table["user"].to_numpy().astype(np.int64),
        step=np.round((table["timestep_time"].to_numpy() - span_s[0]) / STEP_S).astype(np.int64),
        position=table.select("vehicle_x", "vehicle_y").to_numpy(),
        heading=np.radians(90.0 - table["vehicle_angle"].to_numpy()),
    )
