"""The regression gate: what a run counted, kept as a baseline, and whether a later run is worse."""

from gridtrack.evaluation.regression.baseline import read_baseline, write_baseline
from gridtrack.evaluation.regression.measurement import Baseline, Measurement, Unmeasured
from gridtrack.evaluation.regression.measuring import measure_run
from gridtrack.evaluation.regression.verdict import GateSettings, Verdict, compare_with_baseline

__all__ = [
    "Baseline",
    "GateSettings",
    "Measurement",
    "Unmeasured",
    "Verdict",
    "compare_with_baseline",
    "measure_run",
    "read_baseline",
    "write_baseline",
]
