"""A run in an object store: written to a local folder, which is uploaded when the comparison ends."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from gridtrack.common.errors import StoreError
from gridtrack.common.files import user_data_folder, write_text
from gridtrack.common.remote_files import fetched_folder, folder_name, list_folder, upload_folder
from gridtrack.evaluation.runs.run_folder import holds_a_run, run_lock
from gridtrack.evaluation.runs.run_record import RUN_FILE

BEGUN = ".begun"
"""The file beside the local folder with the version of the stored run that it started from."""


@contextmanager
def stored_run(url: str, *, resume: bool, again: str | None, note: Callable[[str], None]) -> Iterator[Path]:
    """The local folder of the run at `url`. At the end of the block it is uploaded and removed.

    With `resume` it starts from the run in the store, or from files that an earlier comparison could not upload. If the
    block or the upload raises, the folder stays, and `note` receives a line that names it and the command `again` that
    continues it, if there is one. Raises StoreError, and RunError if the store has a run and `resume` is false.
    """
    folder = user_data_folder() / "runs" / hashlib.sha256(url.rstrip("/").encode()).hexdigest()[:16] / folder_name(url)
    with run_lock(folder.parent):
        kept = _record_in(folder) is not None
        begun = None
        try:
            if kept:
                note(f"{url}: {folder} holds files that were not uploaded yet")
                _refuse_changed(folder, url)
            else:
                _begin(folder, url, resume, note)
            begun = _record_in(folder)
            yield folder
            _refuse_changed(folder, url)
            upload_folder(folder, url, last=RUN_FILE)
        except BaseException:
            if kept or _record_in(folder) not in (None, begun):
                remedy = f"run `{again}`, or copy it" if again else "copy it"
                note(f"{folder} keeps the run, which {url} does not have in this state: {remedy}")
            else:
                shutil.rmtree(folder.parent)
            raise
        shutil.rmtree(folder.parent)


def _begin(folder: Path, url: str, resume: bool, note: Callable[[str], None]) -> None:
    """Make the folder, with the files of an earlier run that is continued. Raises RunError and StoreError."""
    version = _stored_version(url)
    if version and not resume:
        raise holds_a_run(url)
    shutil.rmtree(folder, ignore_errors=True)  # of a comparison that was killed before it began
    write_text(folder.with_name(BEGUN), version)
    if not version:
        folder.mkdir()
        return
    copied = folder.with_name(".copying")
    shutil.rmtree(copied, ignore_errors=True)
    shutil.copytree(fetched_folder(url, "runs", note), copied)
    copied.rename(folder)


def _refuse_changed(folder: Path, url: str) -> None:
    """Raise StoreError if the store has a different run from the one that the folder started from."""
    if _stored_version(url) != folder.with_name(BEGUN).read_text():
        raise StoreError(
            f"{url}: another run was uploaded since this one began, and is not replaced: copy {folder} to another place"
        )


def _stored_version(url: str) -> str:
    """The version of the record of the run in the store; "" without a run. Raises StoreError."""
    record = list_folder(url).get(RUN_FILE)
    return record.version if record else ""


def _record_in(folder: Path) -> bytes | None:
    """The content of the run's record; None without one."""
    path = folder / RUN_FILE
    return path.read_bytes() if path.is_file() else None
