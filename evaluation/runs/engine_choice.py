"""The engine that the settings of a run ask for."""

from __future__ import annotations

from gridtrack.evaluation.engines.engine import Engine, RunObserver
from gridtrack.evaluation.engines.local import LocalEngine
from gridtrack.evaluation.engines.ray_cluster import RayCluster
from gridtrack.evaluation.engines.remote import RemoteEngine
from gridtrack.evaluation.engines.slurm_cluster import SlurmCluster
from gridtrack.evaluation.engines.slurm_settings import SlurmSettings
from gridtrack.evaluation.runs.provenance import usable_cores
from gridtrack.evaluation.runs.settings import CompareSettings
from gridtrack.evaluation.runs.worker import carry_out


def engine_of(settings: CompareSettings, progress: RunObserver) -> Engine:
    """The engine of a run, whose folder exists. Raises a GridtrackError where there is no such cluster."""
    cores = settings.limits.threads
    if settings.engine == "ray":
        return RemoteEngine(RayCluster(settings.address, cores, carry_out), settings.out, progress)
    if settings.engine == "slurm":
        cluster = SlurmCluster(settings.slurm or SlurmSettings(), cores, carry_out)
        return RemoteEngine(cluster, settings.out, progress)
    return LocalEngine(settings.jobs or max(1, usable_cores() // cores), settings.out, progress)
