"""`gridtrack regress --confirm`: worse rows run again, and stay worse if the second run is worse too."""

from __future__ import annotations

import json
import shutil
import sys
from xml.etree import ElementTree

import pytest

from gridtrack.evaluation.regression.confirmation import confirmed
from gridtrack.evaluation.regression.measurement import Baseline
from gridtrack.evaluation.regression.measuring import measure_run
from gridtrack.evaluation.regression.settings import GateSettings
from gridtrack.evaluation.regression.verdict import compare_with_baseline
from gridtrack.evaluation.runs.plan import resolve
from gridtrack.evaluation.runs.runner import run
from gridtrack.evaluation.runs.settings import CompareSettings
from tests.evaluation.conftest import RecordedProgress

from scenes.edited_run import edit
from scenes.programs_here import programs_here
from scenes.room import write_room
from studies.support.plugins import write_distribution

MOODY = '''
from pathlib import Path
import numpy as np
from gridtrack.common.config import Settings
from gridtrack.trackers.contract import Forecast, Tracker


class Options(Settings):
    folder: str


class Moody(Tracker):
    """Forecasts the last frame; nothing if its folder has a file `bad`; crashes if it has a file `broken`."""

    Options = Options

    def reset(self, seed):
        folder = Path(self.options.folder)
        with (folder / "starts").open("a") as starts:
            starts.write(".")
        self.bad = (folder / "bad").exists()
        if (folder / "broken").exists():
            raise RuntimeError("broken")

    def update(self, frame):
        self.last = frame.occupied

    def predict(self, steps):
        shown = np.zeros_like(self.last) if self.bad else self.last
        return Forecast(np.repeat(shown[None].astype(np.float32), steps + 1, axis=0))
'''


MOODY_FILES = {"moody": "moody_tracker:Moody"}, {"moody_tracker.py": MOODY}


@pytest.fixture(scope="module")
def mood(tmp_path_factory):
    """The folder with the files that control the tracker `moody`."""
    return tmp_path_factory.mktemp("mood")


@pytest.fixture
def folder(install, mood, trackers_here):
    """The folder `mood` without files, and the tracker."""
    install("moody", *MOODY_FILES)
    for file in mood.iterdir():
        file.unlink()
    return mood


@pytest.fixture(scope="module")
def compared(mood, tmp_path_factory):
    """The runs `then`, of a good `moody`, and `now`, of a bad one beside a steady tracker."""
    made = tmp_path_factory.mktemp("runs")
    walls = {"one": 3.0, "two": 3.4}
    recordings = tuple(str(write_room(made / f"{name}.mcap", 8, {}, wall_m=wall)) for name, wall in walls.items())
    trackers, site = (f"moody:folder={mood}", "blank"), made / "site"
    site.mkdir()
    write_distribution(site, "moody", *MOODY_FILES, group="gridtrack.trackers")
    with pytest.MonkeyPatch.context() as patched, programs_here():
        patched.syspath_prepend(str(site))
        for name in ("then", "now"):
            how = {"out": made / name, "horizon_s": 1.0, "jobs": 1, "no_floors": True}
            settings = CompareSettings(recordings=recordings, trackers=trackers, **how)
            run(resolve(settings), ("gridtrack", "compare"), RecordedProgress())
            (mood / "bad").touch()
    return made


@pytest.fixture
def runs(folder, compared, regress, tmp_path):
    """Copies of both runs, the first with a baseline; `moody` is bad."""
    for name in ("then", "now"):
        shutil.copytree(compared / name, tmp_path / name)
    baseline = tmp_path / "baseline.json"
    assert regress(tmp_path / "then", "--baseline", baseline, "--update").code == 0
    (folder / "bad").touch()
    return tmp_path / "now", baseline


def test_a_fall_in_the_first_run_only_is_not_worse_and_both_results_are_printed(runs, folder, regress, tmp_path):
    now, baseline = runs
    assert regress(now, "--baseline", baseline).code == 1
    assert not (folder / "starts").exists()
    (folder / "bad").unlink()
    junit, page = tmp_path / "junit.xml", tmp_path / "page.md"
    done = regress(now, "--baseline", baseline, "--confirm", "--junit", junit, "--markdown", page)
    assert done.code == 0
    lines = [line for line in done.out.splitlines() if line.startswith("not confirmed: moody, visible, 0 to 0.5 s")]
    assert lines[0].partition("; in a second run: ")[2].startswith("F1 0.")
    assert lines[0].count("is worse") == 1
    assert "no worse than the baseline" in done.out
    assert (folder / "starts").read_text() == ".."  # its two trials, and no other
    assert "| not confirmed |" in page.read_text()
    assert "; in a second run: F1 0." in page.read_text()
    suite = ElementTree.parse(junit).getroot()
    assert suite.get("failures") == "0"
    assert any("; in a second run: F1 0." in case.text for case in suite.findall("testcase/system-out"))


def test_a_fall_in_both_runs_is_worse(runs, folder, regress):
    now, baseline = runs
    done = regress(now, "--baseline", baseline, "--confirm", "--json")
    verdict = json.loads(done.out)
    assert (done.code, verdict["verdict"]) == (1, "worse")
    assert {look["first"]["label"] for look in verdict["second_looks"]} == {"moody"}
    assert all(look["confirmed"] and look["second"]["fall"] > 0 for look in verdict["second_looks"])


def test_a_second_run_that_fails_or_has_other_inputs_is_not_measured(runs, folder, regress):
    now, baseline = runs
    (folder / "broken").touch()
    done = regress(now, "--baseline", baseline, "--confirm")
    assert (done.code, "not measured: moody@one: " in done.err) == (3, True), done.err
    edit(now, lambda record: record["versions"].update(numpy="1.0"), "run.json")
    done = regress(now, "--baseline", baseline, "--confirm")
    assert (done.code, "numpy was 1.0 in the run and is " in done.err) == (3, True)
    edit(now, lambda record: record.pop("settings"), "run.json")
    done = regress(now, "--baseline", baseline, "--confirm")
    assert (done.code, "its record has no settings, so it cannot be run again" in done.err) == (3, True)


def test_a_tracker_that_was_edited_since_the_run_is_not_measured(runs, folder, regress, tmp_path):
    now, baseline = runs
    (folder / "bad").unlink()
    module = tmp_path / "site" / "moody_tracker.py"
    module.write_text(module.read_text() + "\n# mended\n")
    done = regress(now, "--baseline", baseline, "--confirm")
    assert done.code == 3
    assert "moody: the tracker's code was edited since the run: compare again" in done.err


@pytest.mark.parametrize("trainings", [1, 3])
def test_the_same_counts_again_confirm_every_row(write_run, trainings):
    then = [{"kalman": {"seed": n, "noise": 0.01}, "other": {"seed": 10 + n}} for n in range(trainings)]
    first = measure_run(write_run("then-0", then[0]))
    others = [measure_run(write_run(f"then-{n}", then[n]), like=first) for n in range(1, trainings)]
    baseline = Baseline(digest="", runs=(first, *others))
    worse = {"kalman": {"seed": 7, "loss": 0.1, "noise": 0.01}, "other": {"seed": 17, "nats": 0.12}}
    now, settings = measure_run(write_run("now", worse), like=first), GateSettings()
    verdict = compare_with_baseline(baseline, now, settings)
    assert verdict.worse
    again = confirmed(verdict, baseline, now, settings, lambda trials, timed: [now])
    assert again.worse == verdict.worse


def test_without_a_worse_row_nothing_runs_again(runs, folder, regress, tmp_path):
    baseline = runs[1]
    done = regress(tmp_path / "then", "--baseline", baseline, "--confirm")
    assert (done.code, (folder / "starts").exists()) == (0, False)
    done = regress(tmp_path / "then", "--baseline", baseline, "--confirm", "--update")
    assert (done.code, "--confirm: --update judges nothing" in done.err) == (2, True)


def test_the_record_of_a_run_starts_no_program(folder, record, compare, regress, tmp_path):
    """The run may come from somebody else: its trackers.toml names an interpreter, which would run as the user."""
    now, baseline, programs = (tmp_path / name for name in ("now", "baseline.json", "trackers.toml"))
    programs.write_text(f'[mine]\npython = "{sys.executable}"\ntracker = "moody"\n')
    how = {"recordings": (str(record("one", seconds=8, stretches={})),), "trackers_toml": programs, "every_s": None}
    compare(f"mine:folder={folder}", "blank", **how, out=tmp_path / "then")
    assert regress(tmp_path / "then", "--baseline", baseline, "--update").code == 0
    (folder / "bad").touch()
    compare(f"mine:folder={folder}", "blank", **how, out=now)
    (folder / "starts").write_text("")
    done = regress(now, "--baseline", baseline, "--confirm")
    assert done.code == 3
    assert f"it ran programs of {programs}, and a run's record starts none: name your own file with" in done.err
    assert (folder / "starts").read_text() == ""
    done = regress(now, "--baseline", baseline, "--confirm", "--trackers-toml", programs)
    assert done.code == 1
    assert f"mine: starts again: mine folder={folder} ({sys.executable}" in done.err
    assert (folder / "starts").read_text() == "."
