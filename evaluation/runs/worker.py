"""The process of a cluster that carries out an attempt: the work that its order describes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from gridtrack.evaluation.engines.attempt import Attempt
from gridtrack.evaluation.engines.process import serve_attempt
from gridtrack.evaluation.runs.orders import Order
from gridtrack.evaluation.runs.shared_inputs import SharedInputs
from gridtrack.evaluation.runs.trial import error_with_location
from gridtrack.evaluation.runs.works import OracleWork, PriorWork, RobustnessWork, RunWork, TrialWork


def carry_out(folder: str) -> bool:
    """Carry out the attempt in `folder`; whether nothing interrupted it: KeyboardInterrupt leaves the record so far."""
    return serve_attempt(Path(folder), ordered_work, error_with_location)


def ordered_work(attempt: Attempt, note: Callable[[str], None]) -> RunWork:
    """The work that an attempt's order describes. Raises a GridtrackError where this machine cannot do it alike."""
    order = Order.read(attempt.order())
    split = order.split()
    shared = SharedInputs(order.settings, note, order.thresholds)
    if order.row is None:
        return OracleWork(split, attempt.files, shared)
    trial = order.row.trial(split, order.settings.seed, order.settings.limits)
    if order.record is None:
        return TrialWork(trial, attempt.files, shared)
    measure = PriorWork if order.kind == "prior" else RobustnessWork
    return measure(trial, order.record, attempt.files, shared)
