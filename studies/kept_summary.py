"""Scores of a comparison for the pages: the summary that is kept in docs/results/PLACE, and its numbers as text.

`python -m studies.kept_summary RUN PLACE` (a second; `runs/results junction` and `runs/hall leg_tracker`
after `make results`) keeps from RUN/summary.json the pooled scores, or the only recording's scores, and one
training of each tracker; the spread between trainings is in `trainings`. Pairs are left out.

A number has an address, a row and a column. The row is a tracker, `TRACKER less REFERENCE` (a paired difference) or
`TRACKER over OTHER` (a ratio). The column is a score, a stratum and a horizon, such as `f1 dynamic 1 s`. Scores: `f1`,
`f1_at_visible` (at the threshold of all visible cells), `foreseen` (contacts, at 5 % false alarms), `pr_auc`,
`log_loss`, `class_log_loss` (nats per scan), `share_of_oracle` (of the way from the best floor to the oracle), `lead`
(F1 above the best floor) and `p` (of a difference of the headline score, corrected by Holm's method). `visible cyclist
as car` is a share of the class's cells now, from confusion.json, which is kept beside the summary.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from gridtrack.evaluation.runs.summary import RunSummary, read_summary
from gridtrack.evaluation.runs.sums import TrialSums
from gridtrack.evaluation.scores.class_log_loss import confusion_of

from studies.support.results_file import ResultTable, chance_marked, score_text, study_parser

RESULTS = Path("docs/results")
COLUMN = re.compile(
    r"(?P<score>f1|f1_at_visible|foreseen|pr_auc|log_loss|share_of_oracle|lead|p|class_log_loss) "
    r"(?P<stratum>.+?) (?P<horizon>now|[\d.]+ s)"
)
CONFUSION_FILE = "confusion.json"
CONFUSION = re.compile(r"(?P<visibility>visible|occluded) (?P<true>\w+) as (?P<forecast>\w+)")
TITLES = {
    "f1": "",
    "f1_at_visible": "threshold of visible, ",
    "foreseen": "contacts foreseen, ",
    "pr_auc": "PR-AUC, ",
    "log_loss": "log loss, ",
    "class_log_loss": "class log loss, ",
}
SHOWN = (
    "f1 in-motion 0.5 s",
    "f1 in-motion 1 s",
    "f1 dynamic 0.5 s",
    "f1 dynamic 1 s",
    "f1 dynamic 2.5 s",
    "f1 visible 1 s",
    "f1 occluded 1 s",
)
"""The columns of a table that compares variants of one tracker."""
OUTPUTS = {
    "f1": ("f1", "f1"),
    "f1_at_visible": ("f1", "at_visible"),
    "foreseen": ("contact_foresight", "foreseen"),
    "pr_auc": ("pr_auc", "area"),
    "log_loss": ("log_loss", "mean"),
    "share_of_oracle": ("f1", "oracle_share"),
    "class_log_loss": ("class_log_loss", "per_scan"),
}
"""Score and output of each score of an address."""
TRAININGS = {"f1": "F1", "contact_foresight": "contacts foreseen"}
"""The headline scores, as the first column of a table of trainings."""
LOSSES = ("log_loss", "class_log_loss")
"""Scores that are better if lower."""


class RunScores:
    """The scores in a summary: pooled over the recordings, or of the only recording."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._summary: dict[str, Any] = json.loads(path.read_text("utf-8"))

    @cached_property
    def _horizons_s(self) -> list[float]:
        recording = next(iter(self._summary["recordings"].values()))
        return [float(horizon) for horizon in recording["horizons_s"]]

    @property
    def _headline(self) -> str:
        return str(self._summary["headline"]).partition(".")[0]

    def value(self, row: str, column: str, *, interval: bool = False) -> str:
        """One number as text, with its 95 % interval if wanted. Raises KeyError for an unknown address."""
        tracker, _, reference = row.partition(" less ")
        if found := CONFUSION.fullmatch(column):
            return f"{self._share(tracker, **found.groupdict()):.0%}".replace("%", " %")
        found = COLUMN.fullmatch(column)
        if found is None:
            raise KeyError(f"no column '{column}' of a summary")
        score, stratum, step = found["score"], found["stratum"], self._step(found["horizon"])
        if score == "share_of_oracle":
            return f"{100 * self._at(tracker, score, stratum, step):.0f} %"
        if score == "lead":
            rows = self._summary["trackers"].items()
            floor = max(self._at(one, "f1", stratum, step) for one, row in rows if row["role"] == "floor")
            return f"{self._at(tracker, 'f1', stratum, step) - floor:.3f}"
        if " over " in row:
            values = [float(self.value(one, column)) for one in row.split(" over ")]
            return f"{values[0] / values[1]:.2f}"
        if score == "p":
            return f"{self._p_value(tracker, reference, stratum, step):.2f}"
        return self._score(tracker, reference, score, stratum, step, interval=interval)

    def table(self, corner: str, rows: Sequence[str], columns: Sequence[str], options: Sequence[str]) -> ResultTable:
        """Rows and columns as a table.

        Options: `intervals`; `best` marks the best number of each column, without the oracle's; `p` marks differences
        of the headline score by their corrected p-value.
        """
        cells = [[self._cell(row, column, options) for column in columns] for row in rows]
        if "best" in options:
            self._mark_best(rows, columns, cells)
        return ResultTable(
            columns=(corner, *map(_title, columns)),
            alignment=("---",) * (len(columns) + 1),
            rows=tuple((row, *texts) for row, texts in zip(rows, cells, strict=True)),
        )

    def trainings(self, columns: Sequence[str]) -> ResultTable:
        """The headline score of the trackers over their trainings: mean, spread, and the difference from the reference.

        `columns` are strata and horizons, such as `dynamic 1 s`.
        """
        return ResultTable(
            columns=(
                TRAININGS[self._headline],
                "trainings",
                *(title for one in columns for title in (one, "difference")),
            ),
            alignment=("---", "--:", *["---"] * (2 * len(columns))),
            rows=tuple(
                (
                    found["tracker"],
                    str(len(found["labels"])),
                    *chain(*(_training_texts(found, one) for one in columns)),
                )
                for found in self._summary["trainings"]
            ),
        )

    def confusion(self, tracker: str, visibility: str) -> ResultTable:
        """Confusion of classes now, in per cent of the cells of each true class."""
        classes = list(self._confusion[tracker][visibility])
        return ResultTable(
            columns=(f"{tracker}, {visibility} cells", *classes),
            alignment=("---", *["--:"] * len(classes)),
            rows=tuple(
                (true, *(f"{100 * self._share(tracker, visibility, true, forecast):.0f}" for forecast in classes))
                for true in classes
            ),
        )

    def _cell(self, row: str, column: str, options: Sequence[str]) -> str:
        text = self.value(row, column, interval="intervals" in options)
        found = COLUMN.fullmatch(column)
        if "p" not in options or found is None or OUTPUTS[found["score"]][0] != self._headline:
            return text
        tracker, _, reference = row.partition(" less ")
        return _marked(text, self._p_value(tracker, reference, found["stratum"], self._step(found["horizon"])))

    def _mark_best(self, rows: Sequence[str], columns: Sequence[str], cells: list[list[str]]) -> None:
        for number, column in enumerate(columns):
            values = {row: self.value(row, column) for row in rows if row != "oracle"}
            best = (min if column.startswith(LOSSES) else max)(values.values(), key=float)
            for row, texts in zip(rows, cells, strict=True):
                if values.get(row) == best:
                    texts[number] = re.sub(r"^[\d.]+", r"**\g<0>**", texts[number])

    def _at(self, tracker: str, score: str, stratum: str, step: int) -> float:
        one, output = OUTPUTS[score]
        return float(self._pooled(tracker)["strata"][stratum][one][output]["value"][step])

    def _score(self, tracker: str, reference: str, score: str, stratum: str, step: int, *, interval: bool) -> str:
        one, output = OUTPUTS[score]
        scope = self._difference(tracker, reference, one) if reference else self._pooled(tracker)
        found = scope["strata"][stratum][one][output]
        ends = [found[end][step] if found.get(end) else None for end in ("low", "high")]
        return score_text(found["value"][step], *(ends if interval else ()), signed=bool(reference))

    def _p_value(self, tracker: str, reference: str, stratum: str, step: int) -> float:
        return float(self._test(tracker, reference, stratum, step)["p_holm"])

    def _test(self, tracker: str, reference: str, stratum: str, step: int) -> dict[str, Any]:
        tests = self._difference(tracker, reference, self._headline)["tests"]
        return next(dict(one) for one in tests if (one["stratum"], one["step"]) == (stratum, step))

    def _difference(self, tracker: str, reference: str, score: str) -> dict[str, Any]:
        for one in self._summary["differences"]:
            scored = any(score in scores for scores in one["strata"].values())
            if (one["tracker"], one["reference"]) == (tracker, reference) and scored:
                return dict(one)
        raise KeyError(f"no difference in {score} of {tracker} less {reference} in the summary")

    def _share(self, tracker: str, visibility: str, true: str, forecast: str) -> float:
        row = self._confusion[tracker][visibility][true]
        return float(row[forecast] / sum(row.values()))

    @cached_property
    def _confusion(self) -> dict[str, Any]:
        return dict(json.loads((self._path.parent / CONFUSION_FILE).read_text("utf-8")))

    def _pooled(self, tracker: str) -> dict[str, Any]:
        row = self._summary["trackers"][tracker]
        if row.get("pooled"):
            return dict(row["pooled"])
        (scored,) = row["recordings"].values()
        return dict(scored)

    def _step(self, horizon: str) -> int:
        return 0 if horizon == "now" else self._horizons_s.index(float(horizon.removesuffix(" s")))


def _training_texts(trainings: dict[str, Any], column: str) -> tuple[str, str]:
    """`0.714 ± 0.002`, and the difference from the reference; † marks a difference that one training cannot test."""
    score = next(one for one in trainings["scores"] if column == f"{one['stratum']} {one['horizon_s']:g} s")
    mean = "not defined" if score.get("mean") is None else f"{score['mean']:.3f}"
    mean += "" if score.get("spread") is None else f" ± {score['spread']:.3f}"
    found = score.get("difference") or {}
    if found.get("value") is None:
        return mean, ""
    text = score_text(found["value"], found.get("low"), found.get("high"), signed=True)
    return mean, f"{text} †" if score.get("p_holm") is None else _marked(text, score["p_holm"])


def _marked(text: str, p_holm: float) -> str:
    """The text of a difference, marked by its corrected p-value."""
    return f"{text} *" if 0.001 <= p_holm < 0.05 else chance_marked(text, p_holm >= 0.05)


def _title(column: str) -> str:
    found = COLUMN.fullmatch(column)
    assert found is not None
    comma = "," if re.search(r"\d", found["stratum"]) else ""
    return f"{TITLES[found['score']]}{found['stratum']}{comma} {found['horizon']}"


def kept(summary: dict[str, Any]) -> dict[str, Any]:
    """The summary without pairs, single recordings of several, and all but the first training of each tracker."""
    further = {label for row in summary["trainings"] for label in row["labels"][1:]}
    rows = {label: row for label, row in summary["trackers"].items() if label not in further}
    return {
        **summary,
        "trackers": {
            label: {**row, "recordings": {} if row["pooled"] else row["recordings"]} for label, row in rows.items()
        },
        "differences": [one for one in summary["differences"] if one["tracker"] not in further],
        "pairs": [],
    }


def confusions(summary: RunSummary, run: Path) -> dict[str, Any]:
    """Cells of the input frame by tracker, visibility, true class and most probable class, over all recordings."""
    found: dict[str, Any] = {}
    classes = next(iter(summary.recordings.values())).classes
    for label, row in summary.trackers.items():
        folders = [run / f"{label}@{name}" for name, trial in row.recordings.items() if trial.complete]
        sums = [one for one in map(TrialSums, folders) if "class_log_loss" in one.scores]
        for visibility in sums[0].layouts["class_log_loss"].strata if sums else ():
            cells = sum(
                confusion_of(one.by_frame("class_log_loss", [0], [visibility], ())).sum(axis=(0, 1, 2)) for one in sums
            )
            found.setdefault(label, {})[visibility] = {
                true: dict(zip((*classes, "another class"), map(int, counts), strict=True))
                for true, counts in zip(classes, np.asarray(cells), strict=True)
            }
    return found


def main(arguments: Sequence[str] | None = None) -> None:
    parser = study_parser(__doc__)
    parser.add_argument("run", type=Path, help="folder of a comparison, such as runs/results")
    parser.add_argument("place", help="folder below --results: junction or leg_tracker")
    parser.add_argument("--results", type=Path, default=RESULTS, help=f"default: {RESULTS}")
    given = parser.parse_args(arguments)
    summary = read_summary(given.run)
    out = given.results / given.place
    out.mkdir(exist_ok=True)
    (out / "summary.json").write_text(json.dumps(kept(summary.model_dump(mode="json", by_alias=True))) + "\n", "utf-8")
    found = confusions(summary, given.run)
    if found:
        (out / CONFUSION_FILE).write_text(json.dumps(found, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    main()
