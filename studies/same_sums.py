"""Equality of the sums of two runs: every trial, score by score.

`python -m studies.same_sums RUN OTHER` (some seconds). For a change of the code that is meant to leave every score as
it was. OTHER may be a run of gridtrack 0.2, with its six tables a trial. Trials are matched by their folder's name.
Sums must be equal to the last bit; where 0.2 stored a sum in single precision, to the last bit of that. The log loss of
classes was stored by entry of the confusion matrix: its sum may differ by the order of additions. The exit code is 1
where a trial is missing or differs.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
from numpy.typing import NDArray

from gridtrack.evaluation.runs.sums import SUMS_FILE, Layout, TrialSums
from gridtrack.evaluation.scores.beam_error import BINS
from gridtrack.evaluation.scores.cells import CALIBRATION_BINS, FIRST_OF_CALIBRATION_BIN, PROBABILITY_BINS
from gridtrack.evaluation.scores.neighbourhoods import SCALES

from studies.support.results_file import study_parser

Sums = dict[str, NDArray[np.float64]]
"""By score the sums (F, S, K, P)."""
ADDITIONS = 1e-12
"""Relative difference of a sum in another order."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Print one line for each trial; exit with 1 if any differs."""
    parser = study_parser(__doc__)
    parser.add_argument("run", type=Path)
    parser.add_argument("other", type=Path)
    given = parser.parse_args(arguments)
    trials = sorted(_trials(given.run) | _trials(given.other))
    differing = 0
    for trial in trials:
        found = list(differences(given.run / trial, given.other / trial))
        print(f"{trial}: {'; '.join(found) or 'equal'}")
        differing += bool(found)
    print(f"{len(trials)} trials: {f'{differing} differ' if differing or not trials else 'all sums are equal'}")
    sys.exit(bool(differing) or not trials)


def _trials(run: Path) -> set[str]:
    return {path.parent.name for name in (SUMS_FILE, "scores.parquet") for path in run.glob(f"*/{name}")}


def differences(one: Path, other: Path) -> Iterator[str]:
    """The scores that differ between two trials, a text for each."""
    if not (one / SUMS_FILE).exists() or not any((other / name).exists() for name in (SUMS_FILE, "scores.parquet")):
        yield "missing in one of the runs"
        return
    own = TrialSums(one)
    frames = np.arange(len(own.frames.stamps_ns))
    mine = {s: own.by_unit(s, frames, range(own.steps + 1), own.layouts[s].strata).values for s in own.scores}
    if (other / SUMS_FILE).exists():
        others = TrialSums(other)
        theirs = {
            s: others.by_unit(s, frames, range(own.steps + 1), own.layouts[s].strata).values for s in others.scores
        }
        stamps, delivered = others.frames.stamps_ns, others.frames.delivered
    else:
        stamps, delivered, theirs = _of_0_2(other, own.layouts, own.steps)
    if not np.array_equal(stamps, own.frames.stamps_ns) or not np.array_equal(delivered, own.frames.delivered):
        yield "other frames"
        return
    if missing := mine.keys() ^ theirs.keys():
        yield f"only in one: {', '.join(sorted(missing))}"
    for score in mine.keys() & theirs.keys():
        if unequal := list(_unequal(score, mine[score], theirs[score], own.layouts[score])):
            yield f"{score}: {', '.join(unequal[:5])}"


def _unequal(score: str, one: NDArray[np.float64], other: NDArray[np.float64], layout: Layout) -> Iterator[str]:
    """Names of the parts that differ; NaN in the other: it has no such sum."""
    for p, part in enumerate(layout.parts):
        mine, theirs = one[..., p], other[..., p]
        single = np.float32(mine) == theirs
        close = np.isclose(mine, theirs, rtol=ADDITIONS, atol=0) if score == "class_log_loss" else mine == theirs
        if not (close | single | np.isnan(theirs)).all():
            yield part


def _of_0_2(
    folder: Path, layouts: Mapping[str, Layout], steps: int
) -> tuple[NDArray[np.int64], NDArray[np.str_], Sums]:
    """Stamps, hashes and sums of a trial of gridtrack 0.2."""
    scores = pq.read_table(folder / "scores.parquet")
    strata = layouts["f1"].strata
    rows = (steps + 1) * len(strata)
    stamps = scores["stamp_ns"].to_numpy()[::rows]
    delivered = np.array(scores["delivered"].to_pylist()[::rows])
    shape = len(stamps), steps + 1, len(strata)
    column = {name: scores[name].to_numpy().reshape(shape).astype(np.float64) for name in scores.column_names[4:]}
    names = [f"{count}{end}" for end in ("", "_half", "?", "_label_free") for count in ("tp", "fp", "fn", "tn")]
    f1 = np.stack([column.get(name, np.full(shape, np.nan)) for name in names], axis=-1)
    cells, positives, p_sum = _histograms(folder, shape)
    coarse = [np.add.reduceat(one, FIRST_OF_CALIBRATION_BIN, axis=-1) for one in (cells, positives)]
    calibration = np.concatenate([*coarse, p_sum], axis=-1)
    found: Sums = {
        "f1": f1,
        "pr_auc": np.concatenate([cells, positives], axis=-1),
        "log_loss": np.stack([column["log_loss"], cells.sum(axis=-1)], axis=-1),
        "brier": np.concatenate([column["squared_error"][..., None], calibration], axis=-1),
        "calibration": calibration,
    }
    own = pq.read_table(folder / "neighbourhoods.parquet")
    shape = len(stamps), steps + 1, -1
    sums = {name: own[name].to_numpy().reshape(shape).astype(np.float64) for name in own.column_names[3:]}
    found["fss"] = np.stack([sums[f"{n}_{scale}"] for n in ("agreement", "squares") for scale in SCALES], axis=-1)
    found["soft_iou"] = np.stack([sums["agreement_1"] / 2, sums["soft_union"]], axis=-1)
    own = pq.read_table(folder / "beams.parquet")
    errors = [own[name].to_numpy().reshape(shape).astype(np.float64) for name in ("late_m", "early_m")]
    beams = _dense(own, "bin", "count", BINS).reshape(*errors[0].shape, BINS)
    found["beam_error"] = np.concatenate([np.stack(errors, axis=-1), beams], axis=-1)
    for score, table in (("flow_error", "flow"), ("energy", "energy")):
        if (folder / f"{table}.parquet").exists():
            own = pq.read_table(folder / f"{table}.parquet")
            columns = [own[name].to_numpy().reshape(shape).astype(np.float64) for name in own.column_names[3:]]
            found[score] = np.stack(columns, axis=-1)
    return stamps, delivered, found | _classes(folder, stamps, layouts, steps)


def _histograms(folder: Path, shape: tuple[int, ...]) -> tuple[NDArray[np.float64], ...]:
    table = pq.read_table(folder / "histogram.parquet")
    cells, positives = (
        _dense(table, "bin", name, PROBABILITY_BINS).reshape(*shape, -1) for name in ("count", "positives")
    )
    p_sum = np.concatenate([one.flatten().to_numpy() for one in table["p_sum"].chunks]).astype(np.float64)
    return cells, positives, p_sum.reshape(*shape, CALIBRATION_BINS)


def _dense(table: object, index: str, values: str, size: int) -> NDArray[np.float64]:
    """The entries of list columns as rows (R, size)."""
    dense = []
    for chunk, others in zip(table[index].chunks, table[values].chunks, strict=True):  # type: ignore[index]
        rows = np.zeros((len(chunk), size))
        lengths = np.diff(chunk.offsets.to_numpy())
        rows[np.repeat(np.arange(len(chunk)), lengths), chunk.flatten().to_numpy()] = others.flatten().to_numpy()
        dense.append(rows)
    return np.concatenate(dense)


def _classes(folder: Path, stamps: NDArray[np.int64], layouts: Mapping[str, Layout], steps: int) -> Sums:
    """The sums of classes; missing rows have 0."""
    found: Sums = {}
    at = {stamp: f for f, stamp in enumerate(stamps.tolist())}
    if "class_recall" in layouts and (folder / "classes.parquet").exists():
        layout = layouts["class_recall"]
        sums = found["class_recall"] = np.zeros((len(stamps), steps + 1, len(layout.strata), 4))
        stratum_of = {"visible": "dynamic", "occluded": "occluded"}
        for row in pq.read_table(folder / "classes.parquet").to_pylist():
            k = layout.strata.index(f"{stratum_of[row['kind']]} {row['class']}")
            sums[at[row["stamp_ns"]], row["step"], k] = [row[name] for name in ("tp", "fn", "tp_half", "fn_half")]
    if "class_log_loss" in layouts and (folder / "semantics.parquet").exists():
        layout = layouts["class_log_loss"]
        sums = found["class_log_loss"] = np.zeros((len(stamps), steps + 1, len(layout.strata), len(layout.parts)))
        for row in pq.read_table(folder / "semantics.parquet").to_pylist():
            own = sums[at[row["stamp_ns"]], row["step"], layout.strata.index(row["kind"])]
            own[layout.parts.index(f"{row['true']} as {row['predicted'] or 'another class'}")] = row["cells"]
            own[0] += row["log_loss"]
        cells = sums[..., 3:].sum(axis=-1)
        sums[..., 1] = np.divide(sums[..., 0], cells, out=np.zeros_like(cells), where=cells > 0)
        sums[..., 2] = cells > 0
    return found


if __name__ == "__main__":
    main()
