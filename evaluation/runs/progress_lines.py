"""Lines of progress of a training: those of the tracker, and one every few seconds where it has none."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from types import TracebackType
from typing import Self

from gridtrack.trackers.progress import Progress

LINE_EVERY_S = 9.0
"""A little less than the ten seconds within which a line is promised: the processor may be busy."""


class ProgressLines:
    """A context manager: inside it `progress` is reported where there was no other line for `every_s` seconds."""

    def __init__(self, send: Callable[[str], None], every_s: float = LINE_EVERY_S) -> None:
        """`send` is called from two threads."""
        self.progress = Progress()
        self._send, self._every_s = send, every_s
        self._last_s = time.monotonic()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="progress", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ended.set()
        self._thread.join()

    def report(self, text: object) -> None:
        """Send a line of the tracker."""
        self._last_s = time.monotonic()
        self._send(str(text))

    def _run(self) -> None:
        while not self._ended.wait(max(0.0, self._last_s + self._every_s - time.monotonic())):
            if time.monotonic() - self._last_s >= self._every_s:
                self.report(self.progress.text())
