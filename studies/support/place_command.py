"""The command line of a study that compares the trackers with general weights at unseen places."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path

from studies.support.comparison import compare
from studies.support.results_file import ResultSection, write_section
from studies.support.scale_charts import scale_charts
from studies.support.unseen_places import TRAININGS, WEIGHTS, PlaceScores, general_rows


def place_parser(documentation: str | None, out: Path, results: Path) -> argparse.ArgumentParser:
    """The options that such studies have in common; `out` is the folder of the run."""
    parser = argparse.ArgumentParser(description=(documentation or "").partition("\n")[0])
    parser.add_argument("--tracker", action="append", help="the label of a row that can run; default: all of them")
    parser.add_argument("--weights", type=Path, default=WEIGHTS, help="folder of the general weights")
    parser.add_argument("--trainings", type=Path, default=TRAININGS, help="folder of seed-2, seed-3, ...")
    parser.add_argument("--every", default="1s", help="between two scored forecasts")
    parser.add_argument("--out", type=Path, default=out)
    parser.add_argument("--results", type=Path, default=results)
    parser.add_argument("--jobs", default="1", help="trials at the same time")
    parser.add_argument("--collect", action="store_true", help="run nothing; write the results of what has run")
    return parser


WORLDS = Path("data/worlds/test")


def worlds_called(names: Sequence[str] | None) -> list[Path]:
    """The test worlds of these names, None: all of them. Ends the program for a name that none has."""
    worlds = {path.stem: path for path in sorted(WORLDS.glob("*.tracks"))}
    if unknown := [name for name in names or () if name not in worlds]:
        raise SystemExit(f"--world {', '.join(unknown)}: no such world; there are {', '.join(worlds)}")
    return [worlds[name] for name in names or worlds]


def compare_places(given: argparse.Namespace, recordings: Sequence[Path], out: Path) -> None:
    """Compare the rows that are asked for on `recordings`, with the thresholds of the cards; the run is in `out`."""
    rows = general_rows(given.weights, given.trainings)
    if unknown := [label for label in given.tracker or () if label not in rows]:
        raise SystemExit(f"--tracker {', '.join(unknown)}: no row that can run; there are {', '.join(rows)}")
    chosen = [rows[label] for label in given.tracker or rows]
    compare(recordings, None, chosen, out, "--every", given.every, "--jobs", given.jobs, "--resume")


def write_places(results: Path, scores: PlaceScores, sections: Mapping[str, ResultSection]) -> None:
    """Write and print the sections of a results file, and the drawing of the scores beside it."""
    for name, section in sections.items():
        write_section(results, name, section)
        print("\n\n".join(table.markdown() for table in section.tables.values()), end="\n\n")
    results.with_name("scales.svg").write_text(scale_charts(scores, "dynamic"), "utf-8")
