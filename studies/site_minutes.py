"""How many minutes of recordings close the gap between general weights and the weights of a site?

`python -m studies.site_minutes` takes the junction as an unseen place. Each tracker is trained from its general weights
on the first 1, 5, 15 and 65 minutes of data/junction/train.tracks, and compared on the twenty test minutes with its
general weights (0 minutes) and with the weights that ship for the site. Complete trainings in `--trainings` are kept;
interrupted ones resume, and so does the comparison. Thresholds are chosen on the junction's validation recording for
every row, so that rows differ only in their weights; the general row is compared once more with the thresholds of its
card, which know nothing of the place. Each tracker has its own comparison and results. On two idle cores a search of
`kalman` takes about 15 minutes for each number of minutes, of `dogma` 10, a network 40 (the number of updates is
fixed), and the comparison of a tracker 40: six hours in all.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from gridtrack.trackers.training.card import GENERAL

from studies.support.comparison import RECORDINGS, VALIDATION, compare, train
from studies.support.results_file import ResultSection, ResultTable, measured_table, study_parser, write_section
from studies.support.unseen_places import REFERENCE, WEIGHTS, PlaceScores

TRAINING, SITE = RECORDINGS / "train.tracks", "junction"
TRACKERS = ("kalman", "dogma", "dilated-convgru")
MINUTES = (1, 5, 15, 65)
OUT, TRAININGS = Path("runs/site-minutes"), Path("studies/trainings/site-minutes")
RESULTS = Path("docs/results/worlds/site_minutes.json")
COMMAND = "python -m studies.site_minutes"
SITE_THRESHOLDS, CARD_THRESHOLDS = "site-thresholds", "card-thresholds"
"""The folders of the comparisons of a tracker."""
LEAST_GAP = 0.01
"""A smaller gap in F1 is within the intervals of both, and a share of it is noise."""


def weights_after(tracker: str, minutes: int, trainings: Path) -> Path:
    """The card of a training on this number of minutes."""
    return trainings / f"minutes-{minutes}" / tracker / f"{SITE}.toml"


def rows_of(tracker: str, minutes: Sequence[int], general: Path, trainings: Path) -> dict[str, str]:
    """The rows of a tracker as values of `--tracker` by label: general weights, each training, weights of the site."""
    chosen = {f"{tracker}-general": f"weights={general},card={GENERAL}"}
    trained = {n: weights_after(tracker, n, trainings).parents[1] for n in minutes}
    chosen |= {f"{tracker}-{n}-min": f"weights={folder},card=site" for n, folder in trained.items()}
    chosen[f"{tracker}-site"] = f"weights={WEIGHTS},card=site"
    return {label: f"{label}={tracker}:{weights}" for label, weights in chosen.items()}


def train_missing(tracker: str, minutes: Sequence[int], general: Path, trainings: Path) -> None:
    """Train the tracker on each number of minutes, if there is no complete training."""
    for number in minutes:
        chosen = ("--validation", VALIDATION, "--weights", general)
        train(weights_after(tracker, number, trainings), tracker, f"{TRAINING}@0s-{60 * number}s", *chosen)


def run(rows: Mapping[str, str], general: str, out: Path, options: Sequence[str]) -> None:
    """Compare on the test minutes with thresholds of the site, and the `general` row also with its card's."""
    tests = sorted(RECORDINGS.glob("test-*.tracks"))
    compare(tests, VALIDATION, [REFERENCE, *rows.values()], out / SITE_THRESHOLDS, "--resume", *options)
    compare(tests, None, [REFERENCE, rows[general]], out / CARD_THRESHOLDS, "--resume", *options)


def gap_closed(scores: PlaceScores, tracker: str, minutes: Sequence[int]) -> ResultTable:
    """The closed share of the gap in dynamic F1 between general and site weights by minutes, per cent."""
    rows = []
    for horizon_s in scores.horizons:
        f1 = {label: scores.at(label, "dynamic", "f1", horizon_s).value for label in scores.summary.trackers}
        start, end = f1[f"{tracker}-general"], f1[f"{tracker}-site"]
        shares = [share_closed(start, f1[f"{tracker}-{number}-min"], end) for number in minutes]
        rows.append([f"{horizon_s:g} s", *shares])
    return measured_table(("of the gap, %", *(f"{number} min" for number in minutes)), rows)


def share_closed(start: float | None, now: float | None, end: float | None) -> str:
    """The closed share of the gap from `start` to `end`, per cent; empty if the gap is below LEAST_GAP."""
    if start is None or now is None or end is None or end - start < LEAST_GAP:
        return ""
    return f"{100 * (now - start) / (end - start):.0f}"


def section_of(site: PlaceScores, cards: PlaceScores, tracker: str, minutes: Sequence[int]) -> ResultSection:
    """The results of a tracker."""
    tables = {
        "F1": site.over_horizons("F1, dynamic", "dynamic", "f1"),
        "PR-AUC": site.over_horizons("PR-AUC, dynamic", "dynamic", "pr_auc"),
        "hidden": site.over_horizons("F1, hidden", "occluded", "f1"),
        "thresholds of the card": cards.over_horizons("F1, dynamic", "dynamic", "f1"),
        "gap": gap_closed(site, tracker, minutes),
    }
    return ResultSection(command=COMMAND, tables=tables)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = study_parser(__doc__)
    parser.add_argument("--tracker", action="append", choices=TRACKERS, help="default: all three")
    parser.add_argument("--minutes", type=int, action="append", help="default: 1, 5, 15 and 65")
    parser.add_argument("--weights", type=Path, default=WEIGHTS, help="folder of the general weights")
    parser.add_argument("--every", default="1s", help="between two scored forecasts")
    parser.add_argument("--trainings", type=Path, default=TRAININGS, help="folder of weights, default: %(default)s")
    parser.add_argument("--out", type=Path, default=OUT, help="folder of the comparisons, default: %(default)s")
    parser.add_argument("--results", type=Path, default=RESULTS, help="results file, default: %(default)s")
    parser.add_argument("--jobs", default="1", help="trials at the same time")
    parser.add_argument("--collect", action="store_true", help="run nothing; write the results of finished comparisons")
    given = parser.parse_args(arguments)
    minutes = given.minutes or MINUTES
    for tracker in given.tracker or TRACKERS:
        out = given.out / tracker
        if not given.collect:
            train_missing(tracker, minutes, given.weights, given.trainings)
            rows = rows_of(tracker, minutes, given.weights, given.trainings)
            run(rows, f"{tracker}-general", out, ["--every", given.every, "--jobs", given.jobs])
        site, cards = (PlaceScores.read(out / name) for name in (SITE_THRESHOLDS, CARD_THRESHOLDS))
        section = section_of(site, cards, tracker, minutes)
        write_section(given.results, tracker, section)
        print(section.text(), end="\n\n")


if __name__ == "__main__":
    main()
