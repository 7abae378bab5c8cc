"""Trackers with general weights at places that they have not learned: rows that can run, comparison, tables, chart."""

from __future__ import annotations

import argparse
from collections.abc import Collection, Iterable, Mapping, Sequence
from functools import cached_property
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gridtrack.evaluation.referee.splits import ORACLE
from gridtrack.evaluation.runs.comparisons import Comparisons
from gridtrack.evaluation.runs.finished import FinishedTrial, RunTrials
from gridtrack.evaluation.runs.run_record import RecordingDescription
from gridtrack.evaluation.runs.summarise import summarise
from gridtrack.evaluation.runs.summary import (
    NO_ESTIMATE,
    PairFamily,
    PairTest,
    PointEstimate,
    RunSummary,
    ScopeSummary,
    TrackerDifference,
    read_summary,
)
from gridtrack.evaluation.scores.f1 import F1
from gridtrack.evaluation.scores.registry import built_in, find_output
from gridtrack.reports.differences import SIGNIFICANT_VERDICTS as TOLD_APART
from gridtrack.trackers.training.card import GENERAL

from studies.support.comparison import compare, finished_trials
from studies.support.drawings import COLOURS, SETTINGS, write_svg
from studies.support.results_file import (
    NONE,
    ResultSection,
    ResultTable,
    chance_marked,
    measured_table,
    score_text,
    study_parser,
    write_section,
)

WEIGHTS = Path("data/weights")
REFERENCE = "persistence"
FAMILIES = {
    "floors": ("static-map", "blank", "stationary", "advection"),
    "model-free pipeline": ("kalman", "factor-graph"),
    "particle grid": ("dogma",),
    "networks of 2016": ("dilated-convgru", "deep-tracking-rnn"),
    "learned peers": ("conv-lstm", "simvp", "sogmp"),
    "combined": ("pool",),
    "one scan": ("one-shot",),
}
"""The trackers beside the reference, by kind."""
WITHOUT_WEIGHTS = (REFERENCE, "blank", "advection")
STRATA = {"in-motion": "in motion", "dynamic": "dynamic", "visible": "visible", "occluded": "hidden"}
HORIZONS_S = (0.5, 1.0, 2.5)
CONTACTS, CONTACTS_FORESEEN = "contact_foresight", "contacts foreseen"
"""The score that leads, and its heading."""


def trackers() -> list[str]:
    """All trackers, the reference first."""
    return [REFERENCE, *(name for family in FAMILIES.values() for name in family)]


def general_rows(weights: Path) -> dict[str, str]:
    """The rows that can run, as values of `--tracker` by label: of trackers without weights, and those of `rows_of`."""
    with_weights = rows_of(weights)
    known = (name for name in trackers() if name in with_weights or name in WITHOUT_WEIGHTS)
    return {name: with_weights.get(name, name) for name in known}


def rows_of(weights: Path) -> dict[str, str]:
    """The rows of the trackers with general weights in the folder `weights`, as `general_rows`."""
    return {
        name: f"{name}={name}:weights={weights},card={GENERAL}"
        for name in trackers()
        if (weights / name / f"{GENERAL}.toml").is_file()
    }


def not_measured(labels: Iterable[str]) -> str:
    """The trackers without a row, as text."""
    return ", ".join(f"`{name}`" for name in trackers() if name not in labels) or "none"


def pair_text(test: PairTest) -> str:
    """The difference of a tested pair, marked if it is not significant."""
    text = point_text(test.difference, signed=True)
    return chance_marked(text, test.verdict not in TOLD_APART)


def point_text(found: PointEstimate, *, signed: bool = False) -> str:
    """A value with its interval if it has one; NONE where it is undefined."""
    if found.value is None:
        return NONE
    return score_text(found.value, found.low, found.high, signed=signed)


class PlaceScores:
    """The scores of a comparison, pooled over some of its recordings, at HORIZONS_S as far as it forecasts."""

    def __init__(self, recordings: Mapping[str, RecordingDescription], trials: Sequence[FinishedTrial]) -> None:
        """Raises SystemExit if a trial is not complete: every score is of all recordings."""
        for trial in trials:
            if not trial.complete:
                raise SystemExit(f"{trial.folder}: not complete ({trial.record.outcome}): run the command again")
        self.described = recordings
        self._trials = trials
        self.run = RunTrials(recordings, trials, REFERENCE)
        if not self.run.pools:
            raise SystemExit(f"{', '.join(recordings)}: two recordings or more, with horizons in common, are needed")

    @classmethod
    def read(cls, folder: Path) -> PlaceScores:
        """The scores of the comparison in `folder`. Raises SystemExit, RunError."""
        summary = read_summary(folder)
        return cls(summary.recordings, finished_trials(folder, summary))

    def of(self, names: Collection[str] | None = None, labels: Collection[str] | None = None) -> PlaceScores:
        """The scores on the recordings of these names, of the rows with these labels; None: all of them."""
        chosen = {name: one for name, one in self.described.items() if names is None or name in names}
        return PlaceScores(chosen, [one for one in self._trials if labels is None or one.record.label in labels])

    def replaced_by(self, others: PlaceScores) -> PlaceScores:
        """These scores and `others`; a trial of `others` replaces the trial of the same row and recording."""
        replaced = {(trial.record.label, trial.record.recording) for trial in others._trials}
        kept = [one for one in self._trials if (one.record.label, one.record.recording) not in replaced]
        return PlaceScores({**self.described, **others.described}, [*kept, *others._trials])

    @cached_property
    def summary(self) -> RunSummary:
        """All results of these recordings."""
        return summarise(self.described, self._trials, (), False, REFERENCE, headline=F1.name)

    @property
    def labels(self) -> list[str]:
        """The rows: the oracle if there is one, then the trackers in their order."""
        known = [label for label in self.run.labels if label != ORACLE]
        ceiling = [label for label in self.run.labels if label == ORACLE]
        return [*ceiling, *(name for name in trackers() if name in known), *(n for n in known if n not in trackers())]

    @cached_property
    def horizons(self) -> dict[float, int]:
        """The step nearest to each of HORIZONS_S, as far as forecasts reach."""
        found = np.array(self.run.horizons_s)
        half_a_step_s = np.diff(found).min() / 2.0
        nearest = {horizon_s: int(abs(found - horizon_s).argmin()) for horizon_s in HORIZONS_S}
        return {horizon_s: at for horizon_s, at in nearest.items() if abs(found[at] - horizon_s) <= half_a_step_s}

    @property
    def forecasts(self) -> dict[str, int]:
        """Scored forecasts of the reference, by recording."""
        return {trial.record.recording: trial.record.frames_scored for trial in self.trials_of(REFERENCE)}

    def occupied(self, stratum: str, horizon_s: float) -> dict[str, float]:
        """Mean number of occupied cells in a stratum, `horizon_s` after a forecast, by recording."""
        found = {}
        for trial in self.trials_of(REFERENCE):
            step = trial.steps[self.horizons[horizon_s]]
            counts = self.run.sums(trial).by_frame("f1", [step], [stratum], ("tp chosen", "fn chosen"))
            found[trial.record.recording] = float(counts.values.sum(axis=-1).mean())
        return found

    def trials_of(self, label: str) -> list[FinishedTrial]:
        """The trials of a row, in the order of the recordings."""
        return self.run.comparable(label, list(self.described))

    @cached_property
    def why_no_interval(self) -> str:
        """Why there are no intervals; empty if there are."""
        return self._pooled(REFERENCE).interval

    def _pooled(self, label: str) -> ScopeSummary:
        found = self.summary.trackers[label].pooled
        assert found is not None  # the recordings are pooled
        return found

    def text(self, label: str, stratum: str, score: str, horizon_s: float, recording: str = "") -> str:
        """A score, as SCORE or SCORE.OUTPUT, of a row on a `recording`, or on all; with its interval if it has one."""
        return point_text(self.at(label, stratum, score, horizon_s, recording))

    def at(self, label: str, stratum: str, score: str, horizon_s: float, recording: str = "") -> PointEstimate:
        """The score of `text`; of None beyond the longest forecast."""
        if not recording or horizon_s not in self.horizons:
            return self._at(self._pooled(label), stratum, score, self.horizons.get(horizon_s))
        trial = next(one for one in self.trials_of(label) if one.record.recording == recording)
        return self._at(
            self.summary.trackers[label].recordings[recording], stratum, score, trial.steps[self.horizons[horizon_s]]
        )

    def _at(self, found: ScopeSummary | TrackerDifference, stratum: str, score: str, step: int | None) -> PointEstimate:
        one, output = find_output(score, built_in())
        return NO_ESTIMATE if step is None else found.at(stratum, one.name, output.name, step)

    def table(self, corner: str, columns: Sequence[tuple[str, str, str, float]]) -> ResultTable:
        """A row for each tracker; columns are heading, stratum, score and horizon."""
        shown = [column for column in columns if column[3] in self.horizons]
        rows = [[label, *(self.text(label, *column[1:]) for column in shown)] for label in self.labels]
        return measured_table((corner, *(heading for heading, *_ in shown)), rows)

    def over_horizons(self, corner: str, stratum: str, score: str) -> ResultTable:
        """One score in one stratum."""
        return self.table(corner, [(f"{h:g} s", stratum, score, h) for h in HORIZONS_S])

    def skill(self, label: str, horizon_s: float) -> dict[int, float]:
        """Fractions skill of dynamic cells by the side of a neighbourhood, where it is defined."""
        found = {side: self.at(label, "dynamic", f"fss.{side}_cells", horizon_s).value for side in SIDES}
        return {side: value for side, value in found.items() if value is not None}

    @cached_property
    def differences(self) -> dict[str, TrackerDifference]:
        """Paired differences of F1 from the reference, by label."""
        return {one.tracker: one for one in self.summary.differences if one.tests}

    def difference(self, label: str, stratum: str, horizon_s: float) -> PointEstimate:
        """F1 of a row less the reference's."""
        return self._at(self.differences[label], stratum, "f1", self.horizons[horizon_s])

    @cached_property
    def pair_families(self) -> list[PairFamily]:
        """All pairs of `labels`, each family corrected by Holm's method; empty with too few units for a test.

        The oracle is in no pair.
        """
        rows = [trial for trial in self._trials if trial.record.label in self.labels]
        run = RunTrials(self.described, rows, REFERENCE)
        return Comparisons(run, built_in(), find_output(F1.name, built_in())).families()

    def pair_table(self, corner: str, score: str, labels: Collection[str]) -> ResultTable:
        """The differences in a score on dynamic cells between each two of `labels`, where tested; marked if not
        significant."""
        one, output = find_output(score, built_in())
        key = "dynamic", one.name, output.name
        found = {f.step: f.pairs for f in self.pair_families if (f.stratum, f.score, f.output) == key}
        columns = {
            f"{h:g} s": {
                f"{test.tracker} less {test.other}": pair_text(test)
                for test in found[step]
                if {test.tracker, test.other} <= set(labels)
            }
            for h, step in self.horizons.items()
            if step in found
        }
        pairs = dict.fromkeys(pair for column in columns.values() for pair in column)
        rows = [[pair, *(column.get(pair, NONE) for column in columns.values())] for pair in pairs]
        return measured_table((corner, *columns), rows)


WORLDS = Path("data/worlds/test")
SIDES = (1, 3, 5, 9)
"""Sides of the neighbourhoods of the chart, cells."""
DASHES = {0.5: "-", 1.0: "--"}
"""The drawn horizons, seconds."""
CHARTS_IN_A_ROW = 3
GREY = "#777"


def place_parser(documentation: str | None, out: Path, results: Path) -> argparse.ArgumentParser:
    """The options that such studies have in common; `out` is the folder of the run."""
    parser = study_parser(documentation)
    parser.add_argument("--tracker", action="append", help="the label of a row; default: all rows that can run")
    parser.add_argument("--weights", type=Path, default=WEIGHTS, help="folder of the general weights")
    parser.add_argument("--every", default="1s", help="between two scored forecasts")
    parser.add_argument("--out", type=Path, default=out, help="folder of the run, default: %(default)s")
    parser.add_argument("--results", type=Path, default=results, help="results file, default: %(default)s")
    parser.add_argument("--jobs", default="1", help="trials at the same time")
    parser.add_argument("--collect", action="store_true", help="run nothing; write the results of the finished run")
    return parser


def worlds_called(names: Sequence[str] | None) -> list[Path]:
    """The test worlds of these names; without names all of them. Ends the program for an unknown name."""
    worlds = {path.stem: path for path in sorted(WORLDS.glob("*.tracks"))}
    if unknown := [name for name in names or () if name not in worlds]:
        raise SystemExit(f"--world {', '.join(unknown)}: no such world; there are {', '.join(worlds)}")
    return [worlds[name] for name in names or worlds]


def compare_places(given: argparse.Namespace, recordings: Sequence[Path], out: Path) -> None:
    """Compare the rows of `--tracker` on `recordings`, with the thresholds of the cards, in the folder `out`."""
    rows = general_rows(given.weights)
    if unknown := [label for label in given.tracker or () if label not in rows]:
        raise SystemExit(f"--tracker {', '.join(unknown)}: no row that can run; there are {', '.join(rows)}")
    compare_rows(given, recordings, [rows[label] for label in given.tracker or rows], out)


def compare_rows(
    given: argparse.Namespace, recordings: Sequence[Path], rows: Sequence[str], out: Path, *, every: str | None = None
) -> None:
    """Compare `rows`, values of `--tracker`, as `compare_places`; `every` replaces the time between two forecasts."""
    compare(recordings, None, rows, out, "--every", every or given.every, "--jobs", given.jobs, "--resume")


def write_places(results: Path, sections: Mapping[str, ResultSection], scores: PlaceScores) -> None:
    """Write and print the sections of a results file, and draw the chart of `scores` beside it."""
    for name, section in sections.items():
        write_section(results, name, section)
        print(section.text(), end="\n\n")
    draw_skill(scores, results.with_name("scales.svg"))


def draw_skill(scores: PlaceScores, path: Path) -> None:
    """Draw fractions skill by the side of a neighbourhood: a chart for each family of trackers with scores.

    Beside them are the reference, in grey, and the oracle; without other trackers there is one chart of these.
    """
    measured = {name: [one for one in members if one in scores.labels] for name, members in FAMILIES.items()}
    families = {name: members for name, members in measured.items() if members} or {REFERENCE: []}
    columns = min(len(families), CHARTS_IN_A_ROW)
    rows = -(-len(families) // columns)
    with matplotlib.rc_context(SETTINGS):
        figure = Figure((2.6 * columns, 2.6 * rows), layout="constrained")
        charts = list(figure.subplots(rows, columns, squeeze=False, sharey=True).flat)
        for axes, (name, members) in zip(charts, families.items(), strict=False):
            draw_family(axes, name, members, scores)
        for axes in charts[len(families) :]:
            axes.remove()
        figure.supxlabel("side of a neighbourhood, cells (solid: 0.5 s ahead, dashed: 1 s)", fontsize="medium")
        figure.supylabel("fractions skill score", fontsize="medium")
        write_svg(figure, path)


def draw_family(axes: Axes, name: str, members: Sequence[str], scores: PlaceScores) -> None:
    """Draw one chart."""
    colours = {label: GREY for label in (REFERENCE, ORACLE) if label in scores.labels}
    colours |= dict(zip(members, COLOURS, strict=False))
    for label, colour in colours.items():
        for horizon_s, dash in DASHES.items():
            if of_side := scores.skill(label, horizon_s):
                key = label if horizon_s == 0.5 and label in members else "_"
                axes.plot(list(of_side), list(of_side.values()), dash, color=colour, label=key)
    axes.set(title=name, ylim=(0.0, 1.0), xticks=SIDES, yticks=(0.0, 0.5, 1.0))
    axes.grid(axis="y", color="#ddd")
    if members:
        axes.legend(loc="best")
