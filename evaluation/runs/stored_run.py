"""A run in an object store: made in a folder of the user, which is uploaded when the comparison ends."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from gridtrack.common.errors import StoreError
from gridtrack.common.files import user_data_folder
from gridtrack.common.remote_files import fetched_folder, folder_name, list_folder, upload_folder
from gridtrack.evaluation.results.run_record import RUN_FILE
from gridtrack.evaluation.runs.run_folder import holds_a_run
from gridtrack.evaluation.runs.run_lock import run_lock

BEGUN = ".begun"
"""The file beside the local folder with the version of the stored run that it began with."""


@contextmanager
def stored_run(url: str, *, resume: bool, again: str | None, note: Callable[[str], None]) -> Iterator[Path]:
    """The local folder of the run at `url`, whose files are uploaded when the block ends; then it is removed.

    With `resume` it begins with what the store has, or with what an earlier comparison could not upload. Where the
    block or the upload raises, the folder stays, and `note` receives a line that names it and the command `again`,
    which continues there; None where none does. Raises StoreError, and RunError where the store has a run and `resume`
    is false.
    """
    folder = user_data_folder() / "runs" / hashlib.sha256(url.rstrip("/").encode()).hexdigest()[:16] / folder_name(url)
    with run_lock(folder.parent):
        kept = _record_in(folder) is not None
        begun = None
        try:
            if kept:
                note(f"{url}: {folder} holds what was not uploaded yet")
                _refuse_another(folder, url)
            else:
                _begin(folder, url, resume, note)
            begun = _record_in(folder)
            yield folder
            _refuse_another(folder, url)
            upload_folder(folder, url, last=RUN_FILE)
        except BaseException:
            if kept or _record_in(folder) not in (None, begun):
                mend = f"run `{again}`, or copy it" if again else "copy it"
                note(f"{folder} keeps the run, which is not in {url} as it is here: {mend}")
            else:
                shutil.rmtree(folder.parent)
            raise
        shutil.rmtree(folder.parent)


def _begin(folder: Path, url: str, resume: bool, note: Callable[[str], None]) -> None:
    """Make the folder, with the files of an earlier run that is to be continued. Raises RunError and StoreError."""
    version = _version_there(url)
    if version and not resume:
        raise holds_a_run(url)
    shutil.rmtree(folder, ignore_errors=True)  # of a comparison that was killed before it began
    folder.with_name(BEGUN).write_text(version)
    if not version:
        folder.mkdir()
        return
    copied = folder.with_name(".copying")
    shutil.rmtree(copied, ignore_errors=True)
    shutil.copytree(fetched_folder(url, "runs", note), copied)
    copied.rename(folder)


def _refuse_another(folder: Path, url: str) -> None:
    """Raise StoreError where the store has another run than the one that the folder began with."""
    if _version_there(url) != folder.with_name(BEGUN).read_text():
        raise StoreError(
            f"{url}: another run came there since this one began, and is not replaced: copy {folder} to another place"
        )


def _version_there(url: str) -> str:
    """The version of the record of the run in the store; "" where there is none. Raises StoreError."""
    record = list_folder(url).get(RUN_FILE)
    return record.version if record else ""


def _record_in(folder: Path) -> bytes | None:
    """The content of the run's record; None where there is none."""
    path = folder / RUN_FILE
    return path.read_bytes() if path.is_file() else None
