"""The tables of one recording on the page, laid out for the templates, and the players."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from gridtrack.evaluation.runs.run_record import RUN_FILE
from gridtrack.reports.classes import ClassTables, class_tables
from gridtrack.reports.differences import DifferenceTable, difference_table
from gridtrack.reports.occluded_thresholds import OccludedThresholds, occluded_thresholds
from gridtrack.reports.player import Player, player_of
from gridtrack.reports.run import ReportedRun, ReportError
from gridtrack.reports.table import HeadlineTable, row_key
from gridtrack.reports.trainings import TrainingsTable, trainings_across, trainings_table

TRACKER_COLOURS = 8
"""Further trackers repeat the colours, with broken lines."""
FLOOR_GREYS = 3
"""Floors beyond this many repeat the greys."""
RUN_DASHES = 4
"""Runs beyond this many repeat the dashes."""


@dataclass(frozen=True)
class Section:
    """The tables of one recording; what tests differences is only on the page of one run."""

    table: HeadlineTable
    differences: DifferenceTable | None
    trainings: TrainingsTable | None
    occluded_thresholds: OccludedThresholds | None
    classes: ClassTables | None


def styles_of(runs: Sequence[ReportedRun]) -> dict[str, str]:
    """The style (CSS classes) of each row on the page by its key: a colour for a tracker, a grey for the floor.

    A tracker has one colour in all runs, and where there are several each run has dashes of its own; a colour that is
    repeated then has wide lines.
    """
    colours = _colours_of(runs)
    if len(runs) == 1:
        return colours
    return {
        row_key(run.name, label): f"{colours[label]} run{i % RUN_DASHES}"
        for i, run in enumerate(runs)
        for label in run.summary.trackers
    }


def _colours_of(runs: Sequence[ReportedRun]) -> dict[str, str]:
    colours: dict[str, str] = {}
    coloured = floors = 0
    for run in runs:
        for label, entry in run.summary.trackers.items():
            if label in colours:
                continue
            if entry.ceiling:
                colours[label] = "ceiling"
            elif entry.floor:
                colours[label] = f"f{floors % FLOOR_GREYS}"
                floors += 1
            else:
                colours[label] = f"t{coloured % TRACKER_COLOURS}" + (" again" if coloured >= TRACKER_COLOURS else "")
                coloured += 1
    return colours


def section_of(runs: Sequence[ReportedRun], table: HeadlineTable) -> Section:
    """The tables of one recording."""
    run = runs[0] if len(runs) == 1 else None
    return Section(
        table=table,
        differences=difference_table(run, table.recording) if run else None,
        trainings=trainings_table(run, table.recording) if run else trainings_across(runs, table),
        occluded_thresholds=occluded_thresholds(table, run),
        classes=class_tables(table, run),
    )


def players_of(
    runs: Sequence[ReportedRun], tables: Sequence[HeadlineTable], budget: int
) -> tuple[tuple[Player, ...], tuple[str, ...]]:
    """The player of each recording that kept forecasts, and notices of files that could not be read.

    The recordings share `budget` bytes for their moments, and have one moment each whatever it is.
    There are none on the page of several runs. Raises ReportError.
    """
    if len(runs) > 1:
        return (), ()
    (run,) = runs
    players: list[Player] = []
    notices: list[str] = []
    single = [table for table in tables if not table.pooled]
    for table in single:
        folders = {row.label: run.trial_folder(row.label, table.recording) for row in table.rows}
        described = run.record.configuration.recordings.get(table.recording)
        if described is None:
            raise ReportError(f"{run.path / RUN_FILE}: does not describe {table.recording}; compare again")
        player, unreadable = player_of(table, folders, described, budget // len(single))
        players += [player] if player else []
        notices += unreadable
    return tuple(players), tuple(notices)
