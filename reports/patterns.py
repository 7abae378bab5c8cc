"""Names that a user chooses by patterns, in options of the report."""

from __future__ import annotations

from collections.abc import Collection
from fnmatch import fnmatchcase

from gridtrack.common.errors import ConfigurationError, did_you_mean


def names_matching(patterns: str, names: Collection[str], option: str, what: str) -> set[str]:
    """Those of `names` that match one of `patterns`, as of file names and separated by commas.

    Raises ConfigurationError, with the `option` and `what` the names are of, for a pattern that matches nothing: a
    misspelt one is not a report without it.
    """
    found: set[str] = set()
    for pattern in (part.strip() for part in patterns.split(",")):
        matching = {name for name in names if fnmatchcase(name, pattern)}
        if not matching:
            raise ConfigurationError(f"{option} '{pattern}': no such {what}: {did_you_mean(pattern, names)}")
        found |= matching
    return found
