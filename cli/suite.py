"""`suite list | run | row | page`: a tracker beside published rows, on recordings and settings that are fixed."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from gridtrack.cli.options import (
    SandboxOption,
    TrackersTomlOption,
    WeightsOption,
    command_line,
    print_note,
    run_folder_at,
)
from gridtrack.common.errors import ConfigurationError, did_you_mean, printable
from gridtrack.trackers.selection import parse_selections

app = typer.Typer(add_completion=False, no_args_is_help=True)
SuiteArgument = Annotated[str, typer.Argument(metavar="NAME", help="A suite, or a folder with one")]
DataOption = Annotated[
    Path | None, typer.Option(metavar="FOLDER", help="Folder of the recordings; default: the data of gridtrack")
]


@app.command("list")
def suite_list() -> None:
    """The suites of gridtrack: their recordings, published rows and descriptions."""
    from gridtrack.evaluation.suites.published import published_rows
    from gridtrack.evaluation.suites.suite import read_suite, suite_folders
    from gridtrack.reports.terminal import print_rows

    suites = [(read_suite(folder), len(published_rows(folder))) for folder in suite_folders()]
    print_rows(
        [
            {"suite": suite.name, "recordings": str(len(suite.recordings)), "rows": str(rows), "about": suite.about}
            for suite, rows in suites
        ]
    )


@app.command("run")
def suite_run(
    name: SuiteArgument,
    tracker: Annotated[
        list[str] | None, typer.Option(metavar="[LABEL=]NAME[:OPTIONS]", help="Your tracker; repeat for several")
    ] = None,
    again: Annotated[
        list[str] | None,
        typer.Option(metavar="LABEL", help="Run a published row anew, and say whether its sums are equal"),
    ] = None,
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="Folder of the run")] = Path("runs/suite"),
    data: DataOption = None,
    weights: WeightsOption = None,
    trackers_toml: TrackersTomlOption = None,
    jobs: Annotated[int | None, typer.Option(min=1, help="Trials at the same time")] = None,
    sandbox: SandboxOption = False,
    resume: Annotated[bool, typer.Option("--resume", help="Run only what is missing in the folder")] = False,
) -> None:
    """Compare a tracker with the published rows of a suite, which are not run again.

    Exit code as of `gridtrack compare`; the run's folder has its own report too.
    """
    from gridtrack.evaluation.suites.leaderboard import leaderboard
    from gridtrack.evaluation.suites.published import differing_recordings, published_rows, rows_of_run
    from gridtrack.evaluation.suites.suite import DATA, read_suite, suite_folder
    from gridtrack.reports.comparison import comparison
    from gridtrack.reports.leaderboard import printed_rows, sentences
    from gridtrack.reports.terminal import print_rows

    folder = suite_folder(name)
    suite, published = read_suite(folder), {row.label: row for row in published_rows(folder)}
    own = [selection.label for selection in parse_selections(tracker or ())]
    _refuse_labels(own, again or (), published)
    values: dict[str, Any] = suite.settings(data or DATA) | {
        "trackers": [*(tracker or ()), *(published[label].selection for label in again or ())],
        "out": out,
        "resume": resume,
        "limits": {"sandbox": sandbox},
    }
    values |= {"weights": weights, "trackers_toml": trackers_toml, "jobs": jobs}
    given = {key: value for key, value in values.items() if value is not None}
    with comparison(given, print_note, command_line()) as done:
        if done.exit_code:
            raise typer.Exit(done.exit_code)
        like = next((row.measurement for row in published.values()), None)
        found = {row.label: row for row in rows_of_run(done.folder, suite.name, like=like)}
    rows = {**published, **{label: found[label] for label in own}}
    board = leaderboard(list(rows.values()), own[0] if own else (again or [""])[0], suite.headline)
    print_rows(printed_rows(board))
    for line in sentences(suite, board):
        typer.echo(printable(line))
    for label in again or ():
        differing = differing_recordings(published[label], found[label])
        equal = "its sums are equal to the published ones" if not differing else f"its sums differ on {len(differing)}"
        where = f" of {len(suite.recordings)} recordings, such as {differing[0]}" if differing else ""
        typer.echo(f"{label}: {equal}{where}")
    typer.echo(f"report: {done.report}")


def _refuse_labels(own: Sequence[str], again: Sequence[str], published: Collection[str]) -> None:
    """Raise ConfigurationError for a row to run again that is not published, or a tracker with its label."""
    if unknown := next((label for label in again if label not in published), None):
        raise ConfigurationError(f"--again {unknown}: no such row; {did_you_mean(unknown, published)}")
    if taken := next((label for label in own if label in published), None):
        raise ConfigurationError(f"--tracker {taken}: a published row has this label: name yours, as in mine={taken}")
    if not own and not again:
        raise ConfigurationError("name a --tracker, or a published row to run --again")


@app.command("row")
def suite_row(
    run: Annotated[
        Path,
        typer.Argument(metavar="RUN", help="The folder of a run on the suite, or its URL", parser=run_folder_at),
    ],
    suite: Annotated[str, typer.Option(metavar="NAME", help="The suite of the run")],
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="Folder for the rows, LABEL.json each")],
    credit: Annotated[str, typer.Option(metavar="TEXT", help="Who made the tracker, and where it is")] = "",
) -> None:
    """Write the rows of a run as small files, which others compare with without running the tracker."""
    from gridtrack.evaluation.suites.leaderboard import why_not_paired
    from gridtrack.evaluation.suites.published import published_rows, row_file, rows_of_run, write_row
    from gridtrack.evaluation.suites.suite import suite_folder

    folder = suite_folder(suite)
    published = published_rows(folder)
    like = published[0].measurement if published else None
    rows = rows_of_run(run, folder.name, credit, like)
    for row in rows:
        if like and (why := why_not_paired(like, row.measurement)):
            raise ConfigurationError(f"{run}: not a run on {suite}: {row.label}: {why}")
    out.mkdir(parents=True, exist_ok=True)
    for row in rows:
        write_row(out / row_file(row), row)
        typer.echo(f"row: {out / row_file(row)}")


@app.command("page")
def suite_page(
    name: SuiteArgument,
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="Folder of the page")],
    row: Annotated[list[Path] | None, typer.Option(metavar="FILE", help="A row beside the published ones")] = None,
    reference: Annotated[
        str, typer.Option(metavar="LABEL", help="The row that differences are from; default: the best one")
    ] = "",
) -> None:
    """Write the leaderboard of a suite as a page that opens from disk."""
    from gridtrack.evaluation.suites.leaderboard import leaderboard
    from gridtrack.evaluation.suites.published import published_rows, read_row
    from gridtrack.evaluation.suites.suite import read_suite, suite_folder
    from gridtrack.reports.leaderboard import render_leaderboard

    folder = suite_folder(name)
    suite, rows = read_suite(folder), {one.label: one for one in (*published_rows(folder), *map(read_row, row or ()))}
    if not rows:
        raise ConfigurationError(f"{folder}: no published rows: `gridtrack suite row RUN --suite {name}` writes some")
    if reference and reference not in rows:
        raise ConfigurationError(f"--reference {reference}: no such row; {did_you_mean(reference, rows)}")
    board = leaderboard(list(rows.values()), reference, suite.headline)
    typer.echo(f"page: {render_leaderboard(suite, board, out)}")
