"""Values of the result files: the base of their models, scores and curves, and how they are rounded."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from math import isfinite, isnan
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, BeforeValidator, ConfigDict, ValidationError

from gridtrack.common.errors import GridtrackError
from gridtrack.common.files import read_json, write_text

DECIMALS = 6
"""Digits after the point of every score."""
P_VALUE_DIGITS = 3
"""Significant digits of a p-value."""


class ResultModel(BaseModel):
    """Base of every model of a result file: frozen. A key that this version does not know is ignored."""

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)


def _defined(value: Any) -> Any:
    return None if isinstance(value, float) and not isfinite(value) else value


def _each_defined(values: Any) -> Any:
    if not isinstance(values, list | tuple):
        return values
    with suppress(TypeError, ValueError, OverflowError):  # a value that is no number is refused after this
        if isfinite(sum(filter(None, values))):
            return values  # without a look at each: a summary has a million
    return tuple(map(_defined, values))


Number = Annotated[float | None, BeforeValidator(_defined)]
"""A score; None if it is undefined (NaN and infinities are read as None)."""
Curve = Annotated[tuple[float | None, ...], BeforeValidator(_each_defined)]
"""One score at every step 0..n; None if it is undefined, as in a stratum without cells."""
Curves = dict[str, Curve]
"""A curve for each stratum."""


def rounded(value: float) -> float | None:
    """A score as the files hold it: DECIMALS digits after the point, None for NaN."""
    return None if isnan(value) else round(value, DECIMALS)


def rounded_p(value: float) -> float | None:
    """A p-value as the files hold it: P_VALUE_DIGITS significant digits, None for NaN."""
    return None if isnan(value) else float(f"{value:.{P_VALUE_DIGITS}g}")


def rounded_curve(values: NDArray[np.float64] | Sequence[float]) -> tuple[float | None, ...]:
    """Scores (S,) of steps 0..S-1 as the files hold them."""
    return tuple([None if isnan(value) else round(value, DECIMALS) for value in np.asarray(values, float).tolist()])


def rounded_p_curve(values: NDArray[np.float64] | Sequence[float]) -> tuple[float | None, ...]:
    """P-values (S,) of steps 0..S-1 as the files hold them."""
    return tuple(rounded_p(float(value)) for value in values)


_Model = TypeVar("_Model", bound=ResultModel)


class RunError(GridtrackError):
    """A run's folder that cannot be used."""


def json_of(content: ResultModel) -> str:
    """A model as JSON text with the keys of its file, indented by one space."""
    return content.model_dump_json(by_alias=True, indent=1)


def write_model(path: Path, content: ResultModel) -> None:
    """Replace the file at `path` by `content`. Raises OSError."""
    write_text(path, json_of(content) + "\n")


def read_model(path: Path, model: type[_Model], schema: int, max_bytes: int, remedy: str) -> _Model:
    """The content of a result file, validated; `remedy` ends every error message.

    Raises FileNotFoundError, for the caller to report the missing file, and RunError for a file that is larger than
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
