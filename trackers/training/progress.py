"""The progress of a training: its stages, each with the rate and the time left."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager


class Stage:
    """A stage of a training: `done` of `total` iterations, each called a `unit`; `note` ends its line."""

    def __init__(self, unit: str, total: int, done: int = 0) -> None:
        self.unit, self.total, self.done = unit, total, done
        self.note = ""
        self._began_s, self._began_at = time.monotonic(), done

    def advance(self, note: str = "") -> None:
        """Count one more finished iteration."""
        self.done += 1
        self.note = note or self.note

    def text(self, inside: float = 0.0) -> str:
        """`unit 3 of 40, 2.1/s, 18 s left`; `inside` is the share of the present iteration that is done."""
        since_s, done = time.monotonic() - self._began_s, self.done - self._began_at + inside
        parts = [f"{self.unit} {min(self.done + 1, self.total)} of {self.total}"]
        if done > 0.0 and since_s > 0.0:
            rate = done / since_s
            parts.append(f"{rate:.1f}/s" if rate >= 1.0 else f"{1.0 / rate:.1f} s each")
            parts.append(f"{duration_text((self.total - self.done - inside) / rate)} left")
        return ", ".join(filter(None, (*parts, self.note)))

    @property
    def share(self) -> float:
        """The share of the iterations that is done."""
        return min(1.0, self.done / max(self.total, 1))


class Progress:
    """The current stages of a training, the outermost first; an iteration of a stage may have stages of its own."""

    def __init__(self) -> None:
        self._stages: list[Stage] = []
        self._began_s = time.monotonic()

    @contextmanager
    def stage(self, unit: str, total: int, done: int = 0) -> Iterator[Stage]:
        """A stage of `total` iterations; an earlier training did `done` of them."""
        stage = Stage(unit, total, done)
        self._stages.append(stage)
        try:
            yield stage
        finally:
            self._stages.remove(stage)

    def text(self) -> str:
        """The outermost stage as a line: the others are parts of its present iteration."""
        stages = self._stages.copy()
        if not stages:
            return f"training for {duration_text(time.monotonic() - self._began_s)}"
        inside = 0.0
        for stage in reversed(stages[1:]):
            inside = min(1.0, stage.share + inside / max(stage.total, 1))
        return stages[0].text(inside)


def duration_text(duration_s: float) -> str:
    """`18 s`, `2 min 5 s` or `3 h 20 min`."""
    seconds = max(0, round(duration_s))
    if seconds < 60:
        return f"{seconds} s"
    if seconds < 3600:
        return f"{seconds // 60} min {seconds % 60} s"
    return f"{seconds // 3600} h {seconds % 3600 // 60} min"
