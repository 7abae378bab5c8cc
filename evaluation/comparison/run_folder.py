"""A run's folder: run.json with the resolved configuration and provenance, the trials' folders, summary.json."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from gridtrack.evaluation.comparison.plan import ComparisonPlan
from gridtrack.evaluation.comparison.provenance import machine, versions
from gridtrack.evaluation.scoring.record import MAX_BYTES, RunError, TrialRecord, read_record
from gridtrack.evaluation.scoring.scores import HISTOGRAM, SCORES
from gridtrack.evaluation.scoring.splits import ORACLE
from gridtrack.evaluation.statistics.inference import Ended
from gridtrack.evaluation.statistics.summary import SUMMARY, summarise, write_json

RUN = "run.json"
SCHEMA = 1


@dataclass(frozen=True, slots=True)
class RunFolder:
    """The folder of one run while it is filled."""

    path: Path
    plan: ComparisonPlan
    provenance: Mapping[str, Any]

    @classmethod
    def prepare(cls, plan: ComparisonPlan, command: Sequence[str]) -> RunFolder:
        """Begin a run in the folder, or take up an earlier one of the same configuration with `resume`.

        The folder exists and is locked (`run_lock`). Raises RunError where it holds another run.
        """
        path = plan.settings.out
        identity = _plain(plan.identity())
        earlier = _read_run(path / RUN)
        if earlier is not None and not plan.settings.resume:
            raise RunError(f"{path} holds a run already: continue it with --resume, or name another folder with --out")
        if earlier is not None and earlier.get("configuration") != identity:
            changed = _what_changed(earlier.get("configuration"), identity)
            raise RunError(
                f"{path} holds a run of another configuration ({changed}): name another folder with --out, or ask for"
                " what it was made with"
            )
        folder = cls(path, plan, _provenance(plan, command, identity))
        write_json(path / RUN, {**folder.provenance, "status": "running"})
        return folder

    def kept_records(self) -> dict[str, TrialRecord]:
        """Records by trial name of what an earlier run scored in full with the same weights. Raises RunError."""
        if not self.plan.settings.resume:
            return {}
        weights = {trial.name: trial.weights.sha256 if trial.weights else "" for trial in self.plan.trials}
        weights |= {split.oracle_name: "" for split in self.plan.splits if split.test.has_truth}
        records = {name: read_record(self.path / name) for name in weights}
        return {n: record for n, record in records.items() if record and _is_done(weights[n], record, self.path / n)}

    def finish(self, records: Mapping[str, TrialRecord], notices: Sequence[str], interrupted: bool) -> dict[str, Any]:
        """Write and return the summary of these records, by trial name, with `notices`, and close the run."""
        plan = self.plan
        ended = [
            Ended(records[t.name], self.path / t.name, t.selection.name, t.selection.options, t.selection.points)
            for t in plan.trials
        ]
        oracles = [name for split in plan.splits if (name := split.oracle_name) in records]
        ended += [Ended(records[name], self.path / name, ORACLE, {}, "centres") for name in oracles]
        recordings = {split.name: split.description() for split in plan.splits}
        summary = summarise(recordings, ended, [*plan.notices, *notices], interrupted, plan.settings.reference)
        write_json(self.path / SUMMARY, summary)
        write_json(
            self.path / RUN,
            {**self.provenance, "status": "interrupted" if interrupted else "complete", "finished": _now()},
        )
        return summary


def _is_done(weights_sha256: str, record: TrialRecord, folder: Path) -> bool:
    whole = all((folder / name).is_file() for name in (SCORES, HISTOGRAM))
    return whole and record.outcome == "ok" and record.weights_sha256 == weights_sha256


def _provenance(plan: ComparisonPlan, command: Sequence[str], identity: Mapping[str, Any]) -> dict[str, Any]:
    inputs = {str(split.path): split.test.sha256 for split in plan.splits}
    inputs |= {str(c.validation.recording.path): c.validation.sha256 for c in plan.splits if c.validation}
    return {
        "schema": SCHEMA,
        "command": list(command),
        "settings": plan.settings.model_dump(mode="json"),
        "configuration": identity,
        "inputs": inputs,
        "weights": {t.name: t.weights.provenance() for t in plan.trials if t.weights},
        "versions": versions(),
        "machine": machine(),
        "started": _now(),
    }


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


def _plain(value: Any) -> Any:
    """As JSON gives it back, so that what was written and what would be written compare."""
    return json.loads(json.dumps(value, allow_nan=False))


def _read_run(path: Path) -> dict[str, Any] | None:
    try:
        if path.stat().st_size > MAX_BYTES:
            raise RunError(f"{path}: {path.stat().st_size} bytes; more than {MAX_BYTES} are refused")
        content = json.loads(path.read_text("utf-8"))
    except FileNotFoundError:
        return None
    except (OSError, ValueError, RecursionError) as error:
        raise RunError(f"{path}: cannot be read as JSON ({error}): name another folder with --out") from None
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        raise RunError(f"{path}: not schema {SCHEMA} of a run: name another folder with --out")
    return content


def _what_changed(earlier: Any, now: Mapping[str, Any]) -> str:
    """What two configurations differ in first, in words: what was compared, before any detail of it."""
    if isinstance(earlier, dict):
        for what, names in (("recording", _recordings), ("tracker", _labels)):
            then, asked = names(earlier), names(now)
            if then != asked:
                added, left = sorted(asked - then), sorted(then - asked)
                was_not = f"{what} '{added[0]}' was not in it" if added else ""
                return was_not or f"{what} '{left[0]}' was in it and is not asked for now"
    return _first_difference(earlier, now)


def _recordings(configuration: Mapping[str, Any]) -> set[str]:
    return set(configuration.get("recordings") or ())


def _labels(configuration: Mapping[str, Any]) -> set[str]:
    return {trial.partition("@")[0] for trial in configuration.get("trials") or ()}


def _first_difference(earlier: Any, now: Any, where: str = "") -> str:
    """Where two configurations part, in words."""
    if isinstance(earlier, dict) and isinstance(now, dict):
        for key in sorted(earlier.keys() | now.keys()):
            if earlier.get(key) != now.get(key):
                return _first_difference(earlier.get(key), now.get(key), f"{where}.{key}".removeprefix("."))
    return f"{where}: then {json.dumps(earlier)[:80]}, now {json.dumps(now)[:80]}"
