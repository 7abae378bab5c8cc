"""Scores of a comparison for the pages: the summary that is kept in docs/results/PLACE, and its numbers as text.

`python -m studies.kept_summary RUN PLACE` (a second; `runs/results junction` after `make results`, `runs/demo
leg_tracker` after `make demo`) keeps from RUN/summary.json the pooled scores, or those of the only recording, and one
training of each tracker; the spread between trainings is in `trainings`. Pairs are left out.

A number has an address, a row and a column. The row is a tracker, `TRACKER less REFERENCE` (a paired difference) or
`TRACKER over OTHER` (a ratio). The column is a score, a stratum and a horizon, such as `f1 dynamic 1 s`. Scores: `f1`,
`f1_at_visible` (at the threshold of all visible cells), `pr_auc`, `nll`, `class nll` (nats per scan), `share_of_oracle`
(of the way from the better floor to the oracle), `lead` (F1 above the better of FLOORS) and `p` (a difference,
corrected by Holm's method). `visible cyclist as car` is a share of the class's cells now.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import Any

from studies.support.results_file import ResultTable, chance_marked, score_text, study_parser

RESULTS = Path("docs/results")
COLUMN = re.compile(
    r"(?P<score>f1|f1_at_visible|pr_auc|nll|share_of_oracle|lead|p|class nll) "
    r"(?P<stratum>.+?) (?P<horizon>now|[\d.]+ s)"
)
CONFUSION = re.compile(r"(?P<visibility>visible|occluded) (?P<true>\w+) as (?P<forecast>\w+)")
TITLES = {
    "f1": "",
    "f1_at_visible": "threshold of visible, ",
    "pr_auc": "PR-AUC, ",
    "nll": "log loss, ",
    "class nll": "class log loss, ",
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
LOSSES = ("nll", "class nll")
"""Scores that are better if lower."""
FLOORS = ("persistence", "static-map")


class RunScores:
    """The scores in a summary: pooled over the recordings, or of the only recording."""

    def __init__(self, path: Path) -> None:
        self._summary: dict[str, Any] = json.loads(path.read_text("utf-8"))

    @cached_property
    def _horizons_s(self) -> list[float]:
        recording = next(iter(self._summary["recordings"].values()))
        return [float(horizon) for horizon in recording["horizons_s"]]

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
            return f"{100 * self._pooled(tracker)['strata'][stratum][score][step]:.0f} %"
        if score == "lead":
            floor = max(self._pooled(one)["strata"][stratum]["f1"][step] for one in FLOORS)
            return f"{self._pooled(tracker)['strata'][stratum]['f1'][step] - floor:.3f}"
        if " over " in row:
            values = [float(self.value(one, column)) for one in row.split(" over ")]
            return f"{values[0] / values[1]:.2f}"
        if score == "p":
            return f"{self._p_value(tracker, reference, stratum, step):.2f}"
        return self._score(tracker, reference, score, stratum, step, interval=interval)

    def table(self, corner: str, rows: Sequence[str], columns: Sequence[str], options: Sequence[str]) -> ResultTable:
        """Rows and columns as a table.

        Options: `intervals`; `best` marks the best number of each column, without the oracle's; `p` marks differences
        of F1 by their corrected p-value.
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
        """F1 of the trackers over their trainings: mean, spread, and the difference from the reference.

        `columns` are strata and horizons, such as `dynamic 1 s`.
        """
        return ResultTable(
            columns=("F1", "trainings", *(title for one in columns for title in (one, "difference"))),
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
        classes = self._semantics(tracker)["classes"]
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
        if "p" not in options or found is None or found["score"] != "f1":
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

    def _score(self, tracker: str, reference: str, score: str, stratum: str, step: int, *, interval: bool) -> str:
        if score == "class nll":
            key, signed = "nll_per_scan", bool(reference)
            found = self._difference("class_differences", tracker, reference) if reference else self._semantics(tracker)
            found = found["kinds"][stratum]
        elif reference and score != "f1":
            found = self._headline(tracker, reference, stratum, step)
            ends = [found[f"{score}_{end}"] for end in ("low", "high")]
            return score_text(found[score], *(ends if interval else ()), signed=True)
        else:
            key, signed = score, bool(reference)
            found = self._difference("differences", tracker, reference) if reference else self._pooled(tracker)
            found = found["strata"][stratum]
        ends = [found[f"{key}_{end}"][step] if found.get(f"{key}_{end}") else None for end in ("low", "high")]
        return score_text(found[key][step], *(ends if interval else ()), signed=signed)

    def _p_value(self, tracker: str, reference: str, stratum: str, step: int) -> float:
        return float(self._headline(tracker, reference, stratum, step)["p_holm"])

    def _headline(self, tracker: str, reference: str, stratum: str, step: int) -> dict[str, Any]:
        headline = self._difference("differences", tracker, reference)["headline"]
        return next(dict(one) for one in headline if (one["stratum"], one["step"]) == (stratum, step))

    def _difference(self, kind: str, tracker: str, reference: str) -> dict[str, Any]:
        pairs = {(one["tracker"], one["reference"]): one for one in self._summary[kind]}
        if (tracker, reference) in pairs:
            return dict(pairs[tracker, reference])
        raise KeyError(f"no {kind} of {tracker} less {reference} in the summary")

    def _share(self, tracker: str, visibility: str, true: str, forecast: str) -> float:
        semantics = self._semantics(tracker)
        confusion = next(one for one in semantics["kinds"][visibility]["confusion"] if one["step"] == 0)["cells"]
        row = confusion[semantics["classes"].index(true)]
        return float(row[semantics["classes"].index(forecast)] / sum(row))

    def _pooled(self, tracker: str) -> dict[str, Any]:
        row = self._summary["trackers"][tracker]
        if row["pooled"]:
            return dict(row["pooled"])
        (scored,) = row["recordings"].values()
        return dict(scored)

    def _semantics(self, tracker: str) -> dict[str, Any]:
        return dict(self._pooled(tracker)["semantics"])

    def _step(self, horizon: str) -> int:
        return 0 if horizon == "now" else self._horizons_s.index(float(horizon.removesuffix(" s")))


def _training_texts(found: dict[str, Any], column: str) -> tuple[str, str]:
    """`0.714 ± 0.002`, and the difference from the reference; † marks a difference that one training cannot test."""
    score = next(one for one in found["scores"] if column == f"{one['stratum']} {one['horizon_s']:g} s")
    spread = "" if score["f1_spread"] is None else f" ± {score['f1_spread']:.3f}"
    mean = "not defined" if score["f1_mean"] is None else f"{score['f1_mean']:.3f}{spread}"
    if score["difference"] is None:
        return mean, ""
    text = score_text(score["difference"], score["difference_low"], score["difference_high"], signed=True)
    return mean, f"{text} †" if score["p_holm"] is None else _marked(text, score["p_holm"])


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


def main(arguments: Sequence[str] | None = None) -> None:
    parser = study_parser(__doc__)
    parser.add_argument("run", type=Path, help="folder of a comparison, such as runs/results")
    parser.add_argument("place", help="folder below --results: junction or leg_tracker")
    parser.add_argument("--results", type=Path, default=RESULTS, help=f"default: {RESULTS}")
    given = parser.parse_args(arguments)
    summary = json.loads((given.run / "summary.json").read_text("utf-8"))
    out = given.results / given.place / "summary.json"
    out.parent.mkdir(exist_ok=True)
    out.write_text(json.dumps(kept(summary)) + "\n", "utf-8")


if __name__ == "__main__":
    main()
