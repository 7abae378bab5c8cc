"""How many minutes of recordings of a site close the gap between general weights and those of the site.

`python -m studies.site_minutes` takes the junction as a place that general weights never saw. Each tracker is trained
there from its general weights on the first 1, 5, 15 and 65 minutes of data/junction/train.tracks, and compared on the
twenty test minutes with its general weights (0 minutes) and with those shipped for the site. Trainings that exist in
`--trainings` are kept and an interrupted one is resumed, as is the comparison. Thresholds are chosen on the junction's
validation recording for every row, so that rows differ in what they learned; the general rows are compared once more
with the thresholds of their cards, which know nothing of the place. Expected on two idle cores: a search of `kalman`
about 15 minutes at each number of minutes, of `dogma` 10, a network 40 (the number of updates does not depend on the
minutes), the comparisons 40 together: some five hours.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path

from gridtrack.trackers.card import GENERAL

from studies.support.comparison import RECORDINGS, VALIDATION, compare, train
from studies.support.results_file import ResultSection, ResultTable, measured_table, write_section
from studies.support.unseen_places import REFERENCE, WEIGHTS, PlaceScores

TRAINING, SITE = RECORDINGS / "train.tracks", "junction"
TRACKERS = ("kalman", "dogma", "dilated-convgru")
MINUTES = (1, 5, 15, 65)
RESULTS = Path("docs/results/worlds/site_minutes.json")
COMMAND = "python -m studies.site_minutes"
LEAST_GAP = 0.01
"""Of F1 between general and site weights: a smaller one is within the intervals of both, and a share of it noise."""


def weights_after(tracker: str, minutes: int, trainings: Path) -> Path:
    """The card of a training on so many minutes."""
    return trainings / f"minutes-{minutes}" / tracker / f"{SITE}.toml"


def rows_of(tracker: str, minutes: Sequence[int], general: Path, trainings: Path) -> dict[str, str]:
    """The rows of a tracker as `--tracker` names them, by label: general, after each training, and of the site."""
    chosen = {f"{tracker}-general": f"weights={general},card={GENERAL}"}
    trained = {n: weights_after(tracker, n, trainings).parents[1] for n in minutes}
    chosen |= {f"{tracker}-{n}-min": f"weights={folder},card=site" for n, folder in trained.items()}
    chosen[f"{tracker}-site"] = f"weights={WEIGHTS},card=site"
    return {label: f"{label}={tracker}:{weights}" for label, weights in chosen.items()}


def train_missing(trackers: Sequence[str], minutes: Sequence[int], general: Path, trainings: Path) -> None:
    """Train each tracker on each number of minutes, where no complete training is there."""
    for tracker in trackers:
        for number in minutes:
            chosen = ("--validation", VALIDATION, "--weights", general)
            train(weights_after(tracker, number, trainings), tracker, f"{TRAINING}@0s-{60 * number}s", *chosen)


def run(
    trackers: Sequence[str],
    minutes: Sequence[int],
    general: Path,
    trainings: Path,
    out: Path,
    options: Sequence[str],
) -> None:
    """Compare on the test minutes with the thresholds of the site, and with the cards'."""
    tests = sorted(RECORDINGS.glob("test-*.tracks"))
    every = [row for tracker in trackers for row in rows_of(tracker, minutes, general, trainings).values()]
    compare(tests, VALIDATION, [REFERENCE, *every], out / "site-thresholds", "--resume", *options)
    unseen = [rows_of(tracker, (), general, trainings)[f"{tracker}-general"] for tracker in trackers]
    compare(tests, None, [REFERENCE, *unseen], out / "card-thresholds", "--resume", *options)


def gap_closed(scores: PlaceScores, trackers: Sequence[str], minutes: Sequence[int]) -> ResultTable:
    """The share of the gap in dynamic F1 between general and site weights that so many minutes close, per cent."""
    rows = []
    for tracker in trackers:
        for horizon_s, step in scores.horizons.items():
            f1 = {label: scores.strata[label]["dynamic"].f1[step] for label in scores.strata}
            start, end = f1[f"{tracker}-general"], f1[f"{tracker}-site"]
            shares = [share_closed(start, f1[f"{tracker}-{number}-min"], end) for number in minutes]
            rows.append([f"{tracker}, {horizon_s:g} s", *shares])
    return measured_table(("of the gap, %", *(f"{number} min" for number in minutes)), rows)


def share_closed(start: float | None, now: float | None, end: float | None) -> str:
    """How far `now` is from `start` to `end`, per cent; empty where there is no gap of LEAST_GAP to close."""
    if start is None or now is None or end is None or end - start < LEAST_GAP:
        return ""
    return f"{100 * (now - start) / (end - start):.0f}"


def sections_of(
    site: PlaceScores, cards: PlaceScores, trackers: Sequence[str], minutes: Sequence[int]
) -> Mapping[str, ResultSection]:
    """The sections of the results file."""
    tables = {
        "F1": site.over_horizons("F1, dynamic", "dynamic", "f1"),
        "PR-AUC": site.over_horizons("PR-AUC, dynamic", "dynamic", "pr_auc"),
        "hidden": site.over_horizons("F1, hidden", "occluded", "f1"),
        "thresholds of the cards": cards.over_horizons("F1, dynamic", "dynamic", "f1"),
        "gap": gap_closed(site, trackers, minutes),
    }
    return {"minutes": ResultSection(command=COMMAND, tables=tables)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--tracker", action="append", choices=TRACKERS, help="default: all three")
    parser.add_argument("--minutes", type=int, action="append", help="default: 1, 5, 15 and 65")
    parser.add_argument("--weights", type=Path, default=WEIGHTS, help="folder of the general weights")
    parser.add_argument("--every", default="1s", help="between two scored forecasts")
    parser.add_argument("--trainings", type=Path, default=Path("studies/trainings/site-minutes"))
    parser.add_argument("--out", type=Path, default=Path("runs/site-minutes"))
    parser.add_argument("--results", type=Path, default=RESULTS)
    parser.add_argument("--jobs", default="1", help="trials at the same time")
    parser.add_argument("--collect", action="store_true", help="run nothing; write the results of what has run")
    given = parser.parse_args()
    trackers, minutes = given.tracker or TRACKERS, given.minutes or MINUTES
    if not given.collect:
        train_missing(trackers, minutes, given.weights, given.trainings)
        options = ["--every", given.every, "--jobs", given.jobs]
        run(trackers, minutes, given.weights, given.trainings, given.out, options)
    site, cards = (PlaceScores.read(given.out / name) for name in ("site-thresholds", "card-thresholds"))
    for name, section in sections_of(site, cards, trackers, minutes).items():
        write_section(given.results, name, section)
        print("\n\n".join(table.markdown() for table in section.tables.values()))


if __name__ == "__main__":
    main()
