"""Orders: the works of a run described as JSON, and made again from it by a process on another machine.

An order names recordings, weights and programs by their paths, which host and machine share, and says what they must
be: a machine that finds another recording, card or library there refuses the work.
"""

from __future__ import annotations

import platform
from pathlib import Path
from typing import Any, Literal

from pydantic import ValidationError

from gridtrack.common.config import Settings
from gridtrack.common.grid import Points
from gridtrack.evaluation.engines.attempt import EngineError
from gridtrack.evaluation.hosting.limits import Limits
from gridtrack.evaluation.results.recording import RecordingIdentity
from gridtrack.evaluation.results.run_record import TrialIdentity
from gridtrack.evaluation.results.trial_record import TrialRecord
from gridtrack.evaluation.runs.learned import read_weights
from gridtrack.evaluation.runs.plan import Trial, sampling_of, segmented
from gridtrack.evaluation.runs.provenance import versions
from gridtrack.evaluation.runs.settings import CompareSettings
from gridtrack.evaluation.runs.shared_inputs import SharedInputs
from gridtrack.evaluation.scoring.splits import EvaluationSplit, plan_split
from gridtrack.recordings.stretches import parse_stretch
from gridtrack.trackers.selection import CardKind, Launch, Selection, launch

OrderKind = Literal["scores", "oracle", "prior", "robustness"]


class RowOrder(Settings):
    """A row of the comparison on one recording: the tracker, how it is started, and its weights."""

    label: str
    name: str
    options: dict[str, Any]
    points: Points
    card: CardKind
    argv: tuple[str, ...] = ()
    cwd: Path | None = None
    """Of a tracker that a `trackers.toml` names; None for a registered one, which each machine starts as its own."""
    weights: Path | None = None
    weights_from: Path | None = None
    """The folder that the weights were copied from, for messages."""
    weights_sha256: str = ""
    identity: TrialIdentity
    """What the trial must be."""

    @classmethod
    def of(cls, trial: Trial) -> RowOrder:
        """The row of a trial."""
        selection, start, weights = trial.selection, trial.launch, trial.weights
        return cls(
            label=selection.label,
            name=selection.name,
            options=dict(selection.options),
            points=selection.points,
            card=selection.card,
            argv=start.argv if start.external else (),
            cwd=start.cwd,
            weights=weights and weights.path.absolute(),
            weights_from=weights and weights.original.absolute(),
            weights_sha256=weights.sha256 if weights else "",
            identity=trial.identity(),
        )

    def trial(self, split: EvaluationSplit, seed: int, limits: Limits) -> Trial:
        """The trial on this machine. Raises a GridtrackError where it is another one here."""
        selection = Selection(self.label, self.name, self.options, self.points, None, self.card)
        start = launch(self.name) if self.cwd is None else Launch(self.name, self.argv, self.cwd)
        weights = read_weights(self.weights, self.weights_from or self.weights.parent) if self.weights else None
        trial = Trial(selection, start, split, weights, seed, limits)
        _require_equal(f"{self.label}: its weights", weights.sha256 if weights else "", self.weights_sha256)
        _require_equal(f"{self.label}: its settings", trial.identity(), self.identity)
        return trial


class Order(Settings):
    """The description of one work."""

    kind: OrderKind
    settings: CompareSettings
    """Of the run, with the one recording of this work."""
    name: str
    """Of the split."""
    identity: RecordingIdentity
    """What the recording and its stretches must be."""
    row: RowOrder | None = None
    """None for the oracle."""
    record: TrialRecord | None = None
    """Of a complete trial that is measured."""
    thresholds: Path
    """The folder with the thresholds that the run has chosen so far."""
    versions: dict[str, str]
    """Of what can change a score, where the run was started."""

    @classmethod
    def of(
        cls,
        kind: OrderKind,
        work: Trial | EvaluationSplit,
        shared: SharedInputs,
        record: TrialRecord | None = None,
    ) -> Order:
        """The order of a work on a trial, or of the oracle on a split."""
        split = work.split if isinstance(work, Trial) else work
        settings = shared.settings
        alone = {
            "recordings": (f"{split.path.absolute()}{split.whole.removeprefix(split.path.stem)}",),
            "trackers": (),
            "validation": settings.validation and _with_absolute_path(settings.validation),
        }
        return cls(
            kind=kind,
            settings=settings.model_copy(update=alone),
            name=split.name,
            identity=split.identity(),
            row=RowOrder.of(work) if isinstance(work, Trial) else None,
            record=record,
            thresholds=shared.folder,
            versions=versions(),
        )

    @classmethod
    def read(cls, text: str) -> Order:
        """The order in a JSON text. Raises EngineError."""
        try:
            return cls.model_validate_json(text)
        except ValidationError as error:
            raise EngineError(f"not an order of this version of gridtrack ({error.error_count()} errors)") from None

    def split(self) -> EvaluationSplit:
        """The recording on this machine. Raises a GridtrackError where it, or a library, is another one here."""
        here = versions()
        for name, version in self.versions.items():
            _require_equal(name, here.get(name, "not installed"), version)
        settings = self.settings
        whole = plan_split(settings.recordings[0], settings.validation, sampling_of(settings))
        split = next((one for one in segmented(whole, settings) if one.name == self.name), whole)
        _require_equal(f"{split.path}", split.identity(), self.identity)
        return split


def _require_equal(what: str, here: object, there: object) -> None:
    if here != there:
        raise EngineError(
            f"{what}: {_short(here)} on this machine ({platform.node()}), {_short(there)} where the run was started:"
            " every machine of an engine has the same recordings, weights and versions"
        )


def _short(value: object) -> str:
    return str(value) if isinstance(value, str) else "another one"


def _with_absolute_path(text: str) -> str:
    path, stretch = parse_stretch(text)
    return f"{path.absolute()}" if stretch is None else f"{path.absolute()}@{text.rpartition('@')[2]}"
