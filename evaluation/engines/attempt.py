"""An attempt at a work by a process of a cluster: one folder with its order, its progress, its files and its reply.

Host and process share this folder and nothing else. The process writes into it only; the host moves the files to the
trial's folder when it accepts the reply, so an attempt that was given up changes no result. All of it is JSON: nothing
that comes back is unpickled.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel, ValidationError

from gridtrack.common.config import Settings
from gridtrack.common.errors import GridtrackError
from gridtrack.common.files import read_bounded, write_text
from gridtrack.evaluation.runs.trial_record import OUTCOME_FILE, TrialRecord

MAX_ORDER_BYTES = MAX_REPLY_BYTES = 1 << 24
MAX_PROGRESS_BYTES = 1 << 20
INTERRUPTED = "interrupted"
Exchanged = TypeVar("Exchanged", bound=BaseModel)


class EngineError(GridtrackError):
    """A work that an engine could not carry out; the tracker did not cause it."""


class AttemptProgress(Settings):
    """How far an attempt is."""

    frames: int | None = None
    """That it will deliver; None before it starts, or where it counts none."""
    delivered: int = 0
    notes: tuple[str, ...] = ()
    """Messages for the user, one line each."""


class Reply(Settings):
    """How an attempt ended: with the trial's record, or the error in one line."""

    record: TrialRecord | None = None
    error: str = ""


@dataclass(frozen=True, slots=True)
class Attempt:
    """The folder of an attempt."""

    folder: Path

    @property
    def files(self) -> Path:
        """The folder that the files of the trial are written to."""
        return self.folder / "files"

    @classmethod
    def begin(cls, folder: Path, order: str) -> Attempt:
        """Make the folder, with the JSON text `order` that describes the work. Raises OSError."""
        attempt = cls(folder)
        attempt.files.mkdir(parents=True)
        write_text(folder / "order.json", order)
        return attempt

    def order(self) -> str:
        """The JSON text that describes the work. Raises EngineError, FileNotFoundError."""
        return read_bounded(self.folder / "order.json", MAX_ORDER_BYTES, EngineError).decode()

    def progress(self) -> AttemptProgress:
        """How far it is. Raises EngineError."""
        return self._read("progress.json", AttemptProgress, MAX_PROGRESS_BYTES) or AttemptProgress()

    def has_reply(self) -> bool:
        """Whether there is a reply."""
        return (self.folder / "reply.json").exists()

    def reply(self) -> Reply | None:
        """The reply; None where there is none yet. Raises EngineError."""
        return self._read("reply.json", Reply, MAX_REPLY_BYTES)

    def write_progress(self, progress: AttemptProgress) -> None:
        """Tell the host how far it is. Raises FileNotFoundError where the host has given the attempt up."""
        write_text(self.folder / "progress.json", progress.model_dump_json())

    def write_reply(self, reply: Reply) -> None:
        """Tell the host how it ended; all files are written before. Raises OSError as `write_progress`."""
        write_text(self.folder / "reply.json", reply.model_dump_json(by_alias=True))

    def move_files(self, folder: Path, replaced: tuple[str, ...]) -> None:
        """Move the files to the trial's `folder`, its record last; those named `replaced` go. Raises OSError."""
        folder.mkdir(parents=True, exist_ok=True)
        for name in replaced:
            (folder / name).unlink(missing_ok=True)
        for path in sorted(self.files.iterdir(), key=lambda path: (path.name == OUTCOME_FILE, path.name)):
            path.replace(folder / path.name)

    def _read(self, name: str, model: type[Exchanged], max_bytes: int) -> Exchanged | None:
        path = self.folder / name
        try:
            return model.model_validate_json(read_bounded(path, max_bytes, EngineError))
        except FileNotFoundError:
            return None
        except ValidationError as error:
            raise EngineError(f"{path}: not as an engine writes it ({error.error_count()} errors)") from None
