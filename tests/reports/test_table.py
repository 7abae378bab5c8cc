"""The main table has the values of summary.json, ranks complete trials only, and marks the best of them."""

import shutil

import pytest

from gridtrack.reports.run import ReportError, read_runs
from gridtrack.reports.table import headline_tables

from scenes.edited_run import edit, edited, put, trial_of, value_of


@pytest.fixture
def table(run_folder):
    (table,) = headline_tables(read_runs([run_folder]))
    return table


def test_every_number_is_the_one_of_the_summary_at_its_horizon(table, run_folder, summary_of):
    summary = summary_of(run_folder)
    horizons = summary["recordings"]["crossing"]["horizons_s"]
    for row in table.rows:
        for column, cell in zip(table.columns, row.cells, strict=True):
            seconds = column.heading if column.heading.endswith(" s") else column.group.partition(", ")[2]
            step = horizons.index(float(seconds.removesuffix(" s")))
            assert cell.value == value_of(trial_of(summary, row.label), column.stratum, ".".join(column.key), step)


def test_columns_are_the_marked_horizons(table):
    assert table.groups == (
        *((f"PR-AUC, {stratum}", 3) for stratum in ("in-motion", "dynamic", "visible")),
        ("PR-AUC, standing", 1),
        ("in-motion, 1 s", 4),
    )
    assert [c.heading for c in table.columns[:3]] == ["0.5 s", "1 s", "2.5 s"]
    assert [c.heading for c in table.columns[-4:]] == ["Contacts foreseen", "F1", "Log loss, nats", "FSS, 5 cells"]


def test_a_tested_score_of_another_package_has_a_column_by_its_description(run_folder, tmp_path):
    output = {"name": "depth", "title": "Surprise", "unit": "cells", "better": "lower", "tested": True, "decimals": 1}
    score = {"name": "surprise", "title": "Surprise", "about": "", "thresholded": False, "outputs": [output]}

    def add(summary):
        summary["scores"].append(score)
        put(trial_of(summary, "good"), "in-motion", "surprise.depth", 12.25, 11.5, 13.0)

    (table,) = headline_tables(read_runs([edited(run_folder, tmp_path / "run", add)]))
    (at,) = [at for at, column in enumerate(table.columns) if column.heading == "Surprise, cells"]
    (cell,) = [row.cells[at] for row in table.rows if row.label == "good"]
    assert (cell.text, cell.interval) == ("12.2", (11.5, 13.0))


def test_partial_trials_are_not_ranked(table):
    assert [row.label for row in table.rows_in("ranked")] == ["good", "fair"]
    assert [row.label for row in table.rows_in("floor")] == ["persistence", "blank"]
    (partial,) = table.rows_in("unranked")
    assert (partial.label, partial.frames, partial.trial.outcome) == ("unlucky", "7 of 20", "crashed")


def test_a_partial_trial_cannot_take_the_best_mark_by_scoring_higher(run_folder, tmp_path):
    def raise_partial(summary):
        put(trial_of(summary, "unlucky"), "in-motion", "pr_auc.area", 1.0)
        put(trial_of(summary, "good"), "in-motion", "pr_auc.area", 0.9)

    (table,) = headline_tables(read_runs([edited(run_folder, tmp_path / "run", raise_partial)]))
    best = [row.label for row in table.rows if row.cells[2].best]
    assert best == ["good"]


def test_less_is_better_for_log_loss_and_precision_alone_is_not_ranked(run_folder, tmp_path):
    lead_by_f1 = edited(run_folder, tmp_path / "run", lambda summary: summary.update(headline="f1.f1"))
    (table,) = headline_tables(read_runs([lead_by_f1]))
    values = {column.heading: i for i, column in enumerate(table.columns)}
    complete = [row for row in table.rows if row.group != "unranked"]
    least = min(row.cells[values["Log loss, nats"]].value for row in complete)
    losses = [row.cells[values["Log loss, nats"]] for row in complete]
    assert {cell.value for cell in losses if cell.best} == {least}
    assert not any(row.cells[values["Precision"]].best for row in complete)


def test_a_row_with_a_sign_of_a_memory_is_marked(run_folder, tmp_path):
    def mark(summary):
        trial_of(summary, "fair")["memory"] = "F1 is 0.5 in the first pass and 0.9 in a later one"

    (table,) = headline_tables(read_runs([edited(run_folder, tmp_path / "run", mark)]))
    assert {row.label: row.remark for row in table.rows_in("ranked")} == {"good": "", "fair": "may remember"}


def test_nothing_is_best_if_trackers_received_other_frames(run_folder, tmp_path):
    def differ(summary):
        summary["recordings"]["crossing"]["parity"] = False

    (table,) = headline_tables(read_runs([edited(run_folder, tmp_path / "run", differ)]))
    assert not table.comparable
    assert not any(cell.best for row in table.rows for cell in row.cells)


def test_a_run_of_a_short_horizon_is_shown_at_its_last_step(run_folder, tmp_path):
    def cut(summary):
        summary["recordings"]["crossing"]["horizons_s"] = [0.0, 0.125, 0.25]
        for label in summary["trackers"]:
            trial = trial_of(summary, label)
            trial["thresholds"] = {name: curve[:3] for name, curve in trial["thresholds"].items()}
            for scores in trial["strata"].values():
                for outputs in scores.values():
                    for estimate in outputs.values():
                        estimate.update({end: curve and curve[:3] for end, curve in estimate.items()})
        summary["differences"] = []

    (table,) = headline_tables(read_runs([edited(run_folder, tmp_path / "run", cut)]))
    assert [c.heading for c in table.columns if c.key == ("pr_auc", "area")] == ["0.25 s"] * 4
    assert table.decisive.step == 2


def test_two_runs_share_a_table_but_are_not_ranked_against_each_other_on_another_input(run_folder, tmp_path):
    def differ(record):
        record["configuration"]["recordings"]["crossing"]["sha256"] = "another"

    other = shutil.copytree(run_folder, tmp_path / "other")
    (table,) = headline_tables(read_runs([run_folder, other]))
    assert table.comparable
    assert {row.name for row in table.rows_in("ranked")} == {"demo: good", "demo: fair", "other: good", "other: fair"}
    (table,) = headline_tables(read_runs([run_folder, edit(other, differ, "run.json")]))
    assert not table.comparable


def test_runs_of_different_rates_are_refused_side_by_side(run_folder, tmp_path):
    def slow(summary):
        described = summary["recordings"]["crossing"]
        described["horizons_s"] = [2 * h for h in described["horizons_s"]]

    other = edited(run_folder, tmp_path / "other", slow)
    with pytest.raises(ReportError, match="8 and 4 Hz"):
        headline_tables(read_runs([run_folder, other]))
