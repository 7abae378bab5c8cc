"""Reading and writing the JSON files of a run: bounded, validated, replaced whole, errors in one line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TypeVar

from pydantic import ValidationError

from gridtrack.common.errors import GridtrackError
from gridtrack.common.files import read_json, write_text
from gridtrack.evaluation.results.values import ResultModel

_Model = TypeVar("_Model", bound=ResultModel)


class RunError(GridtrackError):
    """A run's folder that cannot be used."""


def json_of(content: ResultModel) -> str:
    """A model as JSON text with the keys of its file, indented by one space."""
    return json.dumps(content.model_dump(by_alias=True), indent=1, allow_nan=False)


def write_model(path: Path, content: ResultModel) -> None:
    """Replace the file at `path` by `content`. Raises OSError."""
    write_text(path, json_of(content) + "\n")


def read_model(path: Path, model: type[_Model], schema: int, max_bytes: int, remedy: str) -> _Model:
    """The content of a result file, validated; `remedy` ends every error message: what to do about it.

    Raises FileNotFoundError, for the caller to report what is missing, and RunError for a file that is larger than
    `max_bytes`, is no JSON object, has another schema number than `schema`, or does not fit the model.
    """
    content = read_json(path, max_bytes, RunError)
    found = content.get("schema")
    if found != schema:
        raise RunError(f"{path}: schema {str(found)[:20]}; this gridtrack reads schema {schema}: {remedy}")
    try:
        return model.model_validate(content)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(str(part)[:60] for part in first["loc"])
        raise RunError(f"{path}: {where or 'content'}: {first['msg']}: {remedy}") from None
