"""Choices drawn by hypothesis."""

from __future__ import annotations

from dataclasses import dataclass

from hypothesis import strategies as st


@dataclass(frozen=True)
class DrawnChoices:
    """Choices that hypothesis draws, and makes smaller where an input breaks the rule."""

    data: st.DataObject

    def below(self, count: int) -> int:
        """A number from 0 to count - 1."""
        return int(self.data.draw(st.integers(0, count - 1)))
