"""Tables of the cards: the weights that ship, and the scores of the searches at the junction.

`python -m studies.cards` (a second) writes docs/results/trackers/model-cards.json, from the cards in data/weights, and
docs/results/trackers/card-scores.json, from the searches of each tracker with each seed, also in studies/trainings.
Thresholds of these scores are the best of the stretch itself: they compare the searches of one tracker, and are no test
scores.
"""

from __future__ import annotations

import statistics
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from gridtrack.trackers.training.card import Card
from gridtrack.trackers.training.weights import read_card

from studies.support.results_file import ResultTable, measured_table, study_parser, write_table
from studies.support.shipped import WEIGHTS

COMMAND = "python -m studies.cards"
RESULTS = Path("docs/results/trackers")
SHIPPED, SCORES = "model-cards.json", "card-scores.json"
COLUMNS = ("weights", "recordings", "minutes", "labelled scans", "size, kB", "seed", "thresholds on the card")
NANOSECONDS_PER_MINUTE = 60e9

SEARCHED = "kalman", "factor-graph", "dogma"
FURTHER = Path("studies/trainings")
HORIZONS = "0.5s", "1s", "2s"
F1 = Mapping[str, Mapping[str, float]]
"""F1 by stratum and horizon."""


def shipped_table() -> ResultTable:
    """All weights that ship, by tracker and site."""
    cards = {path: read_card(path) for path in sorted(WEIGHTS.glob("*/*.toml"))}
    trained = [one for card in cards.values() for one in card.train if one.end_ns]
    known = {one.sha256: _minutes(one.start_ns, one.end_ns) for one in trained}
    rows = []
    for path, card in cards.items():
        minutes = minutes_of(card, known)
        rows.append(
            [
                f"`{card.tracker}/{card.site}`",
                str(len(card.train)),
                "" if minutes is None else f"{minutes:g}",
                labelled_scans(card.results),
                f"{sum(file.stat().st_size for file in (path, path.with_suffix('.safetensors'))) / 1000:.0f}",
                str(card.seed),
                "yes" if card.thresholds else "",
            ]
        )
    return measured_table(COLUMNS, rows)


def minutes_of(card: Card, known: Mapping[str, float]) -> float | None:
    """Minutes of training; `known` has the minutes of recordings, by their hash, that a card has without stamps."""
    minutes = [_minutes(one.start_ns, one.end_ns) or known.get(one.sha256) for one in card.train]
    return None if None in minutes else sum(one for one in minutes if one is not None)


def _minutes(start_ns: int, end_ns: int) -> float:
    return (end_ns - start_ns) / NANOSECONDS_PER_MINUTE


def labelled_scans(results: Mapping[str, Any]) -> str:
    """The number of labelled scans that a tracker or its class decoder learned from; empty without labels."""
    classes = results.get("classes")
    named = results.get("labelled") or (classes.get("labelled") if isinstance(classes, dict) else None)
    words: Sequence[str] = str(named or "").replace(",", " ").split()
    return next((before for before, word in pairwise(words) if word == "scans"), "")


def searches_of(tracker: str) -> Iterator[Card]:
    """The cards of one tracker for the junction, by seed."""
    paths = (folder / tracker / "junction.toml" for folder in [WEIGHTS, *sorted(FURTHER.glob("seed-*"))])
    yield from sorted((read_card(path) for path in paths if path.exists()), key=lambda card: card.seed)


def mean_f1(card: Card, use: str) -> F1:
    """F1, mean over the stretches of `use`: `train` (the excerpts of the search) or `validation`."""
    stretches: list[dict[str, Any]] = card.results[use]
    return {
        name: {at: statistics.fmean(one[f"{name}_f1"][at] for one in stretches) for at in HORIZONS}
        for name in ("dynamic", "visible")
    }


def objective(f1: F1) -> float:
    """The mean over strata and horizons, which a search maximises."""
    return statistics.fmean(value for by_horizon in f1.values() for value in by_horizon.values())


def search_table(tracker: str) -> ResultTable:
    """The searches of one tracker: mean F1 on the excerpts, and scores on validation."""
    rows = []
    for card in searches_of(tracker):
        trained, validated = (mean_f1(card, use) for use in ("train", "validation"))
        values = objective(trained), objective(validated), *validated["dynamic"].values()
        rows.append([f"seed {card.seed}", *(f"{value:.3f}" for value in values)])
    dynamic = (f"dynamic {at.removesuffix('s')} s" for at in HORIZONS)
    return measured_table((tracker, "mean F1 on the excerpts", "validation: mean F1", *dynamic), rows)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = study_parser(__doc__)
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder of the results, default: %(default)s")
    out = parser.parse_args(arguments).out
    tables = {"shipped": shipped_table(), **{name: search_table(name) for name in SEARCHED}}
    for name, table in tables.items():
        print(table.markdown(), end="\n\n")
        write_table(out / (SHIPPED if name == "shipped" else SCORES), name, table, COMMAND)


if __name__ == "__main__":
    main()
