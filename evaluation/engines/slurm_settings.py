"""What each job asks of Slurm. Light to import: the settings of a comparison hold it."""

from __future__ import annotations

from pydantic import ConfigDict, Field

from gridtrack.common.config import Settings, parse_pairs, validated

SLURM_OPTION = "--slurm"
SLURM_NAME = r"^[\w.+-]+$"


class SlurmSettings(Settings):
    """What each job asks of Slurm, by the names of submitit; None: what the cluster gives without being asked."""

    model_config = ConfigDict(coerce_numbers_to_str=True)

    partition: str | None = Field(None, pattern=SLURM_NAME)
    account: str | None = Field(None, pattern=SLURM_NAME)
    timeout_min: int | None = Field(None, ge=1)
    """Time limit of a job, minutes."""
    mem_gb: float | None = Field(None, gt=0.0)
    """Memory of a trial: of the tracker, and of the process that scores it."""


def parse_slurm(text: str) -> SlurmSettings:
    """Read `KEY=VALUE,...`, such as `partition=long,timeout_min=240`. Raises ConfigurationError."""
    return validated(SlurmSettings, parse_pairs(text, SLURM_OPTION), SLURM_OPTION)
