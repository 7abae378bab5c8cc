"""What the shell completes beside commands and options: the names of trackers."""

from __future__ import annotations

from collections.abc import Iterator


def complete_tracker(incomplete: str) -> Iterator[str]:
    """The registered trackers that begin with `incomplete`; none after the colon of options or in a path."""
    from gridtrack.trackers import registry

    yield from (name for name in registry.entries() if name.startswith(incomplete))


def complete_row(incomplete: str) -> Iterator[str]:
    """Rows of a comparison, [LABEL=]NAME: the label stays as it is typed."""
    label, equals, name = incomplete.rpartition("=")
    yield from (f"{label}{equals}{completed}" for completed in complete_tracker(name))
