"""JSON Schemas of the result files and of the baseline: `python -m gridtrack.evaluation.schemas docs/schemas`."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from gridtrack.common.field_docs import documented_schema
from gridtrack.common.files import write_text
from gridtrack.evaluation.regression.measurement import Baseline
from gridtrack.evaluation.runs.run_record import RunRecord
from gridtrack.evaluation.runs.summary import RunSummary
from gridtrack.evaluation.runs.trial_record import TrialRecord

MODELS: Mapping[str, type[BaseModel]] = {
    "run": RunRecord,
    "outcome": TrialRecord,
    "summary": RunSummary,
    "baseline": Baseline,
}
"""The model of each file, by the name of its schema."""


def schema_texts() -> dict[str, str]:
    """The JSON Schema of each file as text, by file name."""
    return {f"{name}.schema.json": json.dumps(schema_of(name), indent=2) + "\n" for name in MODELS}


def schema_of(name: str) -> dict[str, Any]:
    """The JSON Schema (draft 2020-12) of the file as it is written. Raises KeyError for a name not in MODELS."""
    schema = documented_schema(MODELS[name], by_alias=True, mode="serialization")
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


def main() -> None:
    """Write the schemas into the folder that the command line names."""
    parser = argparse.ArgumentParser(description="Write the JSON Schemas of the result files.")
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in schema_texts().items():
        write_text(folder / name, text)


if __name__ == "__main__":
    main()
