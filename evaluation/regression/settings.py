"""The settings of the regression gate. Light to import: the command line reads its defaults here."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from gridtrack.common.config import Settings

Margin = Annotated[float, Field(ge=0.0, lt=1.0)]


MARGIN = 0.005
"""The margin with enough units for significance, where none is given."""
SPEED_MARGIN, TURNS_MARGIN = 0.5, 0.1
"""The margins of speed, where none is given: on a loaded machine a ratio to a reference varies by a third."""


class GateSettings(Settings):
    """From which fall in F1, and from which growth of a time, a tracker is worse."""

    margin: Margin | None = None
    """The largest fall in F1 that is not worse, however significant; a log loss may rise by ten times that as a share.
    None: MARGIN, and 0 with too few units for significance: the margin is then the only criterion."""
    tolerance: dict[str, Margin] = Field(default_factory=dict)
    """The margin of single trackers, by label."""
    speed_reference: str | None = None
    """The tracker whose times are the unit of measurement of speed; None: speed is not judged."""
    speed_margin: Annotated[float, Field(ge=0.0)] | None = None
    """The largest growth, as a share, of a tracker's time that is not worse. None: SPEED_MARGIN of a ratio to the
    reference's time, and TURNS_MARGIN of times measured in turns with a base."""

    @property
    def ratio_margin(self) -> float:
        """The margin of a ratio to the reference's time."""
        return SPEED_MARGIN if self.speed_margin is None else self.speed_margin

    @property
    def turns_margin(self) -> float:
        """The margin of a time measured in turns with that of a base."""
        return TURNS_MARGIN if self.speed_margin is None else self.speed_margin

    def margin_of(self, label: str, enough_units: bool) -> float:
        """The margin of F1 that a tracker is judged by."""
        default = MARGIN if enough_units else 0.0
        return self.tolerance.get(label, default if self.margin is None else self.margin)
