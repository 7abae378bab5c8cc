"""The columns of a trial's Parquet files: names, types and meaning, declared once for writers and readers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

_LOWEST_OCTAVE, _LOWEST_OCTAVE_NEXT_TO_1 = 12, 7
_COARSENING = 8


def _edges(coarsening: int = 1) -> NDArray[np.float64]:
    """Edges towards 0 by octaves of p, and towards 1 by octaves of 1 - p."""
    near_0 = np.concatenate([_octave(k, coarsening) for k in range(_LOWEST_OCTAVE, 0, -1)])
    near_1 = np.concatenate([_octave(k, coarsening) for k in range(_LOWEST_OCTAVE_NEXT_TO_1, 0, -1)])
    return np.concatenate([[0.0], near_0, [0.5], 1.0 - near_1[::-1], [1.0]])


def _octave(k: int, coarsening: int) -> NDArray[np.float64]:
    """Lower edges of equal bins from 2^-(k+1) to 2^-k: 64 in the three octaves next to 0.5, 32 in three, then 16."""
    bins = (64 if k <= 3 else 32 if k <= 6 else 16) // coarsening
    return 2.0 ** -(k + 1) * (1.0 + np.arange(bins) / bins)


PROBABILITY_EDGES = _edges()
"""Edges (B+1,) of the bins of a histogram of probabilities, multiples of 2^-17; one of them is 0.5.

Bin b covers `PROBABILITY_EDGES[b] <= p < PROBABILITY_EDGES[b + 1]`, the last bin also p = 1. The edges are nearly
log-spaced towards 0, down to 2^-13, and towards 1: the order of small probabilities decides the PR-AUC of rare objects.
"""
PROBABILITY_BINS = len(PROBABILITY_EDGES) - 1
CALIBRATION_EDGES = _edges(_COARSENING)
"""Edges (C+1,) of the coarser bins for calibration, some of PROBABILITY_EDGES: in finer bins the share of occupied
cells is mostly noise, which adds to every calibration error."""
CALIBRATION_BINS = len(CALIBRATION_EDGES) - 1
CONFUSION = ("tp", "fp", "fn", "tn")
"""Counts of cells at the threshold of the step and stratum."""
CONFUSION_AT_HALF = tuple(f"{name}_half" for name in CONFUSION)
CONFUSION_LABEL_FREE = tuple(f"{name}_label_free" for name in CONFUSION)
SCALES = (1, 3, 5, 9)
"""Sides, in cells, of the neighbourhoods of the fractions skill score."""
BEAM_ERROR_EDGES_M = np.concatenate([[0.0], 2.0 ** (np.arange(-7 * 8, 12 * 8 + 1) / 8), [np.inf]])
"""Edges of the bins of the size of a beam error, metres: eight to each octave from 8 mm to 4 km, for its median."""
BEAM_ERROR_BINS = len(BEAM_ERROR_EDGES_M) - 1
FOUND = ("tp", "fn", "tp_half", "fn_half")
"""Counts of the cells of one class, at the threshold in use and at 0.5."""


@dataclass(frozen=True, slots=True)
class ParquetColumn:
    """A column: its name, its Arrow type, and its meaning in one line."""

    name: str
    type: Any
    meaning: str


@dataclass(frozen=True, slots=True)
class ParquetTable:
    """A Parquet file of a trial: its name, what one row is, and its columns in their order."""

    file: str
    row: str
    columns: tuple[ParquetColumn, ...]
    version: int = 1

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns, in their order."""
        return tuple(column.name for column in self.columns)

    @property
    def schema(self) -> Any:
        """The columns as an Arrow schema, with the version of the table as metadata."""
        columns = [(column.name, column.type) for column in self.columns]
        return pa.schema(columns, metadata={"version": str(self.version)})

    def type_of(self, name: str) -> Any:
        """The Arrow type of a column. Raises KeyError for a name that is none."""
        return {column.name: column.type for column in self.columns}[name]


_STRATUM = pa.dictionary(pa.int8(), pa.string())
_NAME = pa.dictionary(pa.int16(), pa.string())
_STAMP = ParquetColumn("stamp_ns", pa.int64(), "stamp of frame t, from which the forecast was made")
_STEP = ParquetColumn("step", pa.int16(), "n, 0 to steps")
_STRATUM_COLUMN = ParquetColumn("stratum", _STRATUM, "name of the stratum; every scored frame has the same ones")
_KIND = ParquetColumn("kind", _NAME, "visibility of the cells: `visible` or `occluded`")


def _counts(names: tuple[str, ...], meaning: str) -> tuple[ParquetColumn, ...]:
    return tuple(ParquetColumn(name, pa.int32(), meaning) for name in names)


SCORES_TABLE = ParquetTable(
    "scores.parquet",
    "scored frame x step x stratum",
    (
        _STAMP,
        ParquetColumn(
            "delivered",
            pa.string(),
            "hash of every frame delivered up to t+steps: equal for two trackers that received the same frames",
        ),
        _STEP,
        _STRATUM_COLUMN,
        *_counts(CONFUSION, "cells, at the threshold of the step and stratum"),
        *_counts(CONFUSION_AT_HALF, "cells, at 0.5"),
        *_counts(CONFUSION_LABEL_FREE, "cells, at the threshold that needs no labels"),
        ParquetColumn("squared_error", pa.float64(), "sum over cells of (p - occupied)^2"),
        ParquetColumn(
            "log_loss",
            pa.float64(),
            "sum over cells of the negative log likelihood, nats; p clipped to [0.001, 0.999]",
        ),
    ),
    version=2,
)
HISTOGRAM_TABLE = ParquetTable(
    "histogram.parquet",
    "scored frame x step x stratum",
    (
        _STAMP,
        _STEP,
        _STRATUM_COLUMN,
        ParquetColumn("bin", pa.list_(pa.int16()), "the bins of forecast probability that have cells, in their order"),
        ParquetColumn("count", pa.list_(pa.int32()), "cells in each of these bins"),
        ParquetColumn("positives", pa.list_(pa.int32()), "occupied cells in each of these bins"),
        ParquetColumn(
            "p_sum",
            pa.list_(pa.float32(), CALIBRATION_BINS),
            "sum of the forecast probabilities in each bin for calibration",
        ),
    ),
    version=2,
)
AGREEMENT, SQUARES = (tuple(f"{name}_{scale}" for scale in SCALES) for name in ("agreement", "squares"))
NEIGHBOURHOODS_TABLE = ParquetTable(
    "neighbourhoods.parquet",
    "scored frame x step x stratum, of `visible`, `dynamic` and `in-motion`, with ground truth also `occluded`",
    (
        _STAMP,
        _STEP,
        _STRATUM_COLUMN,
        *(ParquetColumn(name, pa.float32(), "sum over neighbourhoods of 2 P O") for name in AGREEMENT),
        *(ParquetColumn(name, pa.float32(), "sum over neighbourhoods of P^2 + O^2") for name in SQUARES),
        ParquetColumn("soft_union", pa.float32(), "sum over cells of p + o - p o"),
    ),
)
BEAMS_TABLE = ParquetTable(
    "beams.parquet",
    "scored frame x step x stratum of a recording without ground truth",
    (
        _STAMP,
        _STEP,
        _STRATUM_COLUMN,
        ParquetColumn(
            "late_m", pa.float32(), "sum of the errors, metres, of beams expected to end behind what they hit"
        ),
        ParquetColumn("early_m", pa.float32(), "the same of beams expected to end before it, without its sign"),
        ParquetColumn("bin", pa.list_(pa.int16()), "the bins of the size of an error that have beams, in their order"),
        ParquetColumn("count", pa.list_(pa.int32()), "beams in each of these bins"),
    ),
)
FLOW_TABLE = ParquetTable(
    "flow.parquet",
    "scored frame x step x stratum of `dynamic`, `in-motion` and `occluded`, where the recording has ground truth and"
    " a forecast of the trial has velocities",
    (
        _STAMP,
        _STEP,
        _STRATUM_COLUMN,
        ParquetColumn(
            "cells",
            pa.int32(),
            "occupied cells whose true velocity is known; 0 before the first forecast with a velocity",
        ),
        ParquetColumn("given", pa.int32(), "those of them for which the forecast has a velocity"),
        ParquetColumn("error", pa.float32(), "sum over these of the distance from the true velocity, m/s"),
        ParquetColumn("speed", pa.float32(), "sum over these of the true speed, m/s"),
    ),
)
CLASSES_TABLE = ParquetTable(
    "classes.parquet",
    "scored frame x step x visibility x class, of dynamic cells",
    (
        _STAMP,
        _STEP,
        _KIND,
        ParquetColumn("class", _NAME, "the recording's name of the class"),
        *_counts(
            FOUND[:2],
            "cells called occupied, and not, at the threshold of `dynamic` for visible ones, of `occluded` for others",
        ),
        *_counts(FOUND[2:], "the same at 0.5"),
    ),
)
SEMANTICS_TABLE = ParquetTable(
    "semantics.parquet",
    "scored frame x step x visibility x true x predicted class",
    (
        _STAMP,
        _STEP,
        _KIND,
        ParquetColumn("true", _NAME, "the cell's class"),
        ParquetColumn(
            "predicted",
            _NAME,
            "the most probable of the tracker's classes; null for a class that the recording does not have",
        ),
        ParquetColumn("cells", pa.int32(), "number of cells"),
        ParquetColumn(
            "log_loss",
            pa.float64(),
            "sum over cells of -log P(true class), nats; P clipped to [0.001, 0.999], and 0 before that for a class"
            " that the tracker does not have",
        ),
    ),
)
ENERGY_TABLE = ParquetTable(
    "energy.parquet",
    "scored frame x step x stratum of `visible`, `dynamic` and `in-motion`, where the forecasts have sampled futures",
    (
        _STAMP,
        _STEP,
        _STRATUM_COLUMN,
        ParquetColumn("forecasts", pa.int32(), "1 where the stratum has cells, else 0"),
        ParquetColumn("distance", pa.float32(), "mean distance of the futures from what came"),
        ParquetColumn("spread", pa.float32(), "half the mean distance of the futures from each other"),
    ),
)
PRIOR_TABLE = ParquetTable(
    "prior.parquet",
    "cell of the window, row by row; of a tracker with weights and a sensor at rest",
    (
        ParquetColumn("row", pa.int16(), "of the cell"),
        ParquetColumn("column", pa.int16(), "of the cell"),
        ParquetColumn("visible", pa.int32(), "frames of the test stretch in which the cell is visible"),
        ParquetColumn("occupied", pa.int32(), "frames of the test stretch in which it is occupied"),
        ParquetColumn(
            "probability",
            pa.float32(),
            "P(occupied) one step after a first frame that shows nothing: what the tracker expects of the place",
        ),
    ),
)
SCORE_TABLES = (
    SCORES_TABLE,
    HISTOGRAM_TABLE,
    NEIGHBOURHOODS_TABLE,
    BEAMS_TABLE,
    FLOW_TABLE,
    ENERGY_TABLE,
    CLASSES_TABLE,
    SEMANTICS_TABLE,
)
"""Tables that are written while a trial is scored."""
TABLES = (*SCORE_TABLES, PRIOR_TABLE)
