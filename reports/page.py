"""The report page: one HTML file that opens from disk, with its scripts inside and without network access."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from gridtrack.common.files import write_text
from gridtrack.reports.answer import answer_of
from gridtrack.reports.changes import changes_of
from gridtrack.reports.chosen_recordings import chosen_runs, tables_of_page
from gridtrack.reports.meanings import meanings
from gridtrack.reports.notices import Notice, notices_of
from gridtrack.reports.page_data import page_data
from gridtrack.reports.pictures import scale_png
from gridtrack.reports.priors import priors_of
from gridtrack.reports.probability_curves import probability_curves
from gridtrack.reports.recording_section import players_of, section_of, styles_of
from gridtrack.reports.run import UNDEFINED, ReportedRun, ReportError, read_runs
from gridtrack.reports.run_description import facts_of, provenance_of, title_of
from gridtrack.reports.scripts import data_in_page, joined_script, json_in_page, policy_of
from gridtrack.reports.table import headline_tables, main_tables

PAGE_BYTES = 24_000_000
"""The most that the data of a page have: what the scores leave is for moments, so that a page stays below 25 MB."""
LEFT_OUT = (
    "{} of {} recordings are not on this page, which would be too large: it has those on which the trackers differ"
    " most. gridtrack report RUN --recordings NAME,... shows others, and --format csv has the scores of all"
)
TEMPLATES = Path(__file__).parent / "templates"


def render_report(runs: Sequence[Path], out: Path | None = None, recordings: str = "") -> Path:
    """Write the report of `runs` and return its path: index.html in the folder `out`, or report of the run's folder.

    Several runs are on one page, side by side: without `out` it is report/side-by-side.html of the first. `recordings`:
    patterns as of chosen_runs. Raises ConfigurationError, RunError and ReportError.
    """
    if out is not None and (out.is_file() or out.suffix in (".html", ".htm")):
        raise ReportError(
            f"{out}: the report is index.html in a folder: name the folder, as in --out {out.with_suffix('')}"
        )
    content = render_page(chosen_runs(read_runs(runs), recordings))
    beside = runs[0] / "report" / ("index.html" if len(runs) == 1 else "side-by-side.html")
    path = out / "index.html" if out is not None else beside
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, content)
    return path


def render_page(runs: Sequence[ReportedRun]) -> str:
    """The page as HTML. Raises ReportError where a trial's files do not fit the summary."""
    every = headline_tables(runs)
    tables, left_out = tables_of_page(every)
    styles = styles_of(runs)
    curves, unreadable = probability_curves(runs, tables)
    priors, unread = priors_of(runs, tables, styles)
    scores = {**page_data(runs, tables, styles, curves), "priors": priors}
    players, damaged = players_of(runs, tables, PAGE_BYTES - len(data_in_page(scores)))
    css, script = (TEMPLATES / "page.css").read_text("utf-8"), joined_script()
    return (
        _environment()
        .get_template("page.html.j2")
        .render(
            title=title_of(runs),
            answers=[answer_of(run) for run in runs],
            changes=changes_of(runs) if len(runs) > 1 else (),
            runs=[(run, facts_of(run, {table.recording for table in tables}), provenance_of(run)) for run in runs],
            notices=[Notice(text, serious=True) for text in (*damaged, *unreadable, *unread)]
            + ([Notice(LEFT_OUT.format(left_out, sum(not table.pooled for table in every)))] if left_out else [])
            + notices_of(runs, every),
            sections=[section_of(runs, table) for table in main_tables(tables)],
            players=players,
            styles=styles,
            meanings=meanings(),
            scale=scale_png(),
            css=Markup(css),  # a file of this package, no text of a run
            script=script,
            data=data_in_page({**scores, "players": [player.data["recording"] for player in players]}),
            moments=[json_in_page(player.data) for player in players],
            policy=Markup(policy_of([script], [css])),
        )
    )


def render_tables(run: Path) -> str:
    """The main tables of a run as HTML, for a notebook. Raises RunError and ReportError."""
    tables = main_tables(headline_tables(read_runs([run])))
    return _environment().get_template("tables.html.j2").render(tables=tables)


def _environment() -> Environment:
    """Templates with every value escaped: names and reasons in a run's folder are not trusted."""
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["score"] = _score
    return environment


def _score(value: float | None, digits: int = 3) -> str:
    return UNDEFINED if value is None else f"{value:.{digits}f}"
