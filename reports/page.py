"""The report page: one HTML file that opens from disk, with its scripts inside and without network access."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from gridtrack.common.files import write_text
from gridtrack.reports.answer import answer_of
from gridtrack.reports.differences import (
    DifferenceTable,
    TrainingsTable,
    difference_table,
    trainings_across,
    trainings_table,
)
from gridtrack.reports.notices import ShownNotice, notices_of
from gridtrack.reports.page_data import page_data
from gridtrack.reports.pictures import scale_png
from gridtrack.reports.player import opening_of, players_of
from gridtrack.reports.priors import priors_of
from gridtrack.reports.run import UNDEFINED, ReportedRun, ReportError, chosen_runs, read_runs
from gridtrack.reports.run_description import changes_of, provenance_of, run_facts, title_of
from gridtrack.reports.score_figures import score_figures
from gridtrack.reports.scripts import data_in_page, joined_script, json_in_page, policy_of
from gridtrack.reports.styles import TEMPLATES, page_css, styles_of
from gridtrack.reports.table import HeadlineTable, headline_tables, main_tables

PAGE_BYTES = 24_000_000
"""Limit of a page's data, bytes: moments fill the rest after the scores, so that a page stays below 25 MB."""
MOST_VALUES = 2_500_000
"""Limit of the values of all curves on a page. A value takes five bytes: half of 25 MB is left for moments."""
LEFT_OUT = (
    "{} of {} recordings are not on this page, which would be too large: it has the recordings with the largest"
    " differences between trackers. gridtrack report RUN --recordings NAME,... shows others, and --format csv has the"
    " scores of all"
)
FIGURES = Path(__file__).parents[1] / "docs" / "figures.md"
"""The package contains this page."""
_REMARK = re.compile(r" \(\[[^\]]*\]\([^)]*\)\)")
"""A link in parentheses, which is no part of the sentence."""
_MARKUP = re.compile(r"\[([^\]]*)\]\([^)]*\)|`([^`]*)`|\*([^*]*)\*")


def render_report(runs: Sequence[Path], out: Path | None = None, recordings: str = "") -> Path:
    """Write the report of `runs` and return its path: index.html in the folder `out`, by default the run's report/.

    The page of several runs is by default report/side-by-side.html of the first. `recordings`: patterns as in
    chosen_runs. Raises ConfigurationError, RunError and ReportError.
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
    """The page as HTML. Raises ReportError if a trial's files do not fit the summary."""
    every = headline_tables(runs)
    tables, left_out = tables_of_page(every)
    styles = styles_of(runs)
    figures, unreadable = score_figures(runs, tables)
    priors, unread = priors_of(runs, tables, styles)
    scores = {**page_data(runs, tables, styles, figures), "priors": priors, "left_out": left_out}
    players, damaged = players_of(runs, tables, PAGE_BYTES - len(data_in_page(scores)))
    script = joined_script()
    return (
        page_environment()
        .get_template("page.html.j2")
        .render(
            title=title_of(runs),
            answers=[answer_of(run) for run in runs],
            changes=changes_of(runs) if len(runs) > 1 else (),
            runs=[(run, run_facts(run, {table.recording for table in tables}), provenance_of(run)) for run in runs],
            notices=[ShownNotice(text, serious=True) for text in (*damaged, *unreadable, *unread)]
            + ([ShownNotice(LEFT_OUT.format(left_out, sum(not table.pooled for table in every)))] if left_out else [])
            + notices_of(runs, every),
            sections=[section_of(runs, table) for table in main_tables(tables)],
            players=players,
            styles=styles,
            meanings=meanings(),
            scale=scale_png(),
            css=Markup(page_css()),  # a file of this package, no text of a run
            script=script,
            data=data_in_page(
                {
                    **scores,
                    "players": [player.data["recording"] for player in players],
                    "opening": opening_of(players, tables[0]),
                }
            ),
            moments=[json_in_page(player.data) for player in players],
            policy=Markup(policy_of([script], [page_css()])),
        )
    )


def render_tables(run: Path) -> str:
    """The main tables of a run as HTML, for a notebook. Raises RunError and ReportError."""
    tables = main_tables(headline_tables(read_runs([run])))
    return page_environment().get_template("tables.html.j2").render(tables=tables)


def page_environment() -> Environment:
    """Templates with every value escaped: names and reasons in a run's folder are not trusted."""
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.globals["undefined"] = UNDEFINED
    return environment


@dataclass(frozen=True)
class Section:
    """The tables of one recording; tests of differences are only on the page of one run."""

    table: HeadlineTable
    differences: DifferenceTable | None
    trainings: TrainingsTable | None


def section_of(runs: Sequence[ReportedRun], table: HeadlineTable) -> Section:
    """The tables of one recording."""
    run = runs[0] if len(runs) == 1 else None
    return Section(
        table=table,
        differences=difference_table(run, table.recording) if run else None,
        trainings=trainings_table(run, table.recording) if run else trainings_across(runs, table),
    )


def tables_of_page(tables: Sequence[HeadlineTable]) -> tuple[list[HeadlineTable], int]:
    """The tables that fit on a page, in their order, and the number of the others.

    The pooled table has priority, then recordings with large differences between trackers in the decisive score. One
    table is always on the page.
    """
    kept: set[str] = set()
    values = 0
    for table in sorted(tables, key=lambda table: (not table.pooled, -_range(table))):
        values += sum(len(curve) for row in table.rows for _, curve in row.trial.curves())
        if kept and values > MOST_VALUES:
            break
        kept.add(table.recording)
    return [table for table in tables if table.recording in kept], len(tables) - len(kept)


def _range(table: HeadlineTable) -> float:
    """The difference between the best and the worst score of complete trials."""
    at = table.columns.index(table.decisive)
    rows = (*table.rows_in("ranked"), *table.rows_in("floor"))
    scores = [value for row in rows if (value := row.cells[at].value) is not None]
    return max(scores) - min(scores) if scores else 0.0


@dataclass(frozen=True, slots=True)
class Meaning:
    """The section `name` of docs/figures.md: its heading and its paragraphs, without markup, links and pictures."""

    name: str
    heading: str
    paragraphs: tuple[str, ...]


def meanings() -> list[Meaning]:
    """The sections of docs/figures.md, one for each figure and table of the page, as plain text."""
    _, *sections = re.split(r"^## ", FIGURES.read_text("utf-8"), flags=re.MULTILINE)
    return [_meaning(section) for section in sections]


def _meaning(section: str) -> Meaning:
    heading, _, text = section.partition("\n")
    paragraphs = (" ".join(one.split()) for one in text.strip().split("\n\n") if not one.startswith("!["))
    return Meaning(heading.lower().replace(" ", "-"), heading, tuple(map(_plain, paragraphs)))


def _plain(text: str) -> str:
    """Markdown without its links, code and emphasis."""
    text = _REMARK.sub("", text)
    while (plain := _MARKUP.sub(lambda found: next(filter(None, found.groups()), ""), text)) != text:
        text = plain
    return text
