"""The tracker `pool`: the log odds of other trackers' forecasts, combined with weights that are fitted by log loss."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator
from scipy.special import expit

from gridtrack.common.config import Settings
from gridtrack.common.errors import ConfigurationError, WeightsError
from gridtrack.common.grid import GridFrame
from gridtrack.trackers.contract import FitTask, Forecast, FrameSource, StreamSpec, Tracker, stream_of
from gridtrack.trackers.registry import registered_name
from gridtrack.trackers.training.card import TrackerName, card_for
from gridtrack.trackers.training.excerpts import SEARCHED_S, excerpts, excerpts_of_places
from gridtrack.trackers.training.log_odds import (
    POOL_HORIZONS_S,
    SampledCells,
    combined_odds,
    fit_pool,
    log_losses,
    log_odds,
    most_per_kind,
    sampled_cells,
)
from gridtrack.trackers.training.members import Member, arrays_of, find_member, members_in, started, with_members
from gridtrack.trackers.training.weights import array, load_weights, save_interrupted, save_weights, tuned_settings

MAX_MEMBERS = 16


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
        self._members = started(members_in(weights, names), stream, PoolTracker)

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
        self._kind, self._task, self._name = kind, task, registered_name(kind)
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
        chosen = self._excerpts(self._task.train)
        parts: list[SampledCells] = []
        validation: list[SampledCells] = []
        try:
            self._sample(chosen, "place", parts)
            self._sample(self._excerpts(self._task.validation), "place of validation", validation)
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
        card = with_members(card_for(self._name, self._task, {"members": list(self._names)}, results), self._members)
        arrays = {"weights": weights.astype(np.float32), "offsets": offsets.astype(np.float32)}
        arrays |= arrays_of(self._members)
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

    def _excerpts(self, sources: Sequence[FrameSource]) -> list[FrameSource]:
        return excerpts_of_places(sources, SEARCHED_S) if self._task.general else excerpts(sources)

    def _sample(self, sources: Sequence[FrameSource], unit: str, parts: list[SampledCells]) -> None:
        """Add the cells of each source to `parts`."""
        most = most_per_kind(sources)
        with self._task.progress.stage(unit, len(sources)) as stage:
            for source in sources:
                stream = stream_of(source)
                members = started(self._members, stream, PoolTracker)
                with self._task.progress.stage("frame", len(source)) as frames:
                    parts.append(sampled_cells(members, source, most, self._draw, frames.advance))
                stage.advance()
