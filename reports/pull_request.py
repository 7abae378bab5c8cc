"""The result of a run as a Markdown page for a pull request, with every name escaped."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from gridtrack.reports.chosen_scores import ExportedTable
from gridtrack.reports.differences import difference_markdown
from gridtrack.reports.markdown import escaped
from gridtrack.reports.notices import notices_of
from gridtrack.reports.run import ReportedRun
from gridtrack.reports.run_description import title_of
from gridtrack.reports.table import headline_markdown


def pull_request_markdown(runs: Sequence[ReportedRun], exported: Sequence[ExportedTable]) -> str:
    """The main result in a sentence, the scores, paired differences and notices."""
    parts = [f"## gridtrack: {escaped(title_of(runs))}"]
    for one in exported:
        parts += _of_table(one, len(exported) > 1)
    notices = notices_of(runs, [one.table for one in exported])
    parts += ["\n".join(f"- {escaped(notice.text)}" for notice in notices)] if notices else []
    return "\n\n".join(parts) + "\n"


def _of_table(one: ExportedTable, titled: bool) -> Iterator[str]:
    if titled:
        yield f"### {escaped(one.table.recording)}"
    if one.lead:
        yield escaped(one.lead)
    yield headline_markdown(one.table, escaped).rstrip("\n")
    if one.differences:
        yield (
            f"Scores less those of {escaped(one.differences.reference)}, paired over {one.differences.units}; p of F1"
            " corrected after Holm:"
        )
        yield difference_markdown(one.differences, escaped).rstrip("\n")
