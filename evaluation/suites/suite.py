"""A suite: recordings by their hashes and the settings of a comparison on them, the same for everybody and for ever.

A suite is a folder: `suite.toml`, and `rows/` with its published rows. gridtrack has its own in `data/suites`. A change
of a recording or of a setting makes a new suite, such as `worlds-2`.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

import gridtrack.data
from gridtrack.common.config import Settings, validated
from gridtrack.common.errors import ConfigurationError, GridtrackError, did_you_mean
from gridtrack.common.files import is_name, read_bounded, sha256_of
from gridtrack.common.untrusted import parse_toml
from gridtrack.evaluation.scores.robot import SMALL_ROBOT, Robot

DATA = Path(gridtrack.data.__file__).parent
SUITES = DATA / "suites"
SUITE_FILE, ROWS = "suite.toml", "rows"
MAX_SUITE_BYTES = 1 << 20


class SuiteError(GridtrackError):
    """A suite that cannot be read, or a recording of it that is missing or another one."""


class SuiteRecording(Settings):
    """A recording of a suite: `file` below the folder of the data, its hash, and the stretch that is compared."""

    file: Annotated[str, Field(min_length=1, max_length=200)]
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
    stretch: str = ""

    def found(self, data: Path) -> str:
        """RECORDING[@STRETCH] in the folder `data`. Raises SuiteError if the file is missing or another one."""
        path = data / self.file
        if ".." in path.parts[len(data.parts) :] or not path.is_relative_to(data) or not path.is_file():
            raise SuiteError(
                f"{path}: a recording of the suite is missing: --data names the folder `data` of a clone of gridtrack"
            )
        if sha256_of(path) != self.sha256:
            raise SuiteError(f"{path}: not the recording of the suite (its sha256 is another one): restore it")
        return f"{path}@{self.stretch}" if self.stretch else str(path)


class Suite(Settings):
    """Recordings and the settings of their comparison (`CompareSettings`)."""

    name: str
    about: Annotated[str, Field(max_length=1000)]
    recordings: Annotated[tuple[SuiteRecording, ...], Field(min_length=1, max_length=10_000)]
    validation: SuiteRecording | None = None
    horizon_s: float
    every_s: float
    warm_up_s: float | None = None
    seed: int = 0
    robot: Robot = SMALL_ROBOT
    headline: str = "contact_foresight"

    def settings(self, data: Path) -> dict[str, Any]:
        """The settings of its comparison, with its recordings from the folder `data`. Raises SuiteError."""
        found: dict[str, Any] = {
            "recordings": [recording.found(data) for recording in self.recordings],
            "horizon_s": self.horizon_s,
            "every_s": self.every_s,
            "seed": self.seed,
            "robot": self.robot,
            "headline": self.headline,
            "no_floors": True,
        }
        if self.validation:
            found["validation"] = self.validation.found(data)
        return found if self.warm_up_s is None else {**found, "warm_up_s": self.warm_up_s}


def suite_folder(name: str) -> Path:
    """The folder of a suite of gridtrack by its name, or a folder with a suite. Raises ConfigurationError."""
    known = {folder.name: folder for folder in suite_folders()}
    if name in known:
        return known[name]
    if (Path(name) / SUITE_FILE).is_file():
        return Path(name)
    raise ConfigurationError(f"there is no suite '{name}'; {did_you_mean(name, known)}")


def suite_folders() -> Iterator[Path]:
    """The folders of the suites of gridtrack."""
    return (path.parent for path in sorted(SUITES.glob(f"*/{SUITE_FILE}")))


def read_suite(folder: Path) -> Suite:
    """The suite in a folder. Raises SuiteError."""
    path = folder / SUITE_FILE
    try:
        found = validated(Suite, parse_toml(read_bounded(path, MAX_SUITE_BYTES, SuiteError)), str(path))
    except (FileNotFoundError, ValueError, ConfigurationError) as error:
        raise SuiteError(f"{path}: not a suite ({error})") from None
    if not is_name(found.name):
        raise SuiteError(f"{path}: '{found.name}' is no name of a suite")
    return found
