"""Contact foresight held against ground truth, and against forecasts that are made to win it.

`python -m studies.contact_truth` (ten minutes on two busy cores; `--out docs/results/contact.json` keeps the
tables) scores trackers with general weights on the first twenty seconds of the test worlds, twice: with ground truth,
where nothing is unknown, and by observation alone, where paths through unseen cells are left out. Does leaving them out
reverse the order of two trackers? Other rows are no trackers: they are forecasts of what is near, or unseen, made to
foresee contacts without foreseeing motion. Contacts are those within a second, paths those of two seconds. `--place
junction` takes the test recordings of the junction.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, maximum_filter

from gridtrack.common.grid import GridFrame, nearest_step
from gridtrack.evaluation.referee.referee import ScoredForecast, moments, scored_forecasts
from gridtrack.evaluation.referee.splits import EvaluationSplit, Sampling, plan_split
from gridtrack.evaluation.referee.targets import NOT_SCORED
from gridtrack.evaluation.runs.scorekeeper import facts_of
from gridtrack.evaluation.scores.contact_foresight import CONTACT_FORESIGHT, CONTACT_HORIZONS_S
from gridtrack.evaluation.scores.definition import Floats, Sums
from gridtrack.evaluation.scores.robot import SMALL_ROBOT, parse_robot
from gridtrack.evaluation.scores.thresholds import half
from gridtrack.evaluation.statistics.jackknife import IntervalEstimate, Replicates, difference, interval, replicates
from gridtrack.recordings.stream import GridStream
from gridtrack.trackers import registry
from gridtrack.trackers.contract import Forecast, Tracker, stream_of
from gridtrack.trackers.training.card import GENERAL

from studies.support.results_file import (
    ResultSection,
    ResultTable,
    measured_table,
    score_text,
    study_parser,
    write_section,
)
from studies.support.shipped import WEIGHTS, junction_tests
from studies.support.unseen_places import REFERENCE, worlds_called

COMMAND = "python -m studies.contact_truth"
TRACKERS = (REFERENCE, "stationary", "advection", "static-map", "dogma", "kalman", "factor-graph", "dilated-convgru")
PLACES: dict[str, Callable[[], Sequence[Path]]] = {"worlds": lambda: worlds_called(None), "junction": junction_tests}
HORIZON_S, EVERY_S = 1.0, 0.5
TRUTH, OBSERVED = "by truth", "by observation"
Plane = NDArray[np.float32]
Unit = Mapping[tuple[str, str], Sums]
"""Sums (P,) of a recording by TRUTH or OBSERVED, and row."""
Rows = dict[str, Replicates]


def dilated(cells: int) -> Callable[[GridFrame, Plane], Plane]:
    """Persistence in which each occupied cell fills a square of `cells` cells to each side."""
    return lambda frame, last: maximum_filter(last, 2 * cells + 1)


def nearness(frame: GridFrame, last: Plane) -> Plane:
    """exp(-distance to the last return, metres); it ranks paths by their smallest distance, whatever the scale."""
    if not frame.occupied.any():
        return np.zeros_like(last)
    return np.exp(-distance_transform_edt(~frame.occupied) / 10.0).astype(np.float32)


NO_TRACKERS: dict[str, Callable[[GridFrame, Plane], Plane]] = {
    "everything occupied": lambda frame, last: np.ones_like(last),
    "constant 0.1": lambda frame, last: np.full_like(last, 0.1),
    **{f"persistence dilated by {n}": dilated(n) for n in (1, 2, 3)},
    "nearness to the last return": nearness,
}
"""Forecasts (M, M) for every step, from the newest frame and the last observed state of each cell."""
RAISED = {name: f"{name}, unseen cells at 0.9" for name in (REFERENCE, "kalman")}
"""Trackers, and the rows of their forecasts with at least 0.9 in each cell that is not visible."""


class AllTrackers:
    """Trackers that receive the same frames. The referee pairs the forecasts of the first with what came; `made` has
    the forecasts of all."""

    def __init__(self, stream: GridStream, names: Sequence[str]) -> None:
        self._trackers = {name: tracker_of(name, stream) for name in names}
        self._frame: GridFrame
        self.made: list[dict[str, Forecast]] = []

    def reset(self, seed: int) -> None:
        """Start all trackers."""
        for tracker in self._trackers.values():
            tracker.reset(seed)

    def update(self, frame: GridFrame) -> None:
        """Give the frame to all trackers."""
        self._frame = frame
        for tracker in self._trackers.values():
            tracker.update(frame)

    def predict(self, steps: int) -> Forecast:
        """The forecast of the reference; all are added to `made`."""
        found = {name: tracker.predict(steps) for name, tracker in self._trackers.items()}
        last = found[REFERENCE].occupancy[-1]
        for name, plane in NO_TRACKERS.items():
            found[name] = Forecast(np.repeat(plane(self._frame, last)[None], steps + 1, axis=0))
        unseen = np.where(self._frame.visible, np.float32(0.0), np.float32(0.9))
        for name, row in RAISED.items():
            if name in found:
                found[row] = Forecast(np.maximum(found[name].occupancy, unseen))
        self.made.append(found)
        return found[REFERENCE]


def tracker_of(name: str, stream: GridStream) -> Tracker:
    """A tracker with its general weights, if it has any."""
    kind, card = registry.load(name), WEIGHTS / name / f"{GENERAL}.toml"
    return kind(stream_of(stream, card if card.exists() else None), kind.Options())


def as_observed(forecast: ScoredForecast) -> ScoredForecast:
    """The forecast with targets that do not know hidden cells."""
    targets = []
    for target in forecast.targets:
        state = np.where(target.frame.visible, target.state, np.uint8(NOT_SCORED))
        targets.append(replace(target, state=state))
    return replace(forecast, targets=tuple(targets))


def sums_of(split: EvaluationSplit, names: Sequence[str], robot: str) -> Unit:
    """The sums (P,) of contacts within HORIZON_S in one recording, by TRUTH or OBSERVED and row."""
    facts = facts_of(split, half(split.steps, split.strata), parse_robot(robot) if robot else SMALL_ROBOT)
    known = {TRUTH: facts, OBSERVED: replace(facts, has_truth=False, classes=())}
    at = CONTACT_FORESIGHT.steps(facts).index(nearest_step(HORIZON_S, split.test.period_s))
    trackers = AllTrackers(split.test, names)
    found: dict[tuple[str, str], Floats] = {}
    memories: dict[tuple[str, str], Any] = {}
    delivered = moments(split.test, split.regions().test)
    for scored in scored_forecasts(trackers, delivered, split.schedule, seed=0):
        both = {TRUTH: scored, OBSERVED: as_observed(scored)}
        for row, forecast in trackers.made.pop(0).items():
            for kind, own in both.items():
                memory = memories.setdefault((kind, row), CONTACT_FORESIGHT.new_memory(facts))
                counted = CONTACT_FORESIGHT.count(replace(own, forecast=forecast), known[kind], memory)
                assert counted is not None
                found[kind, row] = found.get((kind, row), 0.0) + counted[at, 0]
    parts = CONTACT_FORESIGHT.parts(facts)
    return {key: Sums(sums, parts) for key, sums in found.items()}


def pooled(units: Sequence[Unit], kind: str, output: str) -> Rows:
    """An output of each row over the recordings, and without each of them."""
    found = {}
    for row in [row for one, row in units[0] if one == kind]:
        each, total = joined(units, kind, row)
        found[row] = replicates(CONTACT_FORESIGHT.value, lambda each=each: [each], total)[output]
    return found


def joined(units: Sequence[Unit], kind: str, row: str) -> tuple[Sums, Sums]:
    """The sums (U, P) of a row in each recording, and in all (P,)."""
    sums, parts = np.stack([own[kind, row].values for own in units]), units[0][kind, row].parts
    return Sums(sums, parts), Sums(sums.sum(axis=0), parts)


def text_of(found: IntervalEstimate, *, signed: bool = False) -> str:
    """A value with its interval, if it has one."""
    return score_text(float(found.value), float(found.low), float(found.high), signed=signed)


def foreseen_table(rows: Mapping[str, Rows], names: Sequence[str]) -> ResultTable:
    """Contacts foreseen by truth and by observation alone, and the paired difference."""
    table = [
        [
            name,
            *(text_of(interval(rows[kind][name], "odds")) for kind in (TRUTH, OBSERVED)),
            text_of(difference(rows[OBSERVED][name], rows[TRUTH][name]), signed=True),
        ]
        for name in names
    ]
    return measured_table(("contacts foreseen", TRUTH, OBSERVED, "the second less the first"), table)


def reversed_pairs(rows: Mapping[str, Rows], names: Sequence[str]) -> Iterator[tuple[str, int]]:
    """The pairs with another order by observation than by truth: both differences, and how many are significant."""
    for one, other in combinations(names, 2):
        by = {kind: difference(rows[kind][one], rows[kind][other]) for kind in (TRUTH, OBSERVED)}
        if by[TRUTH].value * by[OBSERVED].value < 0.0:
            text = ", ".join(f"{text_of(found, signed=True)} {kind}" for kind, found in by.items())
            yield f"{one} less {other}: {text}", sum(bool(found.low * found.high > 0.0) for found in by.values())


def section_of(units: Sequence[Unit], command: str) -> ResultSection:
    """The tables of trackers and of other forecasts, and the pairs of trackers with another order."""
    rows = {kind: pooled(units, kind, "foreseen") for kind in (TRUTH, OBSERVED)}
    by_value = sorted(rows[TRUTH], key=lambda row: -float(rows[TRUTH][row].value))
    others = (*NO_TRACKERS, *RAISED.values())
    trackers, gaming = ([row for row in by_value if (row in others) == other] for other in (False, True))
    pairs = dict(reversed_pairs(rows, trackers))
    contacts = CONTACT_FORESIGHT.value(joined(units, TRUTH, REFERENCE)[1])["contacts"]
    return ResultSection(
        command=command,
        tables={"trackers": foreseen_table(rows, trackers), "no trackers": foreseen_table(rows, gaming)},
        values={
            "recordings": str(len(units)),
            "contacts": f"{contacts:.0f}",
            "paths left out": f"{100 * pooled(units, OBSERVED, 'unknown')[REFERENCE].value:.1f} %",
            "pairs": str(len(trackers) * (len(trackers) - 1) // 2),
            "another order": str(len(pairs)),
            "one difference is significant": "; ".join(pair for pair, told in pairs.items() if told) or "none",
            "both differences are significant": "; ".join(pair for pair, told in pairs.items() if told == 2) or "none",
            **{
                f"{row}, gain": text_of(difference(rows[OBSERVED][row], rows[OBSERVED][name]), signed=True)
                for name, row in RAISED.items()
                if row in gaming
            },
        },
    )


def main(arguments: Sequence[str] | None = None) -> None:
    parser = study_parser(__doc__, "docs/results/contact.json")
    parser.add_argument("--place", choices=PLACES, default="worlds")
    parser.add_argument("--tracker", action="append", help="default: all")
    parser.add_argument("--stretch", default="0s-20s", help="of each recording, default: %(default)s")
    parser.add_argument("--recordings", type=int, help="the first ones; default: all")
    parser.add_argument("--robot", default="", help="as of compare; default: the small robot")
    given = parser.parse_args(arguments)
    torch.set_num_threads(1)
    names, units = tuple(dict.fromkeys((REFERENCE, *(given.tracker or TRACKERS)))), []
    for path in PLACES[given.place]()[: given.recordings]:
        split = plan_split(f"{path}@{given.stretch}", None, Sampling(CONTACT_HORIZONS_S[-1], every_s=EVERY_S))
        units.append(sums_of(split, names, given.robot))
        print(f"{split.name}: done", flush=True)
    section = section_of(units, f"{COMMAND} --place {given.place}{' --robot ' * bool(given.robot)}{given.robot}")
    print(section.text())
    write_section(given.out, given.place, section)


if __name__ == "__main__":
    main()
