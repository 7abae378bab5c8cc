"""A baseline: measurements in one JSON file of numbers and names, versioned, replaced whole, read with suspicion."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from gridtrack.common.errors import GridtrackError
from gridtrack.evaluation.regression.measurement import BASELINE_SCHEMA, Baseline, Measurement, Unmeasured
from gridtrack.evaluation.regression.pairing import require_comparable

MAX_BASELINE_BYTES = 16 << 20
"""A larger file is refused before it is read; twenty recordings of six trackers take a hundredth of it."""
_LIST_OF_NUMBERS = re.compile(r"\[\n[-0-9.eE,\s]+\]")
_BANDS_OF_COUNTS = re.compile(r"\{\n\s*\"\w+\": \[[^\[\]{}]*\](,\s+\"\w+\": \[[^\[\]{}]*\])*\s+\}")


class BaselineError(GridtrackError):
    """A file that is no baseline which this version can read."""


def write_baseline(path: Path, runs: Sequence[Measurement]) -> Baseline:
    """Leave a baseline of `runs` at `path`, replaced whole; a line for each unit and stratum for git to compare.

    Raises BaselineError where the file cannot be written, and what `require_comparable` raises.
    """
    require_comparable(runs)
    baseline = Baseline(runs=tuple(runs))
    text = json.dumps(baseline.model_dump(mode="json", by_alias=True), indent=0, allow_nan=False)
    for on_one_line in (_LIST_OF_NUMBERS, _BANDS_OF_COUNTS):
        text = on_one_line.sub(lambda found: "".join(found[0].split()), text)
    partial = path.with_name(path.name + ".partial")
    try:
        partial.write_text(text + "\n", "utf-8")
        partial.replace(path)
    except OSError as error:
        raise BaselineError(f"{path}: the baseline cannot be written ({error.strerror})") from None
    return baseline


def read_baseline(path: Path) -> Baseline:
    """The baseline in `path`. Raises BaselineError, and Unmeasured where it holds nothing."""
    content = _migrated(_read_json(path))
    schema = content.get("schema")
    if schema != BASELINE_SCHEMA:
        raise BaselineError(
            f"{path}: schema {str(schema)[:20]!r} of a baseline; this gridtrack reads schemas 1 to {BASELINE_SCHEMA}:"
            " read it with the version that wrote it, or make it again with --update"
        )
    if _is_empty(content.get("runs")):
        raise Unmeasured(
            [f"{path}: the baseline is empty, nothing can be compared with it: make it again with --update"]
        )
    try:
        baseline = Baseline.model_validate(content)
    except (ValidationError, RecursionError) as error:
        raise BaselineError(f"{path}: not a baseline ({_first(error)}): make it again with --update") from None
    require_comparable(baseline.runs)
    return baseline


def _migrated(content: dict[str, Any]) -> dict[str, Any]:
    """Schema 1 was the measurement of one run, by itself."""
    if content.get("schema") != 1:
        return content
    return {"schema": BASELINE_SCHEMA, "runs": [{key: value for key, value in content.items() if key != "schema"}]}


def _is_empty(runs: Any) -> bool:
    """Whether there is no run, or one in which nothing was measured."""
    if not isinstance(runs, list):
        return False
    return not runs or any(isinstance(run, dict) and {} in (run.get("trackers"), run.get("recordings")) for run in runs)


def _first(error: ValidationError | RecursionError) -> str:
    if isinstance(error, RecursionError):
        return "nested too deeply"
    first = error.errors()[0]
    return f"{'.'.join(str(part)[:60] for part in first['loc']) or 'content'}: {first['msg']}"


def _read_json(path: Path) -> dict[str, Any]:
    try:
        if path.stat().st_size > MAX_BASELINE_BYTES:
            raise BaselineError(
                f"{path}: {path.stat().st_size} bytes; a baseline of more than {MAX_BASELINE_BYTES} is refused"
            )
        content = json.loads(path.read_text("utf-8"))
    except FileNotFoundError:
        raise BaselineError(f"{path}: there is no such baseline; --update makes one of the run") from None
    except OSError as error:
        raise BaselineError(f"{path}: cannot be read ({error.strerror})") from None
    except (ValueError, RecursionError) as error:
        raise BaselineError(f"{path}: not JSON ({str(error)[:80]}): make it again with --update") from None
    if not isinstance(content, dict):
        raise BaselineError(f"{path}: expected one JSON object, found {type(content).__name__}")
    return content
