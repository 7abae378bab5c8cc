"""The declared columns are those of the written files and of the documentation."""

import re
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec
from gridtrack.evaluation.results.columns import CLASSES_TABLE, SEMANTICS_TABLE, TABLES
from gridtrack.evaluation.scoring.class_store import ClassWriter
from gridtrack.evaluation.scoring.energy import ENERGY_STRATA, EnergyTerms
from gridtrack.evaluation.scoring.energy_store import EnergyWriter
from gridtrack.evaluation.scoring.flow_store import FlowWriter
from gridtrack.evaluation.scoring.prior_store import write_prior
from gridtrack.evaluation.referee.referee import ScoredForecast
from gridtrack.evaluation.referee.strata import STRATA_WITH_TRUTH, region_maps_of
from gridtrack.evaluation.referee.targets import Target
from gridtrack.trackers.contract import Forecast

from scenes import synthetic_run as synthetic

PAGE = Path(__file__).parents[3] / "docs" / "run-folder.md"
STEPS, CLASSES = synthetic.STEPS, ("pedestrian", "car")


def a_forecast():
    """A scored forecast with velocities, of a window without anything in it."""
    shape = (4, 4)
    frame = GridFrame(10, *np.zeros((2, *shape), bool), SE2(), *np.zeros((2, 0, 2), np.float32), np.zeros(0, np.uint8))
    maps = region_maps_of(np.zeros(shape, np.uint8), GridSpec(4, 1.0), frame.origins, STRATA_WITH_TRUTH)
    forecast = Forecast(np.zeros((STEPS + 1, *shape), np.float32), velocity=np.zeros((2, *shape), np.float32))
    return ScoredForecast(forecast, (Target.of_frame(frame),) * (STEPS + 1), maps, np.zeros(shape, np.uint8))


@pytest.fixture(scope="module")
def trial(tmp_path_factory):
    """A trial with every file."""
    finished = synthetic.write_trial(tmp_path_factory.mktemp("run"), "good", "room", 0.6, seed=0, frames=2)
    with ClassWriter(finished.folder, CLASSES, semantics=True) as writer:
        writer.add_found(10, np.ones((STEPS + 1, 2, len(CLASSES), 4), np.int32))
        confusion = np.ones((STEPS + 1, 2, len(CLASSES), len(CLASSES) + 1), np.int32)
        writer.add_semantics(10, confusion, confusion.astype(float))
    with FlowWriter(finished.folder, STEPS) as writer:
        writer.add(a_forecast())
    with EnergyWriter(finished.folder, STEPS) as writer:
        sums = np.ones((STEPS + 1, len(ENERGY_STRATA)))
        writer.add(10, EnergyTerms(sums.astype(np.int64), sums, sums))
    write_prior(finished.folder, *np.ones((2, 4, 4), np.int32), np.ones((4, 4), np.float32))
    return finished.folder


@pytest.mark.parametrize("table", TABLES, ids=lambda table: table.file)
def test_a_written_file_has_the_declared_columns(trial, table):
    assert parquet.read_schema(trial / table.file).equals(table.schema)


@pytest.mark.parametrize("table", TABLES, ids=lambda table: table.file)
def test_the_page_names_every_column_and_its_type(table):
    page = PAGE.read_text("utf-8")
    start = page.index(f"`{table.file}`: one row") if table in (CLASSES_TABLE, SEMANTICS_TABLE) else None
    section = page[page.index(f"\n## {table.file}") if start is None else start :]
    lines = section.split("\n|---|---|---|\n", 1)[1].split("\n\n", 1)[0].splitlines()
    rows = [[cell.strip() for cell in line.split("|")[1:3]] for line in lines]
    named = [re.findall(r"`(\w+)`", names) for names, _ in rows]
    assert [name for names in named for name in names] == list(table.names)
    for names, (_, types) in zip(named, rows, strict=True):
        shown = types.split(", ") if ", " in types else [types] * len(names)
        assert not types or shown == [_type_text(table.type_of(name)) for name in names]


def _type_text(kind):
    if pa.types.is_dictionary(kind):
        return "dictionary of string"
    if pa.types.is_fixed_size_list(kind):
        return f"{kind.list_size} x {_type_text(kind.value_type)}"
    if pa.types.is_list(kind):
        return f"list of {_type_text(kind.value_type)}"
    return {"double": "float64", "float": "float32"}.get(str(kind), str(kind))
