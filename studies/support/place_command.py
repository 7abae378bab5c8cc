"""Studies that compare trackers with general weights at unseen places: command line, comparison, results and chart."""

from __future__ import annotations

import argparse
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gridtrack.evaluation.referee.splits import ORACLE

from studies.support.comparison import compare
from studies.support.drawings import COLOURS, SETTINGS, write_svg
from studies.support.results_file import NONE, ResultSection, ResultTable, study_parser, write_section
from studies.support.unseen_places import FAMILIES, REFERENCE, TRAININGS, WEIGHTS, general_rows

WORLDS = Path("data/worlds/test")
SKILL = "fractions skill"
"""The table of a results file that the chart shows."""
DASHES = {"0.5": "-", "1": "--"}
"""The drawn horizons, seconds."""
CHARTS_IN_A_ROW = 3
GREY = "#777"


def place_parser(documentation: str | None, out: Path, results: Path) -> argparse.ArgumentParser:
    """The options that such studies have in common; `out` is the folder of the run."""
    parser = study_parser(documentation)
    parser.add_argument("--tracker", action="append", help="the label of a row; default: all rows that can run")
    parser.add_argument("--weights", type=Path, default=WEIGHTS, help="folder of the general weights")
    parser.add_argument("--trainings", type=Path, default=TRAININGS, help="folder of seed-2, seed-3, ...")
    parser.add_argument("--every", default="1s", help="between two scored forecasts")
    parser.add_argument("--out", type=Path, default=out, help="folder of the run, default: %(default)s")
    parser.add_argument("--results", type=Path, default=results, help="results file, default: %(default)s")
    parser.add_argument("--jobs", default="1", help="trials at the same time")
    parser.add_argument("--collect", action="store_true", help="run nothing; write the results of the finished run")
    return parser


def worlds_called(names: Sequence[str] | None) -> list[Path]:
    """The test worlds of these names; without names all of them. Ends the program for an unknown name."""
    worlds = {path.stem: path for path in sorted(WORLDS.glob("*.tracks"))}
    if unknown := [name for name in names or () if name not in worlds]:
        raise SystemExit(f"--world {', '.join(unknown)}: no such world; there are {', '.join(worlds)}")
    return [worlds[name] for name in names or worlds]


def compare_places(given: argparse.Namespace, recordings: Sequence[Path], out: Path) -> None:
    """Compare the rows of `--tracker` on `recordings`, with the thresholds of the cards, in the folder `out`."""
    rows = general_rows(given.weights, given.trainings)
    if unknown := [label for label in given.tracker or () if label not in rows]:
        raise SystemExit(f"--tracker {', '.join(unknown)}: no row that can run; there are {', '.join(rows)}")
    chosen = [rows[label] for label in given.tracker or rows]
    compare(recordings, None, chosen, out, "--every", given.every, "--jobs", given.jobs, "--resume")


def write_places(results: Path, sections: Mapping[str, ResultSection]) -> None:
    """Write and print the sections of a results file, and draw the chart beside it."""
    for name, section in sections.items():
        write_section(results, name, section)
        print(section.text(), end="\n\n")
    draw_skill(sections["scores"].tables[SKILL], results.with_name("scales.svg"))


def draw_skill(table: ResultTable, path: Path) -> None:
    """Draw fractions skill by the side of a neighbourhood: a chart for each family of trackers in the table.

    Beside them are the reference, in grey, and the oracle; a table without other trackers gives one chart of these.
    """
    curves = skill_curves(table)
    measured = {name: [one for one in members if one in curves] for name, members in FAMILIES.items()}
    families = {name: members for name, members in measured.items() if members} or {REFERENCE: []}
    columns = min(len(families), CHARTS_IN_A_ROW)
    rows = -(-len(families) // columns)
    with matplotlib.rc_context(SETTINGS):
        figure = Figure((2.6 * columns, 2.6 * rows), layout="constrained")
        charts = list(figure.subplots(rows, columns, squeeze=False, sharey=True).flat)
        for axes, (name, members) in zip(charts, families.items(), strict=False):
            draw_family(axes, name, members, curves)
        for axes in charts[len(families) :]:
            axes.remove()
        figure.supxlabel("side of a neighbourhood, cells (solid: 0.5 s ahead, dashed: 1 s)", fontsize="medium")
        figure.supylabel("fractions skill score", fontsize="medium")
        write_svg(figure, path)


def skill_curves(table: ResultTable) -> dict[str, dict[str, dict[int, float]]]:
    """Scores by label, horizon and side, from columns such as `0.5 s, 3 cells`; undefined ones are left out."""
    curves: dict[str, dict[str, dict[int, float]]] = {}
    for label, *texts in table.rows:
        curves[label] = {horizon_s: {} for horizon_s in DASHES}
        for column, text in zip(table.columns[1:], texts, strict=True):
            found = re.fullmatch(r"(.+) s, (\d+) cells", column)
            assert found is not None, column
            if text != NONE:
                curves[label][found[1]][int(found[2])] = float(text.partition(" ")[0])
    return curves


def draw_family(
    axes: Axes, name: str, members: Sequence[str], curves: Mapping[str, Mapping[str, Mapping[int, float]]]
) -> None:
    """Draw one chart."""
    colours = {label: GREY for label in (REFERENCE, ORACLE) if label in curves}
    colours |= dict(zip(members, COLOURS, strict=False))
    for label, colour in colours.items():
        for horizon_s, dash in DASHES.items():
            of_side = curves[label][horizon_s]
            if of_side:
                key = label if horizon_s == "0.5" and label in members else "_"
                axes.plot(list(of_side), list(of_side.values()), dash, color=colour, label=key)
    axes.set(title=name, ylim=(0.0, 1.0), xticks=(1, 3, 5, 9), yticks=(0.0, 0.5, 1.0))
    axes.grid(axis="y", color="#ddd")
    if members:
        axes.legend(loc="lower right")
