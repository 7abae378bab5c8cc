"""`regress`: whether a run is worse than a baseline, for continuous integration."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gridtrack.cli.options import JsonOption
from gridtrack.common.errors import ConfigurationError, printable

if TYPE_CHECKING:
    from gridtrack.evaluation.regression import Verdict

WORSE, UNMEASURED = 1, 3


def regress_command(
    runs: Annotated[
        list[Path], typer.Argument(metavar="RUN...", help="A run's folder; with --update several, each a training")
    ],
    baseline: Annotated[Path, typer.Option(help="The baseline's file")],
    margin: Annotated[float, typer.Option(help="A fall in F1 that does not matter")] = 0.005,
    tolerance: Annotated[
        list[str] | None, typer.Option(metavar="LABEL=F1", help="In place of the margin, for a tracker that learns")
    ] = None,
    update: Annotated[bool, typer.Option(help="Write the run, or several, as the new baseline if complete")] = False,
    junit: Annotated[Path | None, typer.Option(help="Write the verdict as JUnit XML")] = None,
    markdown: Annotated[Path | None, typer.Option(help="Write the verdict as Markdown")] = None,
    speed_reference: Annotated[
        str | None, typer.Option(metavar="LABEL", help="Judge speed too, as a ratio to this tracker's")
    ] = None,
    speed_margin: Annotated[float | None, typer.Option(help="Growth of that ratio that does not matter; 0.5")] = None,
    as_json: JsonOption = False,
) -> None:
    """Is a run worse than a baseline? A baseline of several trainings counts what separates them as chance.

    Exit code: 0 no worse, 1 worse, 2 wrong use, 3 not measured: something failed, is missing, or does not pair.
    """
    from gridtrack.common.config import validated
    from gridtrack.evaluation.regression import (
        GateSettings,
        Unmeasured,
        compare_with_baseline,
        measure_run,
        read_baseline,
    )

    given = {"margin": margin, "tolerance": dict(map(_tolerance, tolerance or ())), "speed_reference": speed_reference}
    if speed_margin is not None:
        if speed_reference is None:
            raise ConfigurationError("--speed-margin: speed is judged only with --speed-reference LABEL")
        given["speed_margin"] = speed_margin
    settings = validated(GateSettings, given, "gridtrack regress")
    try:
        if update:
            _update(runs, baseline)
            return
        if len(runs) > 1:
            raise ConfigurationError(f"{len(runs)} runs: one is judged at a time; --update makes a baseline of several")
        against = read_baseline(baseline)
        verdict = compare_with_baseline(against, measure_run(runs[0], like=against.first), settings)
    except Unmeasured as error:
        _tell_unmeasured(error.reasons, junit, markdown, as_json)
        raise typer.Exit(UNMEASURED) from None
    _tell(verdict, junit, markdown, as_json)
    if verdict.worse:
        raise typer.Exit(WORSE)


def _update(runs: Sequence[Path], baseline: Path) -> None:
    """Write `runs` as the baseline and tell what it holds."""
    from gridtrack.evaluation.regression import measure_run, write_baseline
    from gridtrack.reports.regression import text_of_update

    if len({run.resolve() for run in runs}) < len(runs):
        raise ConfigurationError("a run is given twice: each is a training or a seed of its own")
    first = measure_run(runs[0])
    written = write_baseline(baseline, [first, *(measure_run(run, like=first) for run in runs[1:])])
    typer.echo(text_of_update(baseline, written))


def _tolerance(text: str) -> tuple[str, float]:
    label, _, value = text.rpartition("=")
    try:
        return label, float(value)
    except ValueError:
        raise ConfigurationError(f"--tolerance '{text}': expected LABEL=F1, such as my-tracker=0.01") from None


def _tell(verdict: Verdict, junit: Path | None, markdown: Path | None, as_json: bool) -> None:
    from gridtrack.reports.junit import junit_of
    from gridtrack.reports.regression import data_of, markdown_of, text_of

    _write(junit, junit_of, verdict)
    _write(markdown, markdown_of, verdict)
    typer.echo(json.dumps(data_of(verdict), indent=1) if as_json else text_of(verdict))


def _tell_unmeasured(reasons: Sequence[str], junit: Path | None, markdown: Path | None, as_json: bool) -> None:
    from gridtrack.reports.junit import junit_of_unmeasured
    from gridtrack.reports.regression import markdown_of_unmeasured

    _write(junit, junit_of_unmeasured, reasons)
    _write(markdown, markdown_of_unmeasured, reasons)
    if as_json:
        typer.echo(json.dumps({"verdict": "not measured", "reasons": list(reasons)}, indent=1))
    for reason in reasons:
        typer.echo(f"gridtrack: not measured: {printable(reason)}", err=True)


def _write(path: Path | None, rendered: Any, content: Any) -> None:
    if path is not None:
        path.write_text(rendered(content), "utf-8")
