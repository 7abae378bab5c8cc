"""Size on disk of gridtrack's requirements, and of the additions of each extra.

`python -m studies.install_size --out docs/results/install_size.json` (seconds) adds up the files of the installed
distributions that an extra needs and gridtrack alone does not. Which build of PyTorch is installed is part of the row.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from importlib import metadata

from packaging.requirements import Requirement

from studies.support.results_file import measured_table, study_parser, write_table

EXTRAS = ("deep", "model-free", "ego-motion", "figures", "view", "ros", "remote", "ray", "slurm", "sim", "all")
COMMAND = "python -m studies.install_size"


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, print and write the table."""
    parser = study_parser(__doc__, "docs/results/install_size.json")
    given = parser.parse_args(arguments)
    alone = closure("gridtrack", "")
    rows = [["gridtrack alone", _megabytes(alone)]]
    for extra in EXTRAS:
        more = closure("gridtrack", extra) - alone
        torch = f" (PyTorch {metadata.version('torch')})" if "torch" in more else ""
        rows.append([f"`{extra}`{torch}", _megabytes(more)])
    table = measured_table(["extra", "MB more"], rows)
    print(table.markdown())
    write_table(given.out, "sizes", table, COMMAND)


def closure(name: str, extra: str) -> frozenset[str]:
    """The installed requirements of `name` with `extra`, and their requirements."""
    found: set[tuple[str, str]] = set()
    waiting = [(name, extra)]
    while waiting:
        one = waiting.pop()
        if one not in found:
            found.add(one)
            waiting += _required(*one)
    return frozenset(_normal(required) for required, _ in found) - {name}


def _required(name: str, extra: str) -> Iterator[tuple[str, str]]:
    """The requirements of a distribution here, with each requested extra; none if it is not installed."""
    try:
        lines = metadata.requires(name) or []
    except metadata.PackageNotFoundError:
        return
    for requirement in map(Requirement, lines):
        if requirement.marker is None or requirement.marker.evaluate({"extra": extra}):
            yield requirement.name, ""
            yield from ((requirement.name, asked) for asked in requirement.extras)


def _normal(name: str) -> str:
    return name.lower().replace("_", "-").replace(".", "-")


def _megabytes(names: frozenset[str]) -> str:
    total = 0
    for name in names:
        try:
            files = metadata.files(name) or []
        except metadata.PackageNotFoundError:
            continue
        total += sum(path.stat().st_size for file in files if (path := file.locate()).is_file())  # type: ignore[attr-defined]
    return f"{total / 1e6:.0f}"


if __name__ == "__main__":
    main()
