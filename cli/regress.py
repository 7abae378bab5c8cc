"""`regress`: whether a run is worse than a baseline, for continuous integration."""

from __future__ import annotations

import json
import sys
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gridtrack.cli.options import DEBUG_OPTION, JsonOption, default_of
from gridtrack.common.errors import ConfigurationError, GridtrackError, one_line, printable

if TYPE_CHECKING:
    from gridtrack.evaluation.regression.measurement import Baseline, Measurement
    from gridtrack.evaluation.regression.settings import GateSettings
    from gridtrack.evaluation.regression.verdict import Verdict

WORSE, UNMEASURED = 1, 3
MAX_CRASH_CHARS = 300
"""Length limit of the description of an unexpected error."""


def regress_command(
    runs: Annotated[
        list[Path],
        typer.Argument(metavar="RUN...", help="A run's folder; with --update several, one for each training or seed"),
    ],
    baseline: Annotated[Path, typer.Option(help="The baseline's file")],
    margin: Annotated[
        float | None,
        typer.Option(help="The largest fall in F1 that is not worse; of log loss, 10 times it as a share"),
    ] = None,
    tolerance: Annotated[
        list[str] | None, typer.Option(metavar="LABEL=F1", help="The margin of one tracker, such as a learned one")
    ] = None,
    update: Annotated[bool, typer.Option(help="Write the run, or several, as the new baseline")] = False,
    junit: Annotated[Path | None, typer.Option(help="Write the verdict as JUnit XML")] = None,
    markdown: Annotated[Path | None, typer.Option(help="Write the verdict as Markdown")] = None,
    speed_reference: Annotated[
        str | None, typer.Option(metavar="LABEL", help="Judge speed too, as a ratio to this tracker's times")
    ] = None,
    speed_margin: Annotated[
        float | None, typer.Option(help="The largest growth of that ratio that is not worse")
    ] = None,
    confirm: Annotated[
        bool, typer.Option("--confirm", help="Run what looks worse a second time; it is worse if it is worse again")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Compare a run with a baseline: is any tracker worse? A baseline of several trainings holds their spread too.

    Exit code: 0 no worse, 1 worse, 2 wrong use, 3 not measured: a trial failed, is missing, or does not pair.
    """
    if speed_margin is not None and speed_reference is None:
        raise ConfigurationError("--speed-margin: speed is judged only with --speed-reference LABEL")
    if len(runs) > 1 and not update:
        raise ConfigurationError(f"{len(runs)} runs: one is judged at a time; --update makes a baseline of several")
    if confirm and update:
        raise ConfigurationError("--confirm: --update judges nothing; leave one of the two out")
    values = {
        "margin": margin,
        "tolerance": dict(map(_tolerance, tolerance or ())),
        "speed_reference": speed_reference,
        "speed_margin": speed_margin,
    }
    try:
        if update:
            _update_baseline(runs, baseline)
            return
        verdict = _judge(runs[0], baseline, _settings(values), confirm)
        _report_verdict(verdict, junit, markdown, as_json)
    except Exception as error:
        reasons = _reasons_unmeasured(error)
        if not reasons:
            raise
        _report_unmeasured(reasons, junit, markdown, as_json)
        raise typer.Exit(UNMEASURED) from None
    if verdict.worse:
        raise typer.Exit(WORSE)


def regress_defaults() -> dict[str, str]:
    """The default of each option of `regress`, as text."""
    from gridtrack.evaluation.regression.settings import MARGIN, GateSettings
    from gridtrack.evaluation.statistics.jackknife import LEAST_UNITS

    return {
        "margin": f"{MARGIN:g} with {LEAST_UNITS} units or more, 0 with fewer",
        "speed_margin": f"{default_of(GateSettings, 'speed_margin'):g}",
    }


def _update_baseline(runs: Sequence[Path], baseline: Path) -> None:
    """Write `runs` as the baseline and print its content."""
    from gridtrack.evaluation.regression.baseline import write_baseline
    from gridtrack.evaluation.regression.measuring import measure_run
    from gridtrack.reports.regression import text_of_update

    if len({run.resolve() for run in runs}) < len(runs):
        raise ConfigurationError("a run is given twice: each run of a baseline is a training or a seed of its own")
    first = measure_run(runs[0])
    written = write_baseline(baseline, [first, *(measure_run(run, like=first) for run in runs[1:])])
    typer.echo(text_of_update(baseline, written))


def _settings(values: dict[str, Any]) -> GateSettings:
    """The settings of the gate from the options that were given."""
    from gridtrack.common.config import validated
    from gridtrack.evaluation.regression.settings import GateSettings

    given = {key: value for key, value in values.items() if value is not None}
    return validated(GateSettings, given, "gridtrack regress")


def _judge(run: Path, baseline: Path, settings: GateSettings, confirm: bool) -> Verdict:
    """The verdict on the run in the folder `run`, with `confirm` after a second run of what looks worse."""
    from gridtrack.evaluation.regression.baseline import read_baseline
    from gridtrack.evaluation.regression.measuring import measure_run
    from gridtrack.evaluation.regression.verdict import compare_with_baseline

    stored = read_baseline(baseline)
    measured = measure_run(run, like=stored.first)
    verdict = compare_with_baseline(stored, measured, settings)
    return _confirmed(verdict, stored, measured, settings, run) if confirm else verdict


def _confirmed(
    verdict: Verdict, baseline: Baseline, measured: Measurement, settings: GateSettings, run: Path
) -> Verdict:
    from gridtrack.evaluation.processes.shielding import shield_host
    from gridtrack.evaluation.regression.confirmation import confirmed
    from gridtrack.evaluation.regression.rerun import Trials, run_again
    from gridtrack.reports.run_progress import RunProgress

    def again(trials: Trials, timed: bool) -> list[Measurement]:
        shield_host("gridtrack regress")
        with RunProgress() as progress:
            return run_again(run, trials, baseline.first, timed, progress)

    return confirmed(verdict, baseline, measured, settings, again)


def _reasons_unmeasured(error: Exception) -> Sequence[str]:
    """Why there is no verdict, one line each; none where `error` is wrong use, which the command line reports.

    A crash is a reason: its exit code must not be 1, which means worse. `--debug` prints its traceback.
    """
    from gridtrack.evaluation.regression.measurement import Unmeasured

    if isinstance(error, Unmeasured):
        return error.reasons
    # an OSError with a file name is a path in an option that cannot be read or written
    if isinstance(error, GridtrackError) or (isinstance(error, OSError) and error.filename):
        return ()
    if DEBUG_OPTION in sys.argv:
        traceback.print_exception(error)
    what = one_line(f"{type(error).__name__}: {error}", MAX_CRASH_CHARS)
    return [f"regress failed ({what}); {DEBUG_OPTION} shows the traceback"]


def _tolerance(text: str) -> tuple[str, float]:
    label, _, value = text.rpartition("=")
    try:
        return label, float(value)
    except ValueError:
        raise ConfigurationError(f"--tolerance '{text}': expected LABEL=F1, such as my-tracker=0.01") from None


def _report_verdict(verdict: Verdict, junit: Path | None, markdown: Path | None, as_json: bool) -> None:
    from gridtrack.reports.junit import junit_of
    from gridtrack.reports.regression import data_of, markdown_of, text_of

    _write_report(junit, junit_of, verdict)
    _write_report(markdown, markdown_of, verdict)
    typer.echo(json.dumps(data_of(verdict), indent=1) if as_json else text_of(verdict))


def _report_unmeasured(reasons: Sequence[str], junit: Path | None, markdown: Path | None, as_json: bool) -> None:
    from gridtrack.reports.junit import junit_of_unmeasured
    from gridtrack.reports.regression import markdown_of_unmeasured

    _write_report(junit, junit_of_unmeasured, reasons)
    _write_report(markdown, markdown_of_unmeasured, reasons)
    if as_json:
        typer.echo(json.dumps({"verdict": "not measured", "reasons": list(reasons)}, indent=1))
    for reason in reasons:
        typer.echo(f"gridtrack: not measured: {printable(reason)}", err=True)


def _write_report(path: Path | None, rendered: Any, content: Any) -> None:
    """Write to `path`; a pipe or a device, such as /dev/stdout, cannot be replaced and is written in place."""
    from gridtrack.common.files import write_text

    if path is None:
        return
    if path.exists() and not path.is_file():
        path.write_text(rendered(content), "utf-8")
    else:
        write_text(path, rendered(content))
