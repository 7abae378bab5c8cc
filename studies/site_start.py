"""A short training at a site, from general weights and from scratch, beside the general weights.

`python -m studies.site_start` (half an hour of a core) trains in both ways on the training stretch of the hall, 75 s,
and scores all three on the validation stretch, which both trainings used to choose between candidates, and on the test
stretch, which is new to them. Thresholds are chosen on the training stretch for every row. Complete trainings in
`--out` are kept.
"""

from __future__ import annotations

import resource
from collections.abc import Sequence
from pathlib import Path

from gridtrack.evaluation.runs.summary import RunSummary, read_summary
from gridtrack.evaluation.scores.registry import built_in, find_output
from gridtrack.trackers.training.card import GENERAL

from studies.support.comparison import compare, train
from studies.support.results_file import (
    NONE,
    ResultSection,
    ResultTable,
    measured_table,
    read_sections,
    study_parser,
    write_section,
)
from studies.support.unseen_places import REFERENCE, WEIGHTS

HALL, SITE = Path("data/leg_tracker/leg_tracker.mcap"), "leg_tracker"
STRETCHES = {"validation": f"{HALL}@validation", "test": f"{HALL}@test"}
TRACKERS = ("kalman", "dilated-convgru")
WAYS = ("from general", "from scratch")
RECIPES = Path("studies/recipes/from-scratch")
"""Recipes of trainings from scratch, TRACKER-SITE.toml; a training from general weights keeps their settings."""
SCORES = (
    ("in-motion", "pr_auc", "PR-AUC, in motion"),
    ("dynamic", "f1", "F1, dynamic"),
    ("visible", "log_loss", "log loss"),
)
HORIZONS_S = (0.5, 1.0)
RESULTS = Path("docs/results/worlds/site_start.json")
COMMAND = "python -m studies.site_start"


def train_one_way(tracker: str, way: str, out: Path) -> float:
    """Train in one of WAYS; seconds of processor time, 0 if the training exists."""
    recipe = ("--recipe", RECIPES / f"{tracker}-{SITE}.toml")
    before_s = _children_s()
    card = trained(out, tracker, way) / tracker / f"{SITE}.toml"
    ran = train(card, *(recipe if way == "from scratch" else (tracker, HALL)), "--seed", "1")
    return _children_s() - before_s if ran else 0.0


def _children_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def trained(out: Path, tracker: str, way: str) -> Path:
    """The folder of weights of a training."""
    return out / way.replace(" ", "-") / tracker


def rows_of(tracker: str, out: Path) -> dict[str, str]:
    """The rows of a tracker, as values of `--tracker` by label."""
    rows = {"general": f"weights={WEIGHTS},card={GENERAL}"}
    rows |= {way: f"weights={trained(out, tracker, way)},card=site" for way in WAYS}
    return {f"{tracker} {name}": f"{tracker} {name}={tracker}:{weights}" for name, weights in rows.items()}


def run(trackers: Sequence[str], out: Path) -> dict[str, float]:
    """Train missing weights and compare on both stretches; the ratio of both training times, by tracker trained now."""
    took = {}
    for tracker in trackers:
        times_s = [train_one_way(tracker, way, out) for way in WAYS]
        if all(times_s):
            took[tracker] = times_s[0] / times_s[1]
    chosen = [REFERENCE, *(row for tracker in trackers for row in rows_of(tracker, out).values())]
    for name, stretch in STRETCHES.items():
        options = ("--every", "0.2s", "--horizon", "2s", "--allow-leak", "--resume")
        compare([Path(stretch)], Path(f"{HALL}@train"), chosen, out / name, *options)
    return took


def table(summary: RunSummary) -> ResultTable:
    """SCORES of every row at HORIZONS_S."""
    (recording,) = summary.recordings.values()
    steps = [recording.horizons_s.index(horizon_s) for horizon_s in HORIZONS_S]
    rows = []
    for label, row in summary.trackers.items():
        (scored,) = row.recordings.values()
        outputs = ((stratum, *find_output(score, built_in())) for stratum, score, _ in SCORES)
        found = [
            scored.at(stratum, score.name, output.name, step).value
            for stratum, score, output in outputs
            for step in steps
        ]
        rows.append([label, *(NONE if one is None else f"{one:.3f}" for one in found)])
    return measured_table(("row", *(f"{name} {h:g} s" for *_, name in SCORES for h in HORIZONS_S)), rows)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = study_parser(__doc__)
    parser.add_argument("--tracker", action="append", choices=TRACKERS, help="default: both")
    parser.add_argument("--out", type=Path, default=Path("runs/site-start"), help="folder, default: %(default)s")
    parser.add_argument("--results", type=Path, default=RESULTS, help="results file, default: %(default)s")
    given = parser.parse_args(arguments)
    took = run(given.tracker or TRACKERS, given.out)
    tables = {name: table(read_summary(given.out / name)) for name in STRETCHES}
    # the time of a kept training was measured when it ran
    values = dict(read_sections(given.results)["scores"].values) if given.results.exists() else {}
    values |= {f"time of {tracker}, of that from scratch": f"{share:.2f}" for tracker, share in took.items()}
    section = ResultSection(command=COMMAND, tables=tables, values=values)
    write_section(given.results, "scores", section)
    print(section.text())


if __name__ == "__main__":
    main()
