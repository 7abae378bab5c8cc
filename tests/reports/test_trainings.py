"""The table of trackers with several trainings on the page; a run without any has none."""

import json

from gridtrack.reports.page import render_report
from gridtrack.reports.run import read_runs
from gridtrack.reports.trainings import trainings_table


def score(**values):
    return {"stratum": "in-motion", "horizon_s": 1.0, "step": 8, "f1": [0.5, 0.6], **values}


def test_trainings_have_mean_spread_and_judged_difference(make_run, tmp_path):
    run = make_run(tmp_path / "run")
    assert trainings_table(read_runs([run])[0], "crossing") is None
    summary = json.loads((run / "summary.json").read_text())
    common = {"recordings": "crossing", "reference": "persistence", "units": 20}
    judged = {"difference": 0.25, "difference_low": 0.125, "difference_high": 0.375, "p_holm": 0.01}
    summary["trainings"] = [
        {**common, "tracker": "persistence", "labels": ["persistence"], "scores": [score(f1=[0.3], f1_mean=0.3)]},
        {
            **common,
            "tracker": "net",
            "labels": ["good", "<b>good</b> 2"],
            "scores": [score(f1_mean=0.55, f1_spread=0.0707, verdict="better", **judged)],
        },
        {
            **common,
            "tracker": "other",
            "labels": ["other"],
            "interval": "one training: the spread between trainings is not known",
            "scores": [score(f1=[0.4], f1_mean=0.4, difference=0.1, verdict="not tested")],
        },
    ]
    (run / "summary.json").write_text(json.dumps(summary))
    table = trainings_table(read_runs([run])[0], "crossing")
    assert table.columns == (("in-motion", 1.0),)
    floor, net, other = table.rows
    assert (net.label, net.count) == ("good", 2)
    (cell,) = net.cells
    assert (cell.mean, cell.spread) == ("0.550", "± 0.071")
    assert (cell.difference, cell.p, cell.verdict) == ("+0.250 [+0.125, +0.375]", "p = 0.010", "better")
    assert (floor.cells[0].mean, floor.cells[0].spread, floor.cells[0].difference) == ("0.300", "", "")
    assert (other.cells[0].difference, other.cells[0].verdict) == ("+0.100", "")
    page = render_report([run]).read_text("utf-8")
    assert "Several trainings" in page
    assert "one training: the spread between trainings is not known" in page
    assert "± 0.071" in page
