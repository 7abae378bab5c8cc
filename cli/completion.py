"""What the shell completes beside commands and options: names of trackers, and values of a fixed set.

The sets are those that the values are validated with; they are imported for a completion and not for every command.
Typer keeps the values that begin as what is typed.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, get_args

if TYPE_CHECKING:
    from gridtrack.common.config import Settings


def complete_tracker(incomplete: str) -> Iterator[str]:
    """The registered trackers that begin with `incomplete`; none after the colon of options or in a path."""
    from gridtrack.trackers import registry

    yield from (name for name in registry.entries() if name.startswith(incomplete))


def complete_row(incomplete: str) -> Iterator[str]:
    """Rows of a comparison, [LABEL=]NAME: the label stays as it is typed."""
    label, equals, name = incomplete.rpartition("=")
    yield from (f"{label}{equals}{completed}" for completed in complete_tracker(name))


def complete_engine() -> Sequence[str]:
    """What can run the trials of a comparison."""
    from gridtrack.evaluation.comparison.settings import EngineName

    return get_args(EngineName)


def complete_format() -> Sequence[str]:
    """The formats of a report."""
    from gridtrack.reports.formats import FORMAT_NAMES

    return FORMAT_NAMES


def complete_degradation(incomplete: str) -> Iterator[str]:
    """The kinds of degraded input, as KIND=."""
    from gridtrack.recordings.degradation import Degradation

    return _complete_keys(incomplete, Degradation)


def complete_slurm(incomplete: str) -> Iterator[str]:
    """What a trial can ask of Slurm, as KEY=."""
    from gridtrack.evaluation.engines.slurm_settings import SlurmSettings

    return _complete_keys(incomplete, SlurmSettings)


def complete_cloud_slice(incomplete: str) -> Iterator[str]:
    """The settings of a slice of point clouds, as KEY=."""
    from gridtrack.recordings import CloudSlice

    return _complete_keys(incomplete, CloudSlice)


def _complete_keys(incomplete: str, model: type[Settings]) -> Iterator[str]:
    """The last part of KEY=VALUE,... as a key of `model` that is not given yet, with its `=`."""
    from gridtrack.common.config import field_names

    before, comma, _ = incomplete.rpartition(",")
    given = {part.partition("=")[0] for part in before.split(",")}
    yield from (f"{before}{comma}{key}=" for key in field_names(model) if key not in given)
