"""`report`: write the report of a run, or of several side by side."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated

import typer

from gridtrack.cli.completion import complete_format
from gridtrack.cli.options import print_note, run_folder_at
from gridtrack.common.errors import ConfigurationError, printable
from gridtrack.common.files import atomic_write

app = typer.Typer(add_completion=False)


@app.command()
def report_command(
    runs: Annotated[list[str], typer.Argument(metavar="RUN", help="The folder of a run, or its URL")],
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="PATH",
            help="The folder of the page, or the file of another format; default: report in the run's folder,"
            " NAME-report here for a URL, or stdout",
        ),
    ] = None,
    as_format: Annotated[
        str,
        typer.Option(
            "--format",
            metavar="FORMAT",
            help="html, markdown, latex, csv, junit, svg or pdf",
            autocompletion=complete_format,
        ),
    ] = "html",
    rows: Annotated[
        str, typer.Option(metavar="LABEL,...", help="Rows of another format; * and ? stand for any text and sign")
    ] = "",
    columns: Annotated[
        str,
        typer.Option(
            metavar="SCORE STRATUM HORIZON,...",
            help="Columns of another format: 'f1 in-motion 1s, log_loss visible'",
        ),
    ] = "",
    recordings: Annotated[
        str, typer.Option(metavar="NAME,...", help="Recordings, each alone; * and ? stand for any text and sign")
    ] = "",
    rerun: Annotated[
        bool,
        typer.Option("--rerun", help="The kept forecasts for the Rerun viewer, as RECORDING.rrd beside the page"),
    ] = False,
) -> None:
    """Write the report of a run again, or of several runs side by side: as a page, or in another format."""
    from gridtrack.reports.formats import PAGE, check_format, render_as
    from gridtrack.reports.page import render_report
    from gridtrack.reports.python_api import default_report_folder

    check_format(as_format)
    if rerun and (as_format != PAGE or columns):
        raise ConfigurationError("--rerun: forecasts have neither --format nor --columns: leave them out")
    if as_format == PAGE and not rerun and (rows or columns):
        raise ConfigurationError("--rows and --columns: the page shows every row; choose another --format")
    folders, out_folder = [run_folder_at(run) for run in runs], out or default_report_folder(runs)
    if as_format != PAGE:
        _write_rendered(render_as(as_format, folders, rows, columns, recordings), out)
    elif rerun:
        _write_rerun(folders, out_folder, rows, recordings)
    else:
        typer.echo(f"report: {render_report(folders, out_folder, recordings)}")


def _write_rerun(runs: list[Path], out: Path | None, rows: str, recordings: str) -> None:
    """Write the kept forecasts of a run for the Rerun viewer."""
    from gridtrack.reports.viewers import write_rerun_run

    if len(runs) > 1:
        raise ConfigurationError("--rerun: one run at a time")
    written, notices = write_rerun_run(runs[0], out, rows, recordings)
    for notice in notices:
        print_note(notice)
    for path in written:
        typer.echo(f"open the forecasts with: {shlex.join(['rerun', printable(str(path))])}")


def _write_rendered(content: bytes, out: Path | None) -> None:
    """Write to `out`, or to stdout."""
    if out is None:
        typer.echo(content, nl=False)
        return
    if out.is_dir():
        raise ConfigurationError(f"{out}: is a folder: --out is the file of this format")
    with atomic_write(out) as file:
        file.write(content)
