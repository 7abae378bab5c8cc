"""Learned weights of a tracker: a card (`.toml`) and the arrays in the `.safetensors` file beside it.

Weights of other cells, or of another period, site or tracker are refused; general weights are for any site.
"""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import tomli_w
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load, save

from gridtrack.common.config import Settings, validated
from gridtrack.common.errors import ConfigurationError, WeightsError
from gridtrack.common.files import atomic_write, read_bounded, write_text
from gridtrack.common.grid import GridSpec
from gridtrack.common.untrusted import parse_toml
from gridtrack.trackers.contract import StreamSpec
from gridtrack.trackers.training.card import CARD_SCHEMA, Card, CardThresholds, StartedFrom, TrainingData

MAX_ARRAYS_BYTES = 1 << 30
MAX_CARD_BYTES = 1 << 20
ARRAYS_SUFFIX = ".safetensors"
CHECKPOINT_FILE, SEARCH_FILE = "last.ckpt", "search.json"
"""Files in the log folder of a training, or in a folder of it, from which it continues after an interrupt."""

_Tuned = TypeVar("_Tuned", bound=Settings)


@dataclass(frozen=True)
class Weights:
    """A card and its arrays, consistent with each other."""

    card: Card
    arrays: dict[str, NDArray[Any]]


def save_weights(path: Path, card: Card, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write `path` (`.toml`) and, if there are arrays, the `.safetensors` file beside it, each atomically.

    Both are written before either is replaced, and the card, which has the hash of the arrays, is replaced last. Until
    then the previous arrays are kept beside the new ones, for readers of the previous card. Raises OSError.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    arrays_path = path.with_suffix(ARRAYS_SUFFIX)
    if arrays and arrays_path.exists():
        shutil.copyfile(arrays_path, _previous(arrays_path))
    with ExitStack() as files:
        card_file = files.enter_context(atomic_write(path))
        if arrays:
            blob = save({name: np.ascontiguousarray(array) for name, array in arrays.items()})
            card = card.model_copy(update={"arrays_sha256": hashlib.sha256(blob).hexdigest()})
            files.enter_context(atomic_write(arrays_path)).write(blob)
        card_file.write(card_text(card).encode())
    _previous(arrays_path).unlink(missing_ok=True)


def save_interrupted(path: Path, card: Card, arrays: Mapping[str, NDArray[Any]], reached: str) -> None:
    """Write the best weights so far of a training that was interrupted after the step `reached`.

    Nothing is written over the weights of a training that finished, unless this one adds classes to them. Raises
    OSError.
    """
    with suppress(WeightsError):
        earlier = read_card(path)
        if not earlier.interrupted and (earlier.classes or not card.classes):
            return
    save_weights(path, card.model_copy(update={"interrupted": reached}), arrays)


def can_continue(log_dir: Path) -> bool:
    """Whether the log folder has files from which a training continues."""
    return any(True for name in (CHECKPOINT_FILE, SEARCH_FILE) for _ in log_dir.rglob(name))


def delete_progress(log_dir: Path) -> None:
    """Delete these files, but no checkpoints in folders, when all stages of a training are done: a training with other
    code must not continue from them."""
    for name in (CHECKPOINT_FILE, SEARCH_FILE):
        (log_dir / name).unlink(missing_ok=True)


def _previous(arrays_path: Path) -> Path:
    return arrays_path.with_name(arrays_path.name + ".previous")


def complete_card(
    path: Path,
    placeholder: str,
    command: str,
    train: Sequence[TrainingData],
    validation: Sequence[TrainingData],
    started_from: StartedFrom | None = None,
) -> bool:
    """Complete the card that a `fit` wrote: `command` in place of the `placeholder`, and its training data in full.

    `train` and `validation`: the data that the `fit` received, whether it named them or not, and the data of the
    general weights that it `started_from`. A card without the placeholder is from an earlier training: it is not
    changed, and the result is False. Raises WeightsError, OSError.
    """
    if placeholder.encode() not in read_bounded(path, MAX_CARD_BYTES, WeightsError):
        return False

    def replaced(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: replaced(item) for key, item in value.items()}
        return command if value == placeholder else value

    card = read_card(path)
    completed = Card.model_validate(replaced(card.model_dump())).model_copy(
        update={
            "train": _with_all(card.train, train),
            "validation": _with_all(card.validation, validation),
            "started_from": started_from or card.started_from,
        }
    )
    write_text(path, card_text(completed))
    return True


def add_thresholds(path: Path, thresholds: CardThresholds) -> None:
    """Write thresholds on the card at `path`. Raises WeightsError, OSError."""
    write_text(path, card_text(read_card(path).model_copy(update={"thresholds": thresholds})))


def _with_all(named: Iterable[TrainingData], received: Sequence[TrainingData]) -> tuple[TrainingData, ...]:
    """The data `named` on a card and all that were `received`; the latter are known in full."""
    full = {(data.recording, data.sha256): data for data in received}
    return tuple(dict.fromkeys([*(full.get((data.recording, data.sha256), data) for data in named), *received]))


def card_text(card: Card) -> str:
    """The TOML of a card."""
    return tomli_w.dumps(card.model_dump(mode="json", exclude_none=True))


def read_card(path: Path, sha256: str = "") -> Card:
    """The card at `path`. Raises WeightsError for a damaged card, and one of another schema or `sha256`."""
    try:
        text = read_bounded(path, MAX_CARD_BYTES, WeightsError)
        if sha256 and hashlib.sha256(text).hexdigest() != sha256:
            raise WeightsError(f"{path}: its sha256 is not the one in the request: the card was exchanged")
        table = parse_toml(text)
        if (schema := table.get("schema_version", CARD_SCHEMA)) != CARD_SCHEMA:
            remedy = (
                "rewrite it with gridtrack 0.2, `gridtrack trackers migrate`" if schema == 1 else "update gridtrack"
            )
            raise WeightsError(
                f"{path}: schema {schema!r:.40}; this gridtrack reads {CARD_SCHEMA}: {remedy}, or train again"
            )
        card = validated(Card, table, "weights card")
        if not card.general:
            GridSpec.parse(card.grid)
    except FileNotFoundError as error:
        raise WeightsError(f"{path}: cannot be read ({error.strerror})") from None
    except (ValueError, ConfigurationError) as error:
        raise WeightsError(f"{path}: not a weights card of gridtrack ({error})") from None
    return card


def load_weights(stream: StreamSpec, tracker: str) -> Weights:
    """The weights that `stream` names: general weights, or weights of its site.

    Raises WeightsError if damaged, or for another tracker, site, grid or period.
    """
    path = stream.weights
    if path is None:
        raise WeightsError(
            f"{tracker}: no weights for site '{stream.site}'; make them with `gridtrack train {tracker} RECORDING`"
        )
    card = read_card(path, stream.weights_sha256)
    if card.tracker != tracker:
        raise WeightsError(f"{path}: made for tracker {card.tracker}, but this is {tracker}: train for this one")
    if not card.general and card.site != stream.site:
        raise WeightsError(f"{path}: made for site {card.site}, but this is {stream.site}: train for this one")
    card = fitted_card(card, path, stream)
    return Weights(card, read_arrays(path.with_suffix(ARRAYS_SUFFIX), card.arrays_sha256))


def fitted_card(card: Card, path: Path, stream: StreamSpec) -> Card:
    """The card at `path` for the grid and period of `stream`; a general one fits any.

    If only the corner of the window differs, maps keep their place in the world. Raises WeightsError for another
    period, and for cells of another size or number, or between those of the grid.
    """
    if card.period_s is None:
        return card
    if abs(card.period_s - stream.period_s) > 1e-3 * card.period_s:
        raise WeightsError(
            f"{path}: made for a period of {card.period_s:g} s ({1 / card.period_s:g} Hz), but this stream's is"
            f" {stream.period_s:g} s: compare with --rate {1 / card.period_s:g}, or train for this rate"
        )
    made_for, grid = GridSpec.parse(card.grid), stream.grid
    if made_for == grid:
        return card
    right_m, up_m = np.subtract(made_for.origin, grid.origin).tolist()
    whole = all(
        abs(distance_m - round(distance_m / grid.cell_m) * grid.cell_m) < 1e-3 for distance_m in (right_m, up_m)
    )
    if card.world_T_grid is None or not whole or (made_for.size, made_for.cell_m) != (grid.size, grid.cell_m):
        raise WeightsError(f"{path}: made for grid {made_for}, but this is {grid}: train for this one")
    x, y = card.world_T_grid
    return card.model_copy(update={"grid": str(grid), "world_T_grid": (x + right_m, y + up_m)})


def load_start(path: Path, tracker: str) -> Weights:
    """The general weights at `path`, for a training that starts from them. Raises WeightsError if they are not."""
    card = read_card(path)
    if not card.general or card.tracker != tracker:
        raise WeightsError(f"{path}: weights of {card.tracker} for {card.site}, expected general ones of {tracker}")
    return Weights(card, read_arrays(path.with_suffix(ARRAYS_SUFFIX), card.arrays_sha256))


def read_arrays(path: Path, sha256: str) -> dict[str, NDArray[Any]]:
    """The arrays by name; none without a hash. Raises WeightsError if the file does not have this `sha256`."""
    if not sha256:
        return {}
    try:
        return load(arrays_content(path, sha256))
    except SafetensorError as error:
        raise WeightsError(f"{path}: not a safetensors file ({error})") from None


def arrays_content(path: Path, sha256: str) -> bytes:
    """The content of the file of arrays at `path`, or of its previous version, whichever has this `sha256`.

    Raises WeightsError.
    """
    with suppress(OSError):
        blob = _previous(path).read_bytes()
        if hashlib.sha256(blob).hexdigest() == sha256:
            return blob
    try:
        if path.stat().st_size > MAX_ARRAYS_BYTES:
            raise WeightsError(
                f"{path}: {path.stat().st_size} bytes; weights of more than {MAX_ARRAYS_BYTES} are refused"
            )
        blob = path.read_bytes()
    except OSError as error:
        raise WeightsError(f"{path}: cannot be read ({error.strerror})") from None
    if hashlib.sha256(blob).hexdigest() != sha256:
        raise WeightsError(f"{path}: its sha256 is not the one on its card: the file is damaged or was exchanged")
    return blob


def tuned_settings(kind: type[_Tuned], weights: Weights, given: Settings) -> _Tuned:
    """The tuned settings of the card, overridden by the options that were `given`. Raises WeightsError."""
    where = f"weights of {weights.card.tracker}, settings"
    try:
        return validated(kind, weights.card.settings | given.model_dump(exclude_unset=True), where)
    except ConfigurationError as error:
        raise WeightsError(f"{error}; train again") from None


def array(weights: Weights, name: str, shape: tuple[int, ...]) -> NDArray[Any]:
    """One array by name. Raises WeightsError unless it has this shape and is finite."""
    found = weights.arrays.get(name)
    where = f"weights of {weights.card.tracker}: array '{name}'"
    if found is None or found.shape != shape:
        actual = "missing" if found is None else f"{found.shape}"
        raise WeightsError(f"{where} is {actual}, expected {shape}; train again")
    if not np.isfinite(found).all():
        raise WeightsError(f"{where} is not finite; train again")
    return found


def probabilities(weights: Weights, name: str, shape: tuple[int, ...]) -> NDArray[Any]:
    """An `array` of probabilities. Raises WeightsError."""
    found = array(weights, name, shape)
    if found.size and not 0.0 <= found.min() <= found.max() <= 1.0:
        raise WeightsError(
            f"weights of {weights.card.tracker}: array '{name}' does not hold probabilities; train again"
        )
    return found


def cell_probabilities(weights: Weights, name: str, grid: GridSpec) -> NDArray[Any]:
    """An array of probabilities with a value per cell of `grid` (M, M); general weights have one for all cells.

    Raises WeightsError.
    """
    if not weights.card.general:
        return probabilities(weights, name, grid.shape)
    return np.full(grid.shape, probabilities(weights, name, (1, 1)))
