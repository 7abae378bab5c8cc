"""The committed JSON Schemas agree with the models."""

from pathlib import Path

from gridtrack.evaluation.schemas import schema_texts

SCHEMAS = Path(__file__).parents[2] / "docs" / "schemas"


def test_the_committed_schemas_agree_with_the_models():
    committed = {path.name: path.read_text("utf-8") for path in SCHEMAS.glob("*.json")}
    assert committed == schema_texts(), "run `make schemas`"
