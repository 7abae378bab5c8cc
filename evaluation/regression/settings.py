"""The settings of the regression gate. Light to import: they are options of the command line."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from gridtrack.common.config import Settings
from gridtrack.common.errors import ConfigurationError
from gridtrack.common.options import Option, from_texts

Margin = Annotated[float, Field(ge=0.0, lt=1.0)]


MARGIN = 0.005
"""The default margin with enough units for significance."""
SPEED_MARGIN, TURNS_MARGIN = 0.5, 0.1
"""The default margins of speed: on a loaded machine a ratio to a reference varies by a third."""


def _tolerance(text: str) -> tuple[str, float]:
    """Read `LABEL=F1`. Raises ConfigurationError."""
    label, _, value = text.rpartition("=")
    try:
        return label, float(value)
    except ValueError:
        raise ConfigurationError(f"--tolerance '{text}': expected LABEL=F1, such as my-tracker=0.01") from None


class GateSettings(Settings):
    """The falls of scores and the growth of times that the gate tolerates."""

    margin: Annotated[Margin | None, Option(metavar="F1")] = None
    """Largest fall in F1 that is not worse, however significant; a log loss may rise by ten times that as a share;
    default: 0.005 with 20 units or more, 0 with fewer, for which the margin is the only criterion"""
    tolerance: Annotated[dict[str, Margin], Option(metavar="LABEL=F1"), from_texts(_tolerance)] = Field(
        default_factory=dict
    )
    """Margin of one tracker, such as a learned one; repeat for several"""
    scores: Annotated[tuple[str, ...], Option("score", "NAME")] = ()
    """Judge by this score of another package too, which is loaded only by this name; repeat for several"""
    speed_reference: Annotated[str | None, Option(metavar="LABEL")] = None
    """Judge speed too, as the ratio to the times of this tracker"""
    speed_margin: Annotated[float | None, Option(metavar="SHARE"), Field(ge=0.0)] = None
    """Largest growth of a time that is not worse; default: 0.5 for a ratio to the reference, 0.1 for a time measured
    in turns with a base (--speed-base)"""

    @property
    def ratio_margin(self) -> float:
        """The margin of a ratio to the reference's time."""
        return SPEED_MARGIN if self.speed_margin is None else self.speed_margin

    @property
    def turns_margin(self) -> float:
        """The margin of a time measured in turns with a base."""
        return TURNS_MARGIN if self.speed_margin is None else self.speed_margin

    def margin_of(self, label: str, enough_units: bool) -> float:
        """The margin of F1 that a tracker is judged by."""
        default = MARGIN if enough_units else 0.0
        return self.tolerance.get(label, default if self.margin is None else self.margin)
