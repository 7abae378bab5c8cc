"""The tracker `pool`: the log odds of other trackers' forecasts, combined with weights that are fitted by log loss.

Its card carries the cards of the members that learn, and its arrays their files of arrays, byte by byte; the data that
they were trained on stands with its own. Nothing else is read to start them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator
from scipy.special import expit

from gridtrack.common.config import Settings, validated
from gridtrack.common.errors import ConfigurationError, WeightsError
from gridtrack.common.files import sha256_of
from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, shift_between
from gridtrack.trackers import registry
from gridtrack.trackers.contract import FitTask, Forecast, FrameSource, StreamSpec, Tracker, stream_of
from gridtrack.trackers.registry import registered_name
from gridtrack.trackers.stationary import frames_between, horizon_steps, observed_later
from gridtrack.trackers.training.card import GENERAL, Card, TrackerName, card_for
from gridtrack.trackers.training.excerpts import searched_excerpts
from gridtrack.trackers.training.log_odds import (
    POOL_HORIZONS_S,
    Odds,
    SampledCells,
    combined_odds,
    fit_pool,
    log_losses,
    log_odds,
    sample,
)
from gridtrack.trackers.training.weights import (
    ARRAYS_SUFFIX,
    array,
    arrays_content,
    card_text,
    load_weights,
    read_card,
    save_interrupted,
    save_weights,
    tuned_settings,
)

MAX_MEMBERS = 16
MEMBER_PREFIX = "members/"
"""The name of a member's file of arrays, as an array of bytes: MEMBER_PREFIX and the name of the member."""
SAMPLED, MOST_SAMPLED = 200, 4_000_000
"""Cells of each kind, likely occupied and not, that are sampled at each horizon of a forecast, and most in total."""


class PoolOptions(Settings):
    """The trackers that are combined; a training names them, and the card lists them."""

    members: Annotated[tuple[TrackerName, ...], Field(max_length=MAX_MEMBERS)] = ()
    """Names of registered trackers, such as [kalman,dogma]; each runs with its default options."""

    @field_validator("members", mode="before")
    @classmethod
    def _listed(cls, value: Any) -> Any:
        """`[kalman,dogma]` without quotes, as the command line has it."""
        if isinstance(value, str):
            return tuple(name.strip() for name in value.removeprefix("[").removesuffix("]").split(","))
        return value

    @field_validator("members")
    @classmethod
    def _differ(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        if len(set(names)) != len(names):
            raise ValueError("a member is named twice")
        return names


@dataclass(frozen=True, slots=True)
class Member:
    """A member: its registered name, and the card and the file of arrays of its weights, if it learns."""

    name: str
    card: Card | None = None
    arrays: bytes = b""


def find_member(name: str, folder: Path, site: str) -> Member:
    """The tracker `name` with its weights in `folder`: of the site, else general ones.

    Raises PluginError for an unknown tracker, ConfigurationError without weights, WeightsError for damaged ones.
    """
    if not registry.load(name).learns:
        return Member(name)
    paths = [folder / name / f"{one}.toml" for one in dict.fromkeys((site, GENERAL))]
    path = next((path for path in paths if path.is_file()), None)
    if path is None:
        general = " --general" if site == GENERAL else ""
        raise ConfigurationError(
            f"{paths[0]}: missing, and {name} is to be a member: train it first, with `gridtrack train {name}"
            f" RECORDING...{general} --out {folder}`, or copy its weights there"
        )
    card = read_card(path)
    if card.tracker != name:
        raise WeightsError(f"{path}: made for tracker {card.tracker}, but this is {name}: train for this one")
    sha256 = card.arrays_sha256
    return Member(name, card, arrays_content(path.with_suffix(ARRAYS_SUFFIX), sha256) if sha256 else b"")


class RunningMembers:
    """Members on one stream."""

    def __init__(self, trackers: Sequence[Tracker], stream: StreamSpec) -> None:
        self.trackers, self._stream = trackers, stream
        self._still = [registry.registered_name(type(one)) for one in trackers if not one.moving_sensor]
        self.reset(seed=0)

    def reset(self, seed: int) -> None:
        """Reset each member with the same seed."""
        for tracker in self.trackers:
            tracker.reset(seed)
        self._window: SE2 | None = None

    def update(self, frame: GridFrame) -> None:
        """Update each member. Raises ConfigurationError if the sensor moves and a member does not follow it."""
        shift = shift_between(self._window or frame.world_T_grid, frame.world_T_grid, self._stream.grid.cell_m)
        if shift and self._still:
            raise ConfigurationError(
                f"the sensor moves, and the member {self._still[0]} does not follow it: train a pool without"
                f" {', '.join(self._still)}"
            )
        self._window = frame.world_T_grid
        for tracker in self.trackers:
            tracker.update(frame)

    def probabilities(self, steps: int) -> NDArray[np.float32]:
        """P(occupied) (N, steps+1, M, M) by each of the N members."""
        return np.stack([tracker.predict(steps).occupancy for tracker in self.trackers])


def started(members: Iterable[Member], stream: StreamSpec) -> RunningMembers:
    """The members on `stream`, with their default options.

    Their weights lie in a temporary folder until all of them are made. Raises PluginError, WeightsError and
    ConfigurationError, which name the member.
    """
    trackers = []
    with TemporaryDirectory(prefix="gridtrack-members-") as folder:
        for member in members:
            kind = registry.load(member.name)
            if kind.role == "recorded" or issubclass(kind, PoolTracker):
                what = "it reads forecasts from a file" if kind.role == "recorded" else "it has members itself"
                raise ConfigurationError(f"{member.name} cannot be a member: {what}")
            own = replace(stream, weights=None, weights_sha256="", velocity_scored=False)
            if member.card is not None:
                path = Path(folder) / f"{member.name}.toml"
                path.write_text(card_text(member.card))
                if member.arrays:
                    path.with_suffix(ARRAYS_SUFFIX).write_bytes(member.arrays)
                own = replace(own, weights=path, weights_sha256=sha256_of(path))
            try:
                trackers.append(kind(own, validated(kind.Options, {}, member.name)))
            except WeightsError as error:
                raise WeightsError(f"member {member.name}: {error}") from None
    return RunningMembers(trackers, stream)


class PoolTracker(Tracker):
    """Combines the forecasts of other trackers: sigmoid(offset + sum of weight times log odds), by horizon.

    Occupancy only. It costs the time and the memory of its members together.
    """

    Options = PoolOptions
    moving_sensor = True
    learns = True
    learns_general = True

    def __init__(self, stream: StreamSpec, options: PoolOptions) -> None:
        """Raises WeightsError without weights or for damaged ones, ConfigurationError for other members than theirs."""
        super().__init__(stream, options)
        weights = load_weights(stream, registered_name(type(self)))
        names = tuned_settings(PoolOptions, weights, Settings()).members
        if not names:
            raise WeightsError(f"{stream.weights}: it names no members; train again")
        if options.members and options.members != names:
            raise ConfigurationError(
                f"{stream.weights}: its members are {', '.join(names)}: train again for others, or leave `members` out"
            )
        shape = (len(POOL_HORIZONS_S),)
        self._weights, self._offsets = array(weights, "weights", (*shape, len(names))), array(weights, "offsets", shape)
        if (self._weights < 0.0).any():
            raise WeightsError(f"{stream.weights}: a weight is negative; train again")
        cards, files = weights.card.members or {}, weights.arrays
        arrays = {name: files[key].tobytes() for name in names if (key := MEMBER_PREFIX + name) in files}
        members = [Member(name, cards.get(name), arrays.get(name, b"")) for name in names]
        self._members = started(members, stream)

    @property
    def device(self) -> str:
        """The name of the first device on which a member computes."""
        return next(filter(None, (member.device for member in self._members.trackers)), "")

    @property
    def recoveries(self) -> int:
        """The recoveries of all members."""
        return sum(member.recoveries for member in self._members.trackers)

    def reset(self, seed: int) -> None:
        """Reset each member with the same seed."""
        self._members.reset(seed)

    def update(self, frame: GridFrame) -> None:
        """Update each member. Raises ConfigurationError if the sensor moves and a member does not follow it."""
        self._members.update(frame)

    def predict(self, steps: int) -> Forecast:
        """Combine the forecasts of the members with the weights of each horizon."""
        horizons_s = np.arange(steps + 1) * self.stream.period_s
        weights = np.array([np.interp(horizons_s, POOL_HORIZONS_S, one) for one in self._weights.T], np.float32)
        offsets = np.interp(horizons_s, POOL_HORIZONS_S, self._offsets).astype(np.float32)
        odds = log_odds(self._members.probabilities(steps))
        combined = np.einsum("ns,nsij->sij", weights, odds) + offsets[:, None, None]
        return Forecast(expit(combined))

    @classmethod
    def fit(cls, task: FitTask) -> None:
        """Fit the weights on excerpts of `task.train`; the weights of the members lie in the folder of `task.out`.

        Raises ConfigurationError without members, and for a member without weights.
        """
        PoolFit(cls, task).run()


class PoolFit:
    """The training of a pool."""

    def __init__(self, kind: type[PoolTracker], task: FitTask) -> None:
        """Finds the members' weights. Raises ConfigurationError, PluginError, WeightsError."""
        self._task, self._name = task, registered_name(kind)
        self._names: tuple[str, ...] = task.options.members
        if not self._names:
            raise ConfigurationError(
                f"{self._name}: name its members, as in `gridtrack train {self._name}:members=[kalman,dogma] ...`"
            )
        folder, site = task.out.parents[1], task.out.stem
        self._members = [find_member(name, folder, site) for name in self._names]
        self._draw = np.random.default_rng(task.seed)
        for member in self._members:
            task.report(self._described(member))

    def _described(self, member: Member) -> str:
        """The weights of a member, and how much of the training it has seen, in a line."""
        if member.card is None:
            return f"member {member.name}: nothing to learn"
        seen = {(data.recording, data.sha256) for data in member.card.train}
        again = sum((source.name, source.sha256) in seen for source in self._task.train)
        line = f"member {member.name}: {'general' if member.card.general else 'site'} weights"
        if not again:
            return line
        return (
            f"{line}, trained on {again} of these {len(self._task.train)} stretches: it is better there than elsewhere"
        )

    def run(self) -> None:
        """Fit, report the log loss on validation, and write the card. After Ctrl-C it has the places so far."""
        chosen = searched_excerpts(self._task.train, general=self._task.general)
        parts: list[SampledCells] = []
        validation: list[SampledCells] = []
        try:
            self._sample(chosen, "place", parts)
            held_out = searched_excerpts(self._task.validation, general=self._task.general)
            self._sample(held_out, "place of validation", validation)
        except KeyboardInterrupt:
            if parts:
                self._write(parts, [], f"place {len(parts)} of {len(chosen)}")
            raise
        self._write(parts, validation)

    def _write(self, parts: Sequence[SampledCells], validation: Sequence[SampledCells], reached: str = "") -> None:
        """Fit the weights on these cells, and write the card; `reached`: where it was interrupted."""
        weights, offsets = fit_pool(SampledCells.together(parts))
        results = (
            {"validation": self._scores(SampledCells.together(validation), weights, offsets)} if validation else {}
        )
        card = card_for(self._name, self._task, {"members": list(self._names)}, results)
        cards = {member.name: member.card for member in self._members if member.card is not None}
        bare: dict[str, Any] = {"train": (), "validation": (), "thresholds": None, "results": {}}
        update: dict[str, Any] = {"members": {name: one.model_copy(update=bare) for name, one in cards.items()}}
        for data in ("train", "validation"):
            update[data] = tuple(dict.fromkeys(chain(*(getattr(one, data) for one in (card, *cards.values())))))
        card = card.model_copy(update=update)
        arrays: dict[str, NDArray[Any]] = {
            "weights": weights.astype(np.float32),
            "offsets": offsets.astype(np.float32),
        }
        for member in self._members:
            if member.arrays:
                arrays[MEMBER_PREFIX + member.name] = np.frombuffer(member.arrays, np.uint8)
        if reached:
            save_interrupted(self._task.out, card, arrays, reached)
        else:
            save_weights(self._task.out, card, arrays)

    def _scores(self, cells: SampledCells, weights: NDArray[Any], offsets: NDArray[Any]) -> dict[str, dict[str, float]]:
        """The log loss of each member and of the pool by horizon, on validation; reported too."""
        columns = dict(zip(self._names, cells.odds.T, strict=True)) | {
            "mean": cells.odds.mean(axis=1),
            self._name: combined_odds(cells, weights, offsets),
        }
        scores = {}
        for name, combined in columns.items():
            losses = log_losses(cells, combined)
            known = np.flatnonzero(np.isfinite(losses))
            scores[name] = {f"{POOL_HORIZONS_S[k]:g}s": round(float(losses[k]), 6) for k in known}
            values = ", ".join(f"{loss:.5f} at {horizon}" for horizon, loss in scores[name].items())
            self._task.report(f"log loss on validation, {name}: {values}")
        return scores

    def _sample(self, sources: Sequence[FrameSource], unit: str, parts: list[SampledCells]) -> None:
        """Add the cells of each source to `parts`, at most MOST_SAMPLED in total."""
        forecasts = sum(len(source) // frames_between(source) for source in sources)
        most = max(1, min(SAMPLED, MOST_SAMPLED // (2 * len(POOL_HORIZONS_S) * max(forecasts, 1))))
        with self._task.progress.stage(unit, len(sources)) as stage:
            for source in sources:
                parts.append(self._sampled(source, most))
                stage.advance()

    def _sampled(self, source: FrameSource, most: int) -> SampledCells:
        """Cells of the forecasts of the members on one source, about `most` of each kind; maybe none.

        A horizon that is nearer to the present than to the first step is left out.
        """
        members, steps = started(self._members, stream_of(source)), horizon_steps(POOL_HORIZONS_S, source)
        parts = [SampledCells.empty(len(members.trackers))]
        with self._task.progress.stage("frame", len(source)) as frames:

            def observe(frame: GridFrame) -> None:
                members.update(frame)
                frames.advance()

            def forecast() -> Odds:
                return log_odds(members.probabilities(max(steps))[:, steps])

            for odds, horizons, (visible, occupied) in observed_later(source, POOL_HORIZONS_S, observe, forecast):
                parts += [sample(odds[:, k], k, visible, occupied, most, self._draw) for k in horizons if steps[k] > 0]
        return SampledCells.together(parts)
