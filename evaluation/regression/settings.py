"""The settings of the regression gate. Light to import: the command line reads its defaults here."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from gridtrack.common.config import Settings

Margin = Annotated[float, Field(ge=0.0, lt=1.0)]


class GateSettings(Settings):
    """From which fall in F1, and from which growth of a time, a tracker is worse."""

    margin: Margin = 0.005
    """The largest fall in F1 that is not worse, however significant."""
    tolerance: dict[str, Margin] = Field(default_factory=dict)
    """The margin of single trackers, by label. With too few units for significance it is the only criterion, and a
    tracker without a tolerance must not fall at all."""
    speed_reference: str | None = None
    """The tracker whose times are the unit of measurement of speed; None: speed is not judged."""
    speed_margin: Annotated[float, Field(ge=0.0)] = 0.5
    """The largest growth, as a share, of the ratio of a tracker's time to the reference's that is not worse."""
