"""`compare`: run trackers on recordings."""

from __future__ import annotations

from typing import Any

import typer

from gridtrack.cli.options import JsonOption, command_line, print_note, settings_options
from gridtrack.evaluation.runs.settings import CompareSettings

app = typer.Typer(add_completion=False)


@app.command()
@settings_options(CompareSettings)
def compare_command(values: dict[str, Any], as_json: JsonOption = False) -> None:
    """Run trackers on recordings, each in its own process, score them, and write a report.

    Exit code:
      0 every trial is complete
      2 wrong use
      3 a trial is not complete, or lacks a requested measurement
    130 interrupted by Ctrl-C, SIGTERM, SIGHUP or SIGQUIT, or too little memory: the summary has the scores so far;
        with --follow Ctrl-C ends the recording, and the run is complete
    """
    from gridtrack.evaluation.runs.result_files import json_of
    from gridtrack.reports.comparison import comparison
    from gridtrack.reports.terminal import print_result

    with comparison(values, print_note, command_line()) as done:
        if as_json:
            typer.echo(json_of(done.summary))
        else:
            print_result(done.folder)
    if not as_json:
        typer.echo(f"report: {done.report}")
    raise typer.Exit(done.exit_code)
