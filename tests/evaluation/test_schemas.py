"""The committed JSON Schemas agree with the models."""

from pathlib import Path

import pytest

from gridtrack.evaluation.schemas import MODELS, schema_of, schema_texts

SCHEMAS = Path(__file__).parents[2] / "docs" / "schemas"


def test_the_committed_schemas_agree_with_the_models():
    committed = {path.name: path.read_text("utf-8") for path in SCHEMAS.glob("*.json")}
    assert committed == schema_texts(), "run `make schemas`"


@pytest.mark.parametrize("name", MODELS)
def test_a_schema_describes_its_file_and_every_model_in_it(name):
    schema = schema_of(name)
    assert schema["properties"]["schema"]["const"] == (4 if name == "baseline" else 3)
    assert all(definition.get("description") for definition in schema["$defs"].values())
