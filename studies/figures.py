"""Numbers and tables of the pages, filled from committed results.

`python -m studies.figures [--check]` (a second) writes between markers, which are HTML comments:

    <!-- value: junction: kalman: f1 dynamic 1 s -->0.693<!-- /value -->
    <!-- value: trackers/dogma.json: time: processor time -->13<!-- /value -->
    <!-- table: trackers/dogma.json: velocity: table -->...<!-- /table -->
    <!-- table: moving/drives.json: scores: F1: rows [dk]* -->...<!-- /table -->
    <!-- table: junction: F1: kalman, dogma: f1 dynamic 1 s, f1 visible 1 s: intervals, best -->...<!-- /table -->
    <!-- table: junction: confusion: kalman: visible -->...<!-- /table -->
    <!-- table: junction: trainings: in-motion 1 s, dynamic 1 s -->...<!-- /table -->

`junction` and `leg_tracker` are summaries of comparisons (rows and columns: studies/kept_summary.py). Other addresses
name a results file, a section and a number or table (studies/support/results_file.py); for a file that does not exist
the page says "not measured yet". A results page has decimal numbers only between markers, in code, or among the
constants that it names: `<!-- constants: 0.5 2.5 -->`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path

from studies.kept_summary import RunScores
from studies.support.results_file import ResultSection, ResultTable, fill_pages, read_sections

NOT_MEASURED = "not measured yet"
ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "docs" / "results"
MARKED = re.compile(r"<!-- (?P<kind>value|table): (?P<address>.*?) -->(?P<content>.*?)<!-- /(?P=kind) -->", re.DOTALL)
CONSTANTS = re.compile(r"<!-- constants: (.*?) -->", re.DOTALL)
CODE = re.compile(r"^```.*?^```|^    .*?$|`[^`]*`|\]\([^)]*\)|<!--.*?-->", re.MULTILINE | re.DOTALL)
DECIMAL = re.compile(r"(?<![\w.])\d*\.\d+(?![\w]|\.\d)")


def marked_pages(root: Path = ROOT) -> list[Path]:
    """The pages with generated numbers: the results pages, and other pages that have a marker."""
    others = set((root / "docs").rglob("*.md")) - set(results_pages(root))
    return [*results_pages(root), *sorted(page for page in others if MARKED.search(page.read_text("utf-8")))]


def results_pages(root: Path = ROOT) -> list[Path]:
    """The pages with generated numbers only."""
    docs = root / "docs"
    of_trackers = [*docs.glob("trackers/*results*.md"), docs / "trackers" / "model-cards.md"]
    return sorted([root / "README.md", *docs.glob("results/**/*.md"), *of_trackers])


def filled(text: str) -> str:
    """A page with the content of its markers written anew. Raises KeyError for an unknown address."""
    return MARKED.sub(_generated, text)


def unmarked_decimals(text: str) -> Iterator[str]:
    """Line and number of each decimal outside markers, code and the constants of the page."""
    constants = {one for found in CONSTANTS.findall(text) for one in found.split()}
    rest = CODE.sub(_blank, MARKED.sub(_blank, text))
    for number, line in enumerate(rest.splitlines(), 1):
        for decimal in DECIMAL.findall(line):
            if decimal not in constants:
                yield f"line {number}: {decimal}"


def _blank(found: re.Match[str]) -> str:
    """As many lines as the match has, without its text."""
    return " " + "\n" * found[0].count("\n")


def _generated(found: re.Match[str]) -> str:
    address = [part.strip() for part in " ".join(found["address"].split()).split(": ")]
    if address[0].endswith(".json") and not (RESULTS / address[0]).exists():
        content = NOT_MEASURED if found["kind"] == "value" else f"\n*{NOT_MEASURED}*\n"
    else:
        content = _value(address) if found["kind"] == "value" else f"\n{_table(address).markdown()}\n"
    return f"<!-- {found['kind']}: {found['address']} -->{content}<!-- /{found['kind']} -->"


def _value(address: list[str]) -> str:
    if not address[0].endswith(".json"):
        return _scores(address[0]).value(*address[1:])
    source, section, *name = address
    return _section(source, section).values[": ".join(name)]


def _table(address: list[str]) -> ResultTable:
    match address:
        case [source, section, *name, rows] if source.endswith(".json") and rows.startswith("rows "):
            return _chosen_rows(_section(source, section).tables[": ".join(name)], rows.removeprefix("rows "))
        case [source, section, *name] if source.endswith(".json"):
            return _section(source, section).tables[": ".join(name)]
        case [place, "trainings", columns]:
            return _scores(place).trainings(_names(columns))
        case [place, "confusion", tracker, visibility]:
            return _scores(place).confusion(tracker, visibility)
        case [place, corner, rows, columns, *options]:
            given = [one for text in options for one in _names(text)]
            return _scores(place).table(corner, _names(rows), _names(columns), given)
    raise KeyError(f"no table '{': '.join(address)}'")


def _chosen_rows(table: ResultTable, pattern: str) -> ResultTable:
    """The rows with a first cell that matches the pattern of `fnmatch`."""
    rows = tuple(row for row in table.rows if fnmatchcase(row[0], pattern))
    if not rows:
        raise KeyError(f"no rows '{pattern}'")
    return table.model_copy(update={"rows": rows})


def _names(text: str) -> list[str]:
    return [one.strip() for one in text.split(",")]


def _section(source: str, section: str) -> ResultSection:
    return _sections(source)[section]


@cache
def _sections(source: str) -> dict[str, ResultSection]:
    return read_sections(RESULTS / source)


@cache
def _scores(place: str) -> RunScores:
    return RunScores(RESULTS / place / "summary.json")


def main(arguments: Sequence[str] | None = None) -> None:
    fill_pages(__doc__, arguments, dict.fromkeys(marked_pages(), filled))


if __name__ == "__main__":
    main()
