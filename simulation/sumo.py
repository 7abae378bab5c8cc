"""Traffic by Eclipse SUMO with pedestrians by JuPedSim: runs the simulation and reads the positions.

SUMO gives the position of the front bumper, and headings in degrees clockwise from north; these are converted to
radians counter-clockwise from x.
"""

from __future__ import annotations

import contextlib
import io
import math
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

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
CONNECTION_TRIES, CONNECTION_WAIT_S = 600, 0.1
EXIT_TIMEOUT_S = 30.0


class SimulationError(GridtrackError):
    """A simulation failed, or its traffic cannot be used."""


@dataclass(frozen=True)
class Movements:
    """Positions of all road users, sorted by road user, then step.

    `user` (N,) int64: index of the road user in the order of the names; `kind` (users,): its vehicle type; `step` (N,)
    int64, from 0; `position` (N, 2) float64: SUMO's reference point, metres; `heading` (N,) float64, radians.
    """

    kind: tuple[str, ...]
    user: NDArray[np.int64]
    step: NDArray[np.int64]
    position: NDArray[np.float64]
    heading: NDArray[np.float64]


class TrafficObserver(Protocol):
    """Observes the traffic during the simulation, and may control it, through a TraCI connection to SUMO."""

    every_s: float

    def start(self, traffic: Any) -> None:
        """Called before the first step."""

    def observe(self, traffic: Any) -> None:
        """Called after every `every_s` seconds of the simulation, and at its end."""


def run_sumo(
    folder: Path,
    network: Path,
    routes: str,
    additional: tuple[Path, ...],
    span_s: tuple[float, float],
    seed: int,
    observer: TrafficObserver,
) -> Movements:
    """The movements in `span_s` of a simulation from time 0; temporary files are written to `folder`.

    `routes` is the XML of the demand. The same version and arguments give the same movements. Raises
    ConfigurationError if SUMO is not installed, SimulationError if it fails.
    """
    demand, output, errors = folder / "demand.rou.xml", folder / "positions.csv", folder / "errors.log"
    demand.write_text(routes)
    arguments = {
        "net-file": str(network),
        "route-files": str(demand),
        **({"additional-files": ",".join(map(str, additional))} if additional else {}),
        "begin": "0",
        "end": f"{span_s[1]:g}",
        "seed": str(seed),
        "fcd-output": str(output),
        "fcd-output.attributes": "x,y,angle,type",
        "device.fcd.begin": f"{span_s[0]:g}",
        "error-log": str(errors),
    }
    options = [f"--{name}={value}" for name, value in (OPTIONS | arguments).items()]
    command = [str(sumo_program("sumo")), *options, "--no-step-log", "--no-warnings"]
    from traci.exceptions import FatalTraCIError, TraCIException

    try:
        _simulate(command, span_s[1], observer)
    except (FatalTraCIError, TraCIException) as error:
        reason = _first_error(errors) or error
        raise SimulationError(f"SUMO failed with seed {seed}: {reason}; try another seed") from error
    with output.open() as positions:
        if "vehicle_id" not in positions.readline():
            raise SimulationError(
                f"no road user in {span_s[0]:g} to {span_s[1]:g} s with seed {seed}: try another seed"
            )
    return _read(output, span_s)


def sumo_version() -> str:
    """The version of the installed SUMO. Raises ConfigurationError."""
    from importlib.metadata import version

    sumo_program("sumo")
    return version("eclipse-sumo")


def sumo_program(name: str) -> Path:
    """The path of a program of SUMO. Raises ConfigurationError."""
    try:
        import sumo
        import traci  # noqa: F401
    except ImportError:
        raise ConfigurationError("simulating traffic needs SUMO: pip install 'gridtrack[sim]'") from None
    return Path(sumo.SUMO_HOME) / "bin" / name


def _simulate(command: list[str], end_s: float, observer: TrafficObserver) -> None:
    """Run `command` up to `end_s` with an observer. Raises TraCI's errors if SUMO ends before."""
    from sumolib.miscutils import getFreeSocketPort
    from traci.exceptions import FatalTraCIError, TraCIException

    port = getFreeSocketPort()
    command = [*command, f"--remote-port={port}"]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        try:
            traffic = _connected(process, port)
            observer.start(traffic)
            for k in range(1, math.ceil(end_s / observer.every_s) + 1):
                traffic.simulationStep(min(k * observer.every_s, end_s))
                observer.observe(traffic)
            traffic.close()
        except (FatalTraCIError, TraCIException):
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(EXIT_TIMEOUT_S)  # SUMO closes the connection before it writes its error
            raise
        finally:
            process.kill()
    if process.returncode != 0:
        raise FatalTraCIError(f"exit code {process.returncode}")


def _connected(process: subprocess.Popen[bytes], port: int) -> Any:
    """The TraCI connection to the process; waits until it listens."""
    import traci

    with contextlib.redirect_stdout(io.StringIO()):  # traci prints every attempt
        return traci.connect(port, CONNECTION_TRIES, proc=process, waitBetweenRetries=CONNECTION_WAIT_S)


def _first_error(log: Path) -> str:
    """The first error in SUMO's log; empty without any."""
    lines = log.read_text().splitlines() if log.is_file() else []
    return next((line for line in lines if line.startswith("Error")), "")


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
        pl.scan_csv(output, separator=";", schema_overrides=columns, glob=False)
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
