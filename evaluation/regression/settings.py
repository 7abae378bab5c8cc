"""The settings of the regression gate. Light to import: the command line reads its defaults here."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from gridtrack.common.config import Settings

Margin = Annotated[float, Field(ge=0.0, lt=1.0)]


MARGIN = 0.005
"""The margin with enough units for significance, where none is given."""


class GateSettings(Settings):
    """From which fall in F1, and from which growth of a time, a tracker is worse."""

    margin: Margin | None = None
    """The largest fall in F1 that is not worse, however significant; a log loss may rise by ten times that as a share.
    None: MARGIN, and 0 with too few units for significance: the margin is then the only criterion."""
    tolerance: dict[str, Margin] = Field(default_factory=dict)
    """The margin of single trackers, by label."""
    speed_reference: str | None = None
    """The tracker whose times are the unit of measurement of speed; None: speed is not judged."""
    speed_margin: Annotated[float, Field(ge=0.0)] = 0.5
    """The largest growth, as a share, of the ratio of a tracker's time to the reference's that is not worse."""

    def margin_of(self, label: str, enough_units: bool) -> float:
        """The margin of F1 that a tracker is judged by."""
        default = MARGIN if enough_units else 0.0
        return self.tolerance.get(label, default if self.margin is None else self.margin)
