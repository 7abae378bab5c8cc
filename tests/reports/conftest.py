"""The folder of a run on a synthetic scene: a wall, a moving block, and the cells that it occludes; its page opened."""

import json
from contextlib import ExitStack

import numpy as np
import pytest

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec
from gridtrack.evaluation.referee.kinds import Regions, observed_kinds
from gridtrack.evaluation.referee.referee import ScoredForecast, moments
from gridtrack.evaluation.referee.samples import SAMPLES, SampleWriter
from gridtrack.evaluation.referee.strata import STRATA
from gridtrack.evaluation.runs.finished import FinishedTrial
from gridtrack.evaluation.runs.passes import CallTimes, Latency, Quantiles
from gridtrack.evaluation.runs.run_record import RecordingDescription
from gridtrack.evaluation.runs.scorekeeper import Counter
from gridtrack.evaluation.runs.summarise import summarise
from gridtrack.evaluation.runs.sums import SumsWriter
from gridtrack.evaluation.runs.trial_record import ThresholdsUsed, TrialRecord
from gridtrack.evaluation.scores.contact_foresight import robots_of
from gridtrack.evaluation.scores.definition import TrialFacts
from gridtrack.evaluation.scores.registry import built_in
from gridtrack.evaluation.scores.thresholds import Thresholds, bins_of
from gridtrack.recordings.observation import Observation
from gridtrack.reports.page import render_report
from gridtrack.trackers.contract import Forecast

from scenes.edited_run import edited
from scenes.report_page import HOSTILE
from scenes.report_page import opened as opened_page
from scenes.synthetic_run import DESCRIBED, RECORDINGS, description, write_results, write_run_record
from scenes.synthetic_run import write_trial as write_drawn_trial

GRID = GridSpec(32, 0.2, (-3.2, 0.0))
PERIOD_S, STEPS, FRAMES, WARM_UP, EVERY = 0.125, 20, 120, 20, 4
RECORDING = "crossing"
HORIZONS_S = [round(n * PERIOD_S, 6) for n in range(STEPS + 1)]
EXPECTED = len(range(WARM_UP, FRAMES - STEPS, EVERY))


def block_at(index):
    """Column of the block's left edge: it walks to and fro, eight frames to a cell and back again."""
    return 4 + abs((index // 2) % 40 - 20)


def frame(index):
    visible, occupied = np.ones(GRID.shape, bool), np.zeros(GRID.shape, bool)
    occupied[28, 2:30] = True
    left = block_at(index)
    occupied[12, left : left + 4] = True
    visible[13:, left : left + 4] = False
    visible[29:] = False
    visible[:, :2] = visible[:, 30:] = False
    occupied &= visible
    origins = np.array([[0.0, 0.3]], np.float32)
    nothing = np.zeros((0, 2), np.float32)
    return GridFrame(index * 125_000_000, visible, occupied, SE2(), origins, nothing, np.zeros(0, np.uint8))


FRAME_LIST = [frame(index) for index in range(FRAMES)]
REGIONS = Regions(GRID, observed_kinds(map(Observation, FRAME_LIST), GRID))


class Frames(list):
    """A FrameSource of the frames."""

    grid, period_s, classes = GRID, PERIOD_S, ()


MOMENTS = list(moments(Frames(FRAME_LIST), REGIONS))
JUST_SEEN = np.zeros(GRID.shape, np.uint8)


def persistence(t):
    return np.repeat(FRAME_LIST[t].occupied[None].astype(np.float32), STEPS + 1, axis=0)


def blank(t):
    return np.zeros((STEPS + 1, *GRID.shape), np.float32)


def blurred_future(sharpness):
    """A tracker that knows the motion, with more errors at later steps: its scores are between the floor and 1."""

    def forecast(t):
        out = np.empty((STEPS + 1, *GRID.shape), np.float32)
        for step in range(STEPS + 1):
            sure = float(np.exp(-step / (sharpness * STEPS)))
            out[step] = sure * FRAME_LIST[t + step].occupied + (1 - sure) * 0.6 * FRAME_LIST[t].occupied
        return out

    return forecast


TRACKERS = {
    "good": ("good-tracker", blurred_future(1.5)),
    "fair": ("fair-tracker", blurred_future(0.5)),
    "persistence": ("persistence", persistence),
    "blank": ("blank", blank),
}
GPU = "NVIDIA H100"
"""The device of `good`; the others compute on the processor."""
LATENCY = Latency(
    update=CallTimes(p50=2.0, p95=3.0, p99=4.0, twentieths=(*tuple(1.0 + 0.1 * i for i in range(20)), 4.5)),
    predict=CallTimes(p50=20.0, p95=30.0, p99=40.0),
    predict_step=Quantiles(p50=1.0, p95=1.5, p99=2.0),
)


def write_trial(run, label, tracker, forecast, scored=EXPECTED, outcome="ok", reason="", robots=False):
    """Score `forecast` on the first `scored` frames and leave the trial's folder, as the referee does.

    `robots`: whether its samples have the paths of robots; those of earlier runs have none.
    """
    folder = run / f"{label}@{RECORDING}"
    folder.mkdir(parents=True)
    thresholds = Thresholds(bins_of(np.full((STEPS + 1, len(STRATA)), 0.375)), "crossing@0s-15s")
    facts = TrialFacts(GRID.cell_m, STEPS, STRATA, thresholds, period_s=PERIOD_S)
    counter = Counter(built_in(), facts)
    with (
        SumsWriter(folder, counter.layouts, STEPS) as sums,
        SampleWriter(folder / SAMPLES, GRID, PERIOD_S, STEPS) as samples,
    ):
        for t in list(range(WARM_UP, FRAMES - STEPS, EVERY))[:scored]:
            targets = tuple(moment.target for moment in MOMENTS[t : t + STEPS + 1])
            one = ScoredForecast(Forecast(forecast(t)), targets, MOMENTS[t].region_maps, JUST_SEEN)
            for score, counted in counter.count(one).items():
                sums.add(one.stamp_ns, f"{t:032x}", score, counted)
            samples.add(one, robots_of(one, facts, GRID.origin) if robots else None)
    record = TrialRecord(
        schema=3,
        label=label,
        recording=RECORDING,
        outcome=outcome,
        reason=reason,
        frames_scored=scored,
        frames_expected=EXPECTED,
        steps=STEPS,
        thresholds=ThresholdsUsed.of(thresholds),
        peak_rss_mb=123.0,
        latency_ms=LATENCY.model_copy(update={"device": GPU if label == "good" else ""}) if outcome == "ok" else None,
        **DESCRIBED.get(tracker, {}),
    )
    record.write(folder)
    return record, folder


def write_run(run, trackers=None, broken=(), robots=False):
    """A whole run's folder; `broken` are (label, scored, outcome, reason) of trials that did not finish."""
    trials = []
    for label, (tracker, forecast) in (TRACKERS if trackers is None else trackers).items():
        record, folder = write_trial(run, label, tracker, forecast, robots=robots)
        trials.append(FinishedTrial(record, folder, tracker, {}, ""))
    for label, scored, outcome, reason in broken:
        record, folder = write_trial(run, label, label, blurred_future(1.0), scored, outcome, reason)
        trials.append(FinishedTrial(record, folder, label, {}, ""))
    described = RecordingDescription(horizons_s=HORIZONS_S, stretch="crossing.mcap@test", grid=str(GRID), frames=FRAMES)
    summarise({RECORDING: described}, trials, [], interrupted=False).write(run)
    write_run_record(run, {RECORDING: described})
    return run


@pytest.fixture(scope="session")
def run_folder(tmp_path_factory):
    """A run of two trackers and two of the floor that all finished, and one tracker that crashed half-way."""
    run = tmp_path_factory.mktemp("runs") / "demo"
    return write_run(run, broken=[("unlucky", 7, "crashed", "ValueError: lost my way")])


TWENTY_SKILLS = {"persistence": 0.6, "good": 0.8, "<b>even": 0.6, "unlucky": 0.9, "oracle": 1.0}
"""Of each tracker on every recording; `unlucky` did not complete the first one."""


@pytest.fixture(scope="session")
def twenty(tmp_path_factory):
    """A run on twenty recordings, so with intervals and tests, at 2 Hz and in few strata so that it is small."""
    folder = tmp_path_factory.mktemp("runs") / "twenty"
    described = dict.fromkeys(RECORDINGS, description(period_s=0.5, steps=5))
    trials = [
        write_drawn_trial(
            folder,
            label,
            name,
            skill,
            seed=i,
            frames=4,
            scored=2 if (label, i) == ("unlucky", 0) else 4,
            strata=(*STRATA, "occluded", "occluded to 0.5 s", "occluded 0.5-1 s"),
            steps=5,
        )
        for i, name in enumerate(RECORDINGS)
        for label, skill in TWENTY_SKILLS.items()
    ]
    return write_results(folder, described, trials)


@pytest.fixture(scope="session")
def twenty_report(twenty):
    """The report of `twenty`."""
    return render_report([twenty])


@pytest.fixture
def summary_of():
    """summary.json of a run's folder."""
    return lambda run: json.loads((run / "summary.json").read_text())


@pytest.fixture(scope="session")
def make_run():
    """`write_run`."""
    return write_run


@pytest.fixture(scope="session")
def hostile_report(run_folder, tmp_path_factory):
    """A page on which the tracker `fair` has a hostile name."""

    def rename(summary):
        summary["trackers"] = {HOSTILE if k == "fair" else k: v for k, v in summary["trackers"].items()}

    run = edited(run_folder, tmp_path_factory.mktemp("browser") / "run", rename)
    (run / "fair@crossing").rename(run / f"{HOSTILE}@crossing")
    return render_report([run])


@pytest.fixture
def opened_with(browser, run_folder, tmp_path):
    """`opened_with(change)` opens the page of the run with another summary, which `change(summary)` changed."""
    with ExitStack() as pages:

        def open_with(change, **options):
            report = render_report([edited(run_folder, tmp_path / "run", change)])
            return pages.enter_context(opened_page(browser, report, **options))

        yield open_with


@pytest.fixture
def opened(browser, hostile_report):
    """`opened(fragment, width, report)` opens a page, and gives it and its player."""
    with ExitStack() as pages:

        def open_at(fragment="", width=1280, report=hostile_report, **options):
            options["viewport"] = {"width": width, "height": 900}
            page = pages.enter_context(opened_page(browser, report, fragment, **options))
            player = page.locator(".player[data-ready]")
            player.wait_for()
            return page, player

        yield open_at
