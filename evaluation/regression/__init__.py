"""The regression gate: what a run counted, kept as a baseline, and whether a later run is worse."""

from gridtrack.evaluation.regression.baseline import read_baseline, write_baseline
from gridtrack.evaluation.regression.measurement import Baseline, Measurement, Unmeasured
from gridtrack.evaluation.regression.measuring import measure
from gridtrack.evaluation.regression.verdict import GateSettings, Verdict, judge

__all__ = [
    "Baseline",
    "GateSettings",
    "Measurement",
    "Unmeasured",
    "Verdict",
    "judge",
    "measure",
    "read_baseline",
    "write_baseline",
]
