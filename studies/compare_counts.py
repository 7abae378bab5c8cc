"""Equality of the counts of two runs: every trial's Parquet files, row by row.

`python -m studies.compare_counts RUN OTHER [--tolerance 0]` (some seconds). For a change of the code that is meant to
leave every score as it was. Counts must be equal; sums that are not counts, such as log losses, may differ by the
relative tolerance. Trials are matched by the name of their folder. The exit code is 1 where a trial is missing or
differs.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

import polars as pl

from gridtrack.evaluation.results.columns import TABLES


def main() -> None:
    """Print one line for each trial; exit with 1 where any differs."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("run", type=Path)
    parser.add_argument("other", type=Path)
    parser.add_argument("--tolerance", type=float, default=0.0, help="relative, of sums that are not counts")
    arguments = parser.parse_args()
    trials = sorted(_trials(arguments.run) | _trials(arguments.other))
    failed = False
    for trial in trials:
        found = list(differences(arguments.run / trial, arguments.other / trial, arguments.tolerance))
        print(f"{trial}: {'; '.join(found) or 'equal'}")
        failed = failed or bool(found)
    print(f"{len(trials)} trials: {'they differ' if failed or not trials else 'all counts are equal'}")
    sys.exit(failed or not trials)


def _trials(run: Path) -> set[str]:
    return {path.parent.name for path in run.glob("*/scores.parquet")}


def differences(one: Path, other: Path, tolerance: float) -> Iterator[str]:
    """What differs between the files of two trials, one text for each file."""
    for name in (table.file for table in TABLES):
        paths = [folder / name for folder in (one, other)]
        exists = [path.exists() for path in paths]
        if not any(exists):
            continue
        if not all(exists):
            yield f"{name} is missing in {(other if exists[0] else one).parent}"
            continue
        left, right = (pl.read_parquet(path, glob=False) for path in paths)
        if left.columns != right.columns or len(left) != len(right):
            yield f"{name} has {len(left)} rows of {left.columns} and {len(right)} rows of {right.columns}"
            continue
        columns = [column for column in left.columns if not _equal(left[column], right[column], tolerance)]
        if columns:
            yield f"{name} differs in {', '.join(columns)}"


def _equal(one: pl.Series, other: pl.Series, tolerance: float) -> bool:
    if one.dtype.is_float() and tolerance:
        apart = (one - other).abs() > tolerance * one.abs()
        return not apart.any()
    return one.cast(pl.String).equals(other.cast(pl.String)) if one.dtype == pl.Categorical else one.equals(other)


if __name__ == "__main__":
    main()
