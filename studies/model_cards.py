"""The weights that ship, as a table: what each was learned from, its size and its seed.

`python -m studies.model_cards --out docs/results/trackers/model-cards.json` (a second) reads the cards in data/weights.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from gridtrack.trackers.training.card import Card
from gridtrack.trackers.training.weights import read_card

from studies.support.results_file import ResultTable, measured_table, write_table
from studies.support.shipped import WEIGHTS

COMMAND = "python -m studies.model_cards"
HEADER = ("weights", "recordings", "minutes", "labelled scans", "size, kB", "seed", "thresholds on the card")
NANOSECONDS_PER_MINUTE = 60e9


def minutes_of(card: Card, known: Mapping[str, float]) -> float | None:
    """Minutes of training; those of cards without stamps are the ones `known` of the same recordings."""
    minutes = [_minutes(one.start_ns, one.end_ns) or known.get(one.sha256) for one in card.train]
    return None if None in minutes else sum(one for one in minutes if one is not None)


def _minutes(start_ns: int, end_ns: int) -> float:
    return (end_ns - start_ns) / NANOSECONDS_PER_MINUTE


def labelled_scans(results: Mapping[str, Any]) -> str:
    """The number of labelled scans that a tracker or its class decoder learned from, "" without any."""
    classes = results.get("classes")
    named = results.get("labelled") or (classes.get("labelled") if isinstance(classes, dict) else None)
    words: Sequence[str] = str(named or "").replace(",", " ").split()
    return next((before for before, word in pairwise(words) if word == "scans"), "")


def rows() -> Iterator[list[str]]:
    """A row for each card, by tracker and site."""
    cards = {path: read_card(path) for path in sorted(WEIGHTS.glob("*/*.toml"))}
    trained = [one for card in cards.values() for one in card.train if one.end_ns]
    known = {one.sha256: _minutes(one.start_ns, one.end_ns) for one in trained}
    for path, card in cards.items():
        minutes = minutes_of(card, known)
        yield [
            f"`{card.tracker}/{card.site}`",
            str(len(card.train)),
            "" if minutes is None else f"{minutes:g}",
            labelled_scans(card.results),
            f"{sum(file.stat().st_size for file in (path, path.with_suffix('.safetensors'))) / 1000:.0f}",
            str(card.seed),
            "yes" if card.thresholds else "",
        ]


def table() -> ResultTable:
    """The table of all weights that ship."""
    return measured_table(HEADER, list(rows()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, help="results file for the table")
    shown = table()
    print(shown.markdown())
    write_table(parser.parse_args().out, "shipped", shown, COMMAND)


if __name__ == "__main__":
    main()
