"""The table of the weights that ship.

`python -m studies.cards` (a second) writes docs/results/trackers/model-cards.json from the cards in data/weights.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from gridtrack.trackers.training.card import Card
from gridtrack.trackers.training.weights import read_card

from studies.support.results_file import ResultTable, measured_table, study_parser, write_table
from studies.support.shipped import WEIGHTS

COMMAND = "python -m studies.cards"
RESULTS = Path("docs/results/trackers/model-cards.json")
COLUMNS = ("weights", "recordings", "minutes", "labelled scans", "size, kB", "seed", "thresholds on the card")
NANOSECONDS_PER_MINUTE = 60e9


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


def main(arguments: Sequence[str] | None = None) -> None:
    parser = study_parser(__doc__)
    parser.add_argument("--out", type=Path, default=RESULTS, help="results file, default: %(default)s")
    out = parser.parse_args(arguments).out
    table = shipped_table()
    print(table.markdown())
    write_table(out, "shipped", table, COMMAND)


if __name__ == "__main__":
    main()
