"""The baseline file: the counts of one or several runs as versioned JSON, validated on reading."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from gridtrack.common.errors import GridtrackError
from gridtrack.common.files import read_json, write_text
from gridtrack.evaluation.regression.measurement import BASELINE_SCHEMA, Baseline, Measurement, Unmeasured
from gridtrack.evaluation.regression.pairing import require_comparable

MAX_BASELINE_BYTES = 16 << 20
"""A larger file is refused before it is read; twenty recordings of six trackers take about a tenth of it."""
_LIST_OF_NUMBERS = re.compile(r"\[\n[-0-9.eE*\",\s]+\]")
_SUMS_BY_BAND = re.compile(r"\{\s*\"\w+\": \[[-0-9.eE*\",]+\](,\s+\"\w+\": \[[-0-9.eE*\",]+\])*\s+\}")


class BaselineError(GridtrackError):
    """A file that is not a baseline of a version that can be read."""


def baseline_of(runs: Sequence[Measurement]) -> Baseline:
    """The baseline of `runs`. Raises the errors of `require_comparable`."""
    require_comparable(runs)
    content = [run.model_dump(mode="json", by_alias=True) for run in runs]
    return Baseline(digest=digest_of(content), runs=tuple(runs))


def write_baseline(path: Path, baseline: Baseline) -> None:
    """Write a baseline to `path`, with one line for each unit and stratum, so that git can compare versions.

    Raises BaselineError if another file is at `path`, or it cannot be written.
    """
    _refuse_other_content(path)
    try:
        write_text(path, lines_of(baseline.model_dump(mode="json", by_alias=True)))
    except OSError as error:
        raise BaselineError(f"{path}: the baseline cannot be written ({error.strerror})") from None


def lines_of(content: Any) -> str:
    """Content as JSON, with the sums of a unit and stratum on one line."""
    text = json.dumps(content, indent=0, allow_nan=False)
    for on_one_line in (_LIST_OF_NUMBERS, _SUMS_BY_BAND):
        text = on_one_line.sub(lambda found: "".join(found[0].split()), text)
    return text + "\n"


def read_baseline(path: Path) -> Baseline:
    """The baseline in `path`. Raises BaselineError, and Unmeasured if it is empty or was changed by hand."""
    content = _read_content(path)
    if not _is_baseline(content):
        raise BaselineError(f"{path}: is not a baseline: name the file that --update wrote")
    schema = content.get("schema")
    if schema != BASELINE_SCHEMA:
        raise BaselineError(
            f"{path}: schema {str(schema)[:20]!r} of a baseline; this gridtrack reads schema {BASELINE_SCHEMA}:"
            " read it with gridtrack 0.2, which wrote it, or make it again with --update"
        )
    if digest_of(content.get("runs")) != content.get("digest"):
        raise Unmeasured(
            [
                f"{path}: changed since it was written (its digest does not match its runs): restore it, or make it"
                " again with --update"
            ]
        )
    if _is_empty(content.get("runs")):
        raise Unmeasured(
            [f"{path}: the baseline is empty, no run can be compared with it: make it again with --update"]
        )
    try:
        baseline = Baseline.model_validate(content)
    except ValidationError as error:
        raise BaselineError(f"{path}: not a baseline ({first_fault(error)}): make it again with --update") from None
    require_comparable(baseline.runs)
    return baseline


def digest_of(content: Any) -> str:
    """SHA-256 of content as JSON with sorted keys and without spaces."""
    return hashlib.sha256(json.dumps(content, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def _read_content(path: Path) -> dict[str, Any]:
    try:
        return read_json(path, MAX_BASELINE_BYTES, BaselineError)
    except FileNotFoundError:
        raise BaselineError(f"{path}: there is no such baseline; --update makes one of the run") from None
    except BaselineError as error:
        raise BaselineError(f"{error}; name a baseline, or restore this one") from None


def _refuse_other_content(path: Path) -> None:
    """Raises BaselineError if `path` exists and is no baseline of any version."""
    why = f"{path}: is not a baseline"
    try:
        if _is_baseline(read_json(path, MAX_BASELINE_BYTES, BaselineError)):
            return
    except FileNotFoundError:
        return
    except BaselineError as error:
        why = str(error)
    raise BaselineError(f"{why}; it is not replaced: name another file, or remove this one")


def _is_baseline(content: dict[str, Any]) -> bool:
    """Whether the content is a baseline of any version; it may be empty or invalid."""
    return {"schema", "digest"} <= content.keys()


def _is_empty(runs: Any) -> bool:
    """Whether there is no run, or one without trackers or recordings."""
    if not isinstance(runs, list):
        return False
    return not runs or any(isinstance(run, dict) and {} in (run.get("trackers"), run.get("recordings")) for run in runs)


def first_fault(error: ValidationError) -> str:
    """The first fault of a file: its place and what is wrong there."""
    first = error.errors(include_url=False, include_input=False)[0]
    return f"{'.'.join(str(key)[:60] for key in first['loc']) or 'content'}: {first['msg']}"
