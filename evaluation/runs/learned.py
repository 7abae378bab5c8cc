"""Learned weights: where a tracker's weights for a site are found, and their provenance."""

from __future__ import annotations

import re
import shutil
import time
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Literal

from gridtrack.common.errors import WeightsError
from gridtrack.common.files import sha256_of, user_data_folder
from gridtrack.evaluation.results.run_record import WeightsUsed
from gridtrack.trackers.card import GENERAL, Card
from gridtrack.trackers.selection import CardKind
from gridtrack.trackers.weights import ARRAYS_SUFFIX, arrays_content, read_card

SITE_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,127}")
READ_ATTEMPTS, READ_AGAIN_S = 3, 0.1
"""Attempts to read a card and its arrays while they are replaced, and the time between two of them."""


@dataclass(frozen=True, slots=True)
class LearnedWeights:
    """The weights of one tracker for one site: the card's path, its content and its hash.

    The card contains the hash of its arrays, so its own hash identifies both.
    """

    path: Path
    card: Card
    sha256: str
    original: Path
    """The folder of the card, or of the one that it was copied from."""

    @property
    def kind(self) -> Literal["site", "general"]:
        """Whether they are of a site or general."""
        return "general" if self.card.general else "site"

    @property
    def name(self) -> str:
        """`<tracker>/<site>.toml`, without the folders of this machine: the name in results."""
        return "/".join(self.path.parts[-2:])

    def provenance(self) -> WeightsUsed:
        """The entry of these weights in the record of a run."""
        return WeightsUsed(name=self.name, sha256=self.sha256, labelled_scans=self.card.labelled_scans)


def find_weights(tracker: str, site: str, override: Path | None, kind: CardKind = "any") -> LearnedWeights | None:
    """The weights of `tracker` for `site`, or general ones: in `override`, else the best of the other folders.

    The site's own weights, the user's before the shipped ones, come before general ones; None where there are none.
    `kind` restricts the search to one of the two. Raises WeightsError where the file cannot be read, or where there is
    no folder `override`.
    """
    if override is not None:
        _require_folder(override, "; omit --weights to use your own and the shipped ones")
    names = _names(site, kind)
    overriding = [(override, name) for name in names] if override else []
    others = [(folder, name) for name in names for folder in _folders(None)]
    paths = (weights_path(folder, tracker, name) for folder, name in (*overriding, *others))
    found = next((path for path in paths if path.is_file()), None)
    return None if found is None else read_weights(found, found.parent)


def sites_with_weights(tracker: str, override: Path | None) -> tuple[str, ...]:
    """The sites that `tracker` has weights for in any folder, sorted."""
    found = (path for folder in _folders(override) for path in (folder / tracker).glob("*.toml"))
    return tuple(sorted({path.stem for path in found}))


def weights_in(folder: Path, tracker: str, site: str, kind: CardKind = "any") -> LearnedWeights:
    """The weights of `tracker` for `site` in `folder` only, as in `find_weights`. Raises WeightsError without any."""
    _require_folder(folder)
    paths = [weights_path(folder, tracker, name) for name in _names(site, kind) or (site,)]
    found = next((path for path in paths if path.is_file()), None)
    if found is None:
        missing = " and ".join(map(str, paths)) + (" are missing" if len(paths) > 1 else " is missing")
        raise WeightsError(f"{folder}: no weights of {tracker} for the site '{site}' ({missing})")
    return read_weights(found, found.parent)


def _require_folder(folder: Path, mend: str = "") -> None:
    """Raises WeightsError where there is no such folder; `mend` ends its line."""
    if not folder.is_dir():
        raise WeightsError(f"{folder}: no such folder of weights{mend}")


def _names(site: str, kind: CardKind) -> tuple[str, ...]:
    """The names of the cards that may be used at `site`, the best first; a site whose name cannot name one has none."""
    names = {"site": (site,), "general": (GENERAL,), "any": (site, GENERAL)}[kind]
    return tuple(name for name in names if SITE_NAME.fullmatch(name))


def copy_weights(weights: LearnedWeights, folder: Path) -> LearnedWeights:
    """A copy of card and arrays in `folder`, with the hash of the copied card.

    Files that are being replaced are read again. Arrays that do not match their card are not copied: the tracker's
    process refuses them. Raises WeightsError, OSError.
    """
    copied = weights_path(folder, weights.path.parent.name, weights.path.stem)
    copied.parent.mkdir(parents=True)
    for _ in range(READ_ATTEMPTS):
        shutil.copyfile(weights.path, copied)
        sha256 = read_card(copied).arrays_sha256
        try:
            if sha256:
                content = arrays_content(weights.path.with_suffix(ARRAYS_SUFFIX), sha256)
                copied.with_suffix(ARRAYS_SUFFIX).write_bytes(content)
            return read_weights(copied, weights.original)
        except WeightsError:
            time.sleep(READ_AGAIN_S)
    return weights


def read_weights(path: Path, original: Path) -> LearnedWeights:
    """The weights of the card at `path`, copied from the folder `original` or there itself. Raises WeightsError."""
    sha256 = sha256_of(path)
    return LearnedWeights(path, read_card(path, sha256), sha256, original)


def weights_path(folder: Path, tracker: str, site: str) -> Path:
    """`<folder>/<tracker>/<site>.toml`. Raises WeightsError for a site whose name cannot name a file."""
    if not SITE_NAME.fullmatch(site):
        raise WeightsError(
            f"site '{site}' cannot name a weights file: letters, digits and . _ - only; set it when the recording is"
            " imported (`gridtrack recording import --site NAME`)"
        )
    return folder / tracker / f"{site}.toml"


def user_weights_folder() -> Path:
    """The user's own weights: `$XDG_DATA_HOME/gridtrack/weights` on Linux."""
    return user_data_folder() / "weights"


def _folders(override: Path | None) -> Iterator[Path]:
    if override is not None:
        yield override
    yield user_weights_folder()
    yield Path(str(resources.files("gridtrack.data") / "weights"))
