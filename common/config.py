"""Configuration: frozen models that refuse unknown keys, and `key=value,key=value` from the command line."""

from __future__ import annotations

from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from gridtrack.common.errors import ConfigurationError, did_you_mean
from gridtrack.common.untrusted import parse_json

MAX_ERRORS, MAX_SHOWN_CHARS, MAX_FAULT_CHARS = 5, 80, 300
"""Limits of a message about invalid values: number of errors, characters of each value and of each error."""


class Settings(BaseModel):
    """Base of every configuration model: frozen, and an unknown key is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid", validate_default=True, allow_inf_nan=False)


Model = TypeVar("Model", bound=BaseModel)


def parse_pairs(text: str, where: str) -> dict[str, Any]:
    """Read `key=value,key=value`; a value is JSON if it parses as JSON, else a string.

    A comma inside brackets or double quotes belongs to the value.

    Raises ConfigurationError for a part without `=`, an empty key or a repeated key.
    """
    pairs: dict[str, Any] = {}
    for part in filter(None, (p.strip() for p in _split(text))):
        key, equals, value = part.partition("=")
        key = key.strip().replace("-", "_")
        if not equals or not key:
            raise ConfigurationError(f"{where}: '{part}' is not of the form key=value")
        if key in pairs:
            raise ConfigurationError(f"{where}: '{key}' is given twice")
        pairs[key] = _value(value.strip())
    return pairs


def _split(text: str) -> list[str]:
    """`text` split at the commas outside brackets and double quotes."""
    parts, start, depth, quoted = [], 0, 0, False
    for position, char in enumerate(text):
        if char == '"' and text[position - 1 : position] != "\\":
            quoted = not quoted
        elif not quoted:
            depth += (char in "[{") - (char in "]}")
        if char == "," and depth <= 0 and not quoted:
            parts.append(text[start:position])
            start = position + 1
    return [*parts, text[start:]]


def _value(text: str) -> Any:
    try:
        return parse_json(text.encode())
    except ValueError:
        return text


def validated(model: type[Model], values: dict[str, Any], where: str) -> Model:
    """`model(**values)`. Raises ConfigurationError: the first errors in one line, with suggestions for unknown keys."""
    try:
        return model.model_validate(values)
    except ValidationError as error:
        errors = error.errors(include_url=False)
        more = [f"and {len(errors) - MAX_ERRORS} more"] if len(errors) > MAX_ERRORS else []
        raise ConfigurationError(
            "; ".join([_error_text(model, e, where) for e in errors[:MAX_ERRORS]] + more)
        ) from None


def _error_text(model: type[BaseModel], error: Any, where: str) -> str:
    key = ".".join(f"{part!s:.{MAX_SHOWN_CHARS}}" for part in error["loc"])
    if error["type"] == "extra_forbidden":
        return f"{where}: there is no option '{key}'; {did_you_mean(key, field_names(model))}"
    return f"{where}: '{key}' = {error['input']!r:.{MAX_SHOWN_CHARS}}: {error['msg']:.{MAX_FAULT_CHARS}}"


def field_names(model: type[BaseModel]) -> list[str]:
    """Names of the fields as users write them."""
    return [field.alias or name for name, field in model.model_fields.items()]
