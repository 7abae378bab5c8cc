"""Learned weights: the search for the weights of a tracker at a site, their provenance, and their leaks.

A leak: weights learned from frames that the tracker is scored on, or that its thresholds are chosen on.
"""

from __future__ import annotations

import re
import shutil
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Literal

from gridtrack.common.errors import WeightsError
from gridtrack.common.files import atomic_write, naming_full_disk, sha256_of, user_data_folder
from gridtrack.evaluation.referee.splits import EvaluationSplit, common_with
from gridtrack.evaluation.runs.run_record import WeightsUsed
from gridtrack.recordings.stream import GridStream
from gridtrack.recordings.stretches import RecordedTime
from gridtrack.trackers.selection import CardKind
from gridtrack.trackers.training.card import GENERAL, Card, TrainingData
from gridtrack.trackers.training.weights import ARRAYS_SUFFIX, arrays_content, read_card

SITE_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,127}")
READ_TRIES, READ_AGAIN_S = 3, 0.1
"""Tries to read a card and its arrays while they are replaced, and the time between two of them."""


@dataclass(frozen=True, slots=True)
class LearnedWeights:
    """The weights of one tracker for one site: the card's path, its content and its hash.

    The card contains the hash of its arrays, so its own hash identifies both.
    """

    path: Path
    card: Card
    sha256: str
    original: Path
    """The folder of the card, or of the card that it is a copy of."""

    @property
    def kind(self) -> Literal["site", "general"]:
        """Weights of a site, or general ones."""
        return "general" if self.card.general else "site"

    @property
    def name(self) -> str:
        """`<tracker>/<site>.toml`, without the folders of this machine: the name in results."""
        return "/".join(self.path.parts[-2:])

    def provenance(self) -> WeightsUsed:
        """The entry of these weights in the record of a run."""
        return WeightsUsed(name=self.name, sha256=self.sha256, labelled_scans=self.card.labelled_scans)


def find_weights(tracker: str, site: str, override: Path | None, kind: CardKind = "any") -> LearnedWeights | None:
    """The weights of `tracker` for `site`, or general ones, from `override` or else from the other folders.

    The site's own weights, the user's before the shipped ones, come before general ones; None if there are none.
    `kind` restricts the search to one of the two. Raises WeightsError if the file cannot be read, or the folder
    `override` does not exist.
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
    """The weights of `tracker` for `site` in `folder`, as `find_weights`. Raises WeightsError if there are none."""
    _require_folder(folder)
    paths = [weights_path(folder, tracker, name) for name in _names(site, kind) or (site,)]
    found = next((path for path in paths if path.is_file()), None)
    if found is None:
        missing = " and ".join(map(str, paths)) + (" are missing" if len(paths) > 1 else " is missing")
        raise WeightsError(f"{folder}: no weights of {tracker} for the site '{site}' ({missing})")
    return read_weights(found, found.parent)


def _require_folder(folder: Path, remedy: str = "") -> None:
    """Raise WeightsError, with a line that ends with `remedy`, if the folder does not exist."""
    if not folder.is_dir():
        raise WeightsError(f"{folder}: no such folder of weights{remedy}")


def _names(site: str, kind: CardKind) -> tuple[str, ...]:
    """The names of the cards that may be used at `site`, the best first, if they are valid file names."""
    names = {"site": (site,), "general": (GENERAL,), "any": (site, GENERAL)}[kind]
    return tuple(name for name in names if SITE_NAME.fullmatch(name))


def copy_weights(weights: LearnedWeights, folder: Path) -> LearnedWeights:
    """A copy of card and arrays in `folder`, with the hash of the copied card.

    Files that are being replaced are read again. Arrays that do not match their card are not copied: the tracker's
    process refuses them. Raises WeightsError, OSError.
    """
    copied = weights_path(folder, weights.path.parent.name, weights.path.stem)
    copied.parent.mkdir(parents=True)
    for _ in range(READ_TRIES):
        with naming_full_disk(copied):
            shutil.copyfile(weights.path, copied)
        sha256 = read_card(copied).arrays_sha256
        try:
            if sha256:
                content = arrays_content(weights.path.with_suffix(ARRAYS_SUFFIX), sha256)
                with atomic_write(copied.with_suffix(ARRAYS_SUFFIX)) as arrays:
                    arrays.write(content)
            return read_weights(copied, weights.original)
        except WeightsError:
            time.sleep(READ_AGAIN_S)
    return weights


def read_weights(path: Path, original: Path) -> LearnedWeights:
    """The weights of the card at `path`, copied from the folder `original` or there itself. Raises WeightsError."""
    sha256 = sha256_of(path)
    return LearnedWeights(path, read_card(path, sha256), sha256, original)


def weights_path(folder: Path, tracker: str, site: str) -> Path:
    """`<folder>/<tracker>/<site>.toml`. Raises WeightsError if the site's name is not a valid file name."""
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


def leaks_of(split: EvaluationSplit, weights: LearnedWeights | None) -> tuple[str, ...]:
    """The leaks of `weights` on the frames of `split`, a line for each stretch."""
    return tuple(dict.fromkeys(_leaks(split, weights))) if weights else ()


def _leaks(split: EvaluationSplit, weights: LearnedWeights) -> Iterator[str]:
    card = weights.card
    for seen, use in ((card.train, "was trained on"), (card.validation, "was selected on")):
        yield from _common(weights, split.test, seen, f"{use} frames of the test stretch")
    if split.validation:
        yield from _common(
            weights, split.validation, card.train, "was trained on frames of the stretch that thresholds are chosen on"
        )


def _common(weights: LearnedWeights, stretch: GridStream, seen: Iterable[TrainingData], use: str) -> Iterator[str]:
    """A line for each part of the training data that has frames of the `stretch`."""
    for data in seen:
        common = common_with(stretch, data)
        if common is not None:
            yield f"{weights.name} {use} {stretch.name}, {_in_recording(stretch, common)}, as {data.recording}"


def _in_recording(stretch: GridStream, time: RecordedTime) -> str:
    """A time in seconds of the recording of `stretch`, and its stamps."""
    first_ns = stretch.recording.survey.first_ns
    start_s, end_s = ((at_ns - first_ns) / 1e9 for at_ns in (time.start_ns, time.end_ns))
    return f"{start_s:g} s to {end_s:g} s (stamps {time.start_ns} to {time.end_ns})"
